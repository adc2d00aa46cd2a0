"""Serves the state of the unit: dashboard, JSON, metrics. The bus in the main thread, the web server beside it."""

import logging
import os
import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from queue import Queue
from typing import Any, Literal

import uvicorn
from pydantic import Field, field_validator

from shared import VERSION
from shared.bus.bus import Bus
from shared.errors import BadPayload, ObuError, UserError
from shared.faults import Faults
from shared.library.library import Library
from shared.messages.operation import RecordingState
from shared.page.access.limits import Connections
from shared.page.access.peer import networks
from shared.page.pages import read_pages
from shared.page.server import make_server
from shared.runtime.config import Section, address_file, parse_vehicle

from .history.history_file import HistoryFile
from .page import DASHBOARD
from .replay import ReplayFeed
from .series.past import fill_from_recordings
from .state import State
from .views.prometheus import StateCollector, registry_of
from .web.access.access import Access, Rules, is_simulated
from .web.access.tokens import Tokens, tokens_folder
from .web.command import CommandApi
from .web.draft import DraftApi
from .web.made_file import MadeFiles
from .web.map import MapApi
from .web.page_errors import PageErrorsApi, count
from .web.recordings import Action, Job, RecordingsApi
from .web.replay import ReplayApi
from .web.routes import LIMITED_LOGS, Api, ClientStreams, make_app
from .web.series import SeriesApi
from .web.set_up import SetUpApi
from .web.settings import SettingsApi
from .web.simulation import SimulationApi
from .web.stream.events import Events
from .web.stream.websocket import Stream
from .web.support import SupportApi

log = logging.getLogger(__name__)

PAST_PERIOD_S = 1.0
HISTORY_FILE = "status.history.jsonl"
TRACK_FILE = "status.track.jsonl"
POLL_PERIOD_NS = 2_000_000_000  # between two looks at the folder of recordings


class Config(Section):
    """Address of the server, and lengths of the histories."""

    host: str | None = Field(
        default=None,
        description="address that the page listens on; 0.0.0.0: the whole network sees it; "
        "without it OBU_HTTP_HOST, else 127.0.0.1",
    )
    port: int = Field(default=8080, ge=0, le=65535, description="TCP port of the page; 0: any free one")
    history_s: float = Field(
        default=900.0, gt=0, le=86_400, description="length of the history that the page and /api/history hold"
    )
    static_dir: str | None = Field(default=None, description="folder of another dashboard than the delivered one")
    allowed_hosts: tuple[str, ...] = Field(
        default=(),
        description="further names by which the unit is reached, besides localhost, its addresses, its own host name "
        "and that with .local; other names are rejected",
    )
    login_on_loopback: bool | None = Field(
        default=None,
        description="whether a browser on this machine has to log in; not given: unless all data are simulated. false: "
        "every program of this machine sees the position and may send commands. From other machines and through "
        "a proxy a login is always needed",
    )
    session_h: float = Field(default=168.0, gt=0, le=8760, description="hours after which a browser must log in again")
    trusted_proxies: tuple[str, ...] = Field(
        default=(),
        description="addresses or networks of reverse proxies whose X-Forwarded-For and X-Forwarded-Proto are believed",
    )
    connections_per_client: int = Field(
        default=16,
        ge=4,
        le=1024,
        description="connections of one address at once; of this machine and of a trusted proxy half of all",
    )
    map_file: str | None = Field(
        default=None, description="map of the page Map, a .pmtiles or .mbtiles file: docs/how-to/install-a-map.md"
    )
    replay: bool = Field(
        default=False,
        description="whether messages come from sensors.replay, so that recorded time is shown; `obu replay` sets it",
    )
    recordings: tuple[Literal["download", "keep", "delete", "replay", "solve"], ...] = Field(
        default=("download", "keep"),
        description="what the page Recordings may do: download, keep, delete, replay, solve",
    )
    clients_maximum: int = Field(
        default=100, ge=1, le=256, description="dashboards at once, and as many readers of /api/events"
    )

    @field_validator("trusted_proxies")
    @classmethod
    def _are_networks(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        networks(texts)
        return texts


class Process:
    """Keeps the newest of everything and shows it."""

    def __init__(self, config: Config) -> None:
        self._config = config

    def run(self, bus: Bus) -> None:
        """Receive from the bus and serve the web until `bus.stopping`."""
        host = self._config.host or os.environ.get("OBU_HTTP_HOST", "127.0.0.1")
        address_file(bus.state_dir).unlink(missing_ok=True)  # of an earlier incarnation
        listener = listen(host, self._config.port)
        expected = parse_vehicle(bus.vehicle_toml).processes
        state = State(bus.vehicle, expected, bus.now_ns(), self._config.history_s, replay=self._config.replay)
        kept = None if self._config.replay else HistoryFile(bus.state_dir / HISTORY_FILE)
        if kept and (bad := state.restore(kept.read())):
            log.warning("left out %d lines of %s that cannot be read", bad, HISTORY_FILE)
        track_file = HistoryFile(bus.state_dir / TRACK_FILE)
        if not self._config.replay and (bad := state.track.restore(track_file.read(), bus.now_ns())):
            log.warning("left out %d lines of %s that cannot be read", bad, TRACK_FILE)
        lock = threading.Lock()
        feed = ReplayFeed(state) if self._config.replay else None
        now_ns = bus.now_ns if feed is None else lambda: feed.now_ns(bus.now_ns())
        simulation, operator = SimulationApi(state, lock, now_ns), CommandApi(state, lock, now_ns)
        replay, errors, unit_settings = (
            ReplayApi(feed, lock, bus.now_ns),
            PageErrorsApi(),
            SettingsApi(state, lock, now_ns),
        )
        library, job = (
            Library(recordings_folder(bus)),
            Job((bus.state_dir / "jobs").resolve(), tokens_folder(bus.state_dir).resolve()),
        )
        files, allowed = (
            MadeFiles((bus.state_dir / "jobs").resolve()),
            frozenset(map(Action, () if self._config.replay else self._config.recordings)),
        )
        recordings, set_up = (
            RecordingsApi(library, job, allowed, partial(open_name, state)),
            SetUpApi(state, lock, now_ns, bus.state_dir.resolve(), library, partial(open_name, state), files),
        )
        server = self._make_server(
            state, lock, bus, now_ns, files, (simulation, replay, recordings, operator, unit_settings, errors, set_up)
        )
        thread = threading.Thread(target=server.run, args=([listener],), name="web", daemon=True)
        threading.Thread(target=read_pasts, args=(bus, state, lock), name="past", daemon=True).start()
        self._announce(listener, bus)  # before the server can fail and close the port
        thread.start()
        faults, look_ns = Faults(bus.rejects), 0
        while not bus.stopping:
            bus.follow(state.followed)
            if bus.now_ns() >= look_ns:
                look_ns = bus.now_ns() + POLL_PERIOD_NS
                library.look(open_name(state))
            if feed is None:
                take_in(bus, state, lock, faults)
                track_file.append([row._asdict() for row in state.track.unsaved()])
            else:
                take_in_replay(bus, state, lock, feed)
                replay.refresh(connected=bus.connected)
            records = state.unsaved()
            if kept:
                kept.append(records)
            publish(bus, simulation.commands, replay.commands, operator.commands, unit_settings.commands)
            count(errors, bus)
            if not thread.is_alive():
                raise ObuError("the web server has ended; the line before says why")
        server.should_exit = True
        library.stop()
        job.stop()
        set_up.survey.stop()
        thread.join(3.0)
        address_file(bus.state_dir).unlink(missing_ok=True)

    def _make_server(
        self,
        state: State,
        lock: threading.Lock,
        bus: Bus,
        now_ns: Callable[[], int],
        files: MadeFiles,
        apis: tuple[SimulationApi, ReplayApi, RecordingsApi, CommandApi, SettingsApi, PageErrorsApi, SetUpApi],
    ) -> uvicorn.Server:
        folder = Path(self._config.static_dir) if self._config.static_dir else DASHBOARD
        clients = self._config.clients_maximum
        series = SeriesApi(state, lock, now_ns, clients)
        collector = StateCollector(state, now_ns, lock, VERSION)
        api = Api(state, lock, now_ns, registry_of(collector), self._config.history_s)
        watching = ClientStreams(Stream(state, lock, now_ns, clients, apis[1]), Events(state, lock, now_ns, clients))
        maps = MapApi(state, lock, now_ns, self._config.map_file)
        access = self._make_access(bus)
        support = SupportApi(files, access.tokens)
        app = make_app(api, (series, *apis, maps, support, DraftApi()), read_pages(folder), watching, access)
        per_client, trusted = self._config.connections_per_client, access.rules.trusted_proxies
        connections = Connections(4 * clients + 16, per_client, trusted, access.rules.published)
        return make_server(app, connections, LIMITED_LOGS)

    def _make_access(self, bus: Bus) -> Access:
        config, vehicle = self._config, parse_vehicle(bus.vehicle_toml)
        names = os.environ.get("OBU_HTTP_NAMES", "")
        rules = Rules(
            simulated=is_simulated(vehicle),
            login_on_loopback=config.login_on_loopback,
            published=os.environ.get("OBU_HTTP_PUBLISHED") or None,
            trusted_proxies=networks(config.trusted_proxies),
            allowed_hosts=(*config.allowed_hosts, *(name.strip() for name in names.split(",") if name.strip())),
            session_s=config.session_h * 3600.0,
            per_address=config.connections_per_client,
        )
        tokens = Tokens(tokens_folder(bus.state_dir))
        try:
            tokens.make()
        except UserError as error:  # without tokens the page serves those who need none
            log.warning("nobody can log in: %s", error)
        return Access(rules, tokens)

    def _announce(self, listener: socket.socket, bus: Bus) -> None:
        host, port = listener.getsockname()[:2]
        shown = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        address = f"http://[{shown}]:{port}/" if ":" in shown else f"http://{shown}:{port}/"
        try:
            address_file(bus.state_dir).write_text(address)
        except OSError as error:  # the page is served all the same
            log.warning("cannot write %s: %s", address_file(bus.state_dir), error.strerror)
        log.info("dashboard at %s, listening on %s port %d", address, host, port)


def publish(bus: Bus, *queues: Queue[Any]) -> None:
    """Publish the commands that visitors have sent."""
    for commands in queues:
        while not commands.empty():
            bus.publish(commands.get_nowait())


def recordings_folder(bus: Bus) -> Path:
    """Find the folder of the recorder."""
    table = parse_vehicle(bus.vehicle_toml).tables.get("monitoring.recorder", {})
    return bus.state_dir / str(table.get("folder", "recordings"))


def open_name(state: State) -> str | None:
    """Name the recording in progress, as the recorder stated it last."""
    message = state.topics["recording/state"].message
    return message.file if isinstance(message, RecordingState) else None


def take_in(bus: Bus, state: State, lock: threading.Lock, faults: Faults) -> None:
    """Receive once, and let time pass."""
    envelopes = bus.receive(0.05)
    with lock:
        for envelope in envelopes:
            with faults.handling(bus.now_ns()):
                try:
                    state.receive(envelope)
                except BadPayload as error:
                    bus.rejects["payload"] += 1
                    bus.last_error = str(error)[:400]
        state.tick(bus.now_ns(), broker=bus.connected)


def read_pasts(bus: Bus, state: State, lock: threading.Lock) -> None:
    """Read the past of fields that are newly kept from the recordings, in the background; not of a replay."""
    folder = recordings_folder(bus)
    while not (bus.stopping or state.replay):
        with lock:
            names = state.series.take_wanted()
        if names and folder.is_dir():
            now_ns = bus.now_ns()
            try:
                for name, values in fill_from_recordings(names, folder, now_ns):
                    with lock:
                        state.series.fill(name, values, now_ns)
            except OSError as error:
                log.warning("the past of charts cannot be read from %s: %s", folder, error)
            with lock:
                state.series.fillings += 1
        time.sleep(PAST_PERIOD_S)


def take_in_replay(bus: Bus, state: State, lock: threading.Lock, feed: ReplayFeed) -> None:
    """Receive once from a replay, and let recorded time pass."""
    envelopes = bus.receive(0.02)
    with lock:
        feed.take(envelopes, bus.now_ns())
        bus.rejects["payload"] = feed.broken
        state.pass_to(feed.now_ns(bus.now_ns()))
        state.broker = bus.connected and not feed.lost(bus.now_ns())


def listen(host: str, port: int) -> socket.socket:
    """Open the port, or say whose setting to change."""
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise UserError(
            f"cannot listen on {host} port {port}: {error.strerror or error}; "
            "set another port under [monitoring.status] in the vehicle's file (0 takes any free one)"
        ) from error
