"""`obu demo`: the whole unit on this machine with simulated sensors, and its figures at the end."""

import json
import logging
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.access.tokens import Tokens
from services.sensors.simulator.scenarios import scenario_of
from shared.attacks import schedule
from shared.bus.bus import Bus
from shared.errors import BadPayload, UserError
from shared.evidence import keys_folder
from shared.library.order import in_order, read_order
from shared.processes import Role
from shared.runtime.config import Table, VehicleFile, load_vehicle, parse_vehicle, state_dir
from shared.topics import TOPICS

from ..token import listens_on_network, login_link, network_address, port_of
from . import plaza_balance
from .balance import WITHOUT_FIX_S, Balance, Summary
from .detection import AttackSummary
from .local import (
    ROADSIDE,
    as_toml,
    free_port,
    fresh_folder,
    how_to_listen,
    local_broker,
    only_one,
    port_or_free,
    unit,
)
from .plaza_balance import PlazaBalance, PlazaSummary
from .supervisor import Supervisor
from .words import lines

SIMULATED = Path(__file__).parents[2] / "deploy" / "vehicles" / "simulated.toml"
OBSERVED = ("truth/state", "gnss/fix", "navigation/solution", "deadline/report", "health/+", "imu/raw",
            "trust/state", "simulation/state", "health/load")  # fmt: skip
START_LIMIT_S = 60.0
LINK_S = 3600.0  # in which a link may log in


@dataclass(frozen=True)
class DemoOptions:
    """Options of the demo."""

    scenario: str
    seed: int
    duration_s: float | None
    json_output: bool
    http_port: int
    broker: str  # auto, mosquitto or simulated
    vehicle: Path = SIMULATED
    attacks: tuple[str, ...] = ()  # each as name(parameters)@start:duration
    role: Role = Role.OBU
    vehicles: int = 50  # at the plaza of a road-side unit
    centre: Path | None = None  # folder of a control centre of this machine, to which the unit reports


def run(options: DemoOptions) -> int:
    """Start all processes, supervise them, and print the figures at the end."""
    if options.role is Role.OBU:
        _insist_on_scenario(options)
    elif options.attacks:
        raise UserError("attacks are on a simulated vehicle; leave out --attack, or take --role obu")
    base = state_dir().resolve()
    with only_one(base / "demo.lock"), _errors_only("shared"):  # the broker's absence at the start is expected
        return _drive(options, fresh_folder(base / "demo"))


@contextmanager
def _errors_only(name: str) -> Iterator[None]:
    """Suppress a logger's warnings within the block."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def _insist_on_scenario(options: DemoOptions) -> None:
    """Reject attacks that the simulator would reject, before any process is started."""
    try:
        scenario_of(options.scenario, options.seed)
        for text in options.attacks:
            schedule(text)
    except ValueError as error:
        raise UserError(str(error)) from error


def _drive(options: DemoOptions, folder: Path) -> int:
    port, (http_port, taken) = free_port(), port_or_free(options.http_port)
    vehicle_path = folder / "vehicle.toml"
    vehicle = _vehicle(options, http_port)
    environment = {
        "OBU_VEHICLE": str(vehicle_path),
        "OBU_STATE": str(folder),
        "OBU_KEYS": str(keys_folder(folder.parent)),  # the next demo empties its folder
    }
    if options.centre is not None:
        from .centre import join  # the centre's packages need not be installed

        join(options.centre, vehicle.name, folder, Path(environment["OBU_KEYS"]))
    try:
        vehicle_path.write_text(vehicle.text, encoding="utf-8")
        (folder / "logs").mkdir()
        (folder / "demo.pid").write_text(str(os.getpid()))
        broker = local_broker(folder, port, options.broker, load_vehicle(vehicle_path))
    except OSError as error:
        raise UserError(
            f"cannot write into {folder}: {error.strerror}; make room on its disk, or set OBU_STATE to another folder"
        ) from error
    environment["OBU_BROKER"] = broker.address.url
    supervisor = unit(vehicle, environment, folder / "logs", broker.command)
    console = Console(stderr=True)
    what = f"scenario {options.scenario}" if options.role is Role.OBU else f"toll plaza, {options.vehicles} vehicles"
    console.print(f"[bold]OBU demo[/]: {what}, seed {options.seed}; logs in {folder / 'logs'}")
    if broker.remark:
        console.print(broker.remark, soft_wrap=True)
    if taken:
        console.print(
            f"port {options.http_port} {taken}: the dashboard uses {http_port}; "
            "to choose one: `obu demo --port NUMBER`, or `make demo PORT=NUMBER`",
            soft_wrap=True,
        )
    address = f"http://127.0.0.1:{http_port}"
    observed = OBSERVED if options.role is Role.OBU else plaza_balance.OBSERVED
    bus = Bus("observer", vehicle.name, broker.address,
              [t for t in TOPICS if t.name in observed and not t.is_covered], folder, observer=True)  # fmt: skip
    balance: Balance | PlazaBalance = PlazaBalance()
    if options.role is Role.OBU:
        balance = Balance(vehicle, keep=options.duration_s is not None)
    try:
        _watch(supervisor, bus, balance, options, console, address)
        summary = balance.summary(supervisor.alive(), len(supervisor.children), _restarts(supervisor))
    finally:
        bus.close()
        supervisor.stop()
        _tell_recordings(folder, console)
    _print(summary, options, console)
    return 0 if summary.healthy else 1


def _tell_recordings(folder: Path, console: Console) -> None:
    """Print the path of the recording: the next demo begins with an empty folder."""
    recordings = folder / "recordings"
    for name in in_order((path.name for path in recordings.glob("*.mcap")), read_order(recordings)):
        path = recordings / name
        console.print(f"recorded: {path}   (copy it: the next demo removes it)", soft_wrap=True, highlight=False)


def _restarts(supervisor: Supervisor) -> int:
    return sum(child.restarts for child in supervisor.children.values())


def _vehicle(options: DemoOptions, http_port: int) -> VehicleFile:
    """The file of the simulated vehicle with the options of the demo."""
    base = load_vehicle(options.vehicle if options.role is Role.OBU else ROADSIDE)
    tables: dict[str, Table] = {name: dict(table) for name, table in base.tables.items()}
    if options.role is Role.OBU:
        simulator = tables.setdefault("sensors.simulator", {})
        simulator.update(scenario=options.scenario, seed=options.seed, attacks=list(options.attacks))
    else:
        radio = f"udp://127.0.0.1:{free_port()}"
        tables.setdefault("sensors.v2x", {}).update(device=radio)
        tables.setdefault("sensors.traffic", {}).update(vehicles=options.vehicles, seed=options.seed, send_to=radio)
    tables.setdefault("monitoring.status", {}).update(
        port=http_port, recordings=["download", "keep", "delete", "replay", "solve"]
    )
    if options.centre is not None:
        tables.setdefault("monitoring.uplink", {})
    return parse_vehicle(as_toml(tables), "the demo's vehicle file")


def _watch(
    supervisor: Supervisor,
    bus: Bus,
    balance: Balance | PlazaBalance,
    options: DemoOptions,
    console: Console,
    address: str,
) -> None:
    """Run for the duration, from the first solution on, or until Ctrl-C."""
    started = time.monotonic()
    measuring_since: float | None = None
    with Progress(*Progress.get_default_columns(), TimeElapsedColumn(), console=console,
                  disable=not console.is_terminal) as progress:  # fmt: skip
        task = progress.add_task("waiting for the first solution", total=options.duration_s)
        while measuring_since is None or options.duration_s is None or \
                time.monotonic() - measuring_since < options.duration_s:  # fmt: skip
            supervisor.watch()
            supervisor.raise_rejected()
            for envelope in bus.receive(0.1):
                try:
                    balance.add(envelope.topic, envelope.decode(), envelope.received_ns)
                except BadPayload:
                    balance.broken_messages += 1
            if measuring_since is None and balance.messages:
                measuring_since = time.monotonic()
                console.print(f"dashboard: [bold link={address}]{address}[/]   (end with Ctrl-C)")
                _tell_others(bus.state_dir, address, console)
                console.print(_how_to_listen(bus), style="dim", soft_wrap=True, highlight=False)
                progress.update(task, description="driving")
            if measuring_since is None and time.monotonic() - started > START_LIMIT_S:
                raise UserError(f"nothing was received from the sensors in {START_LIMIT_S:.0f} s; "
                                f"see the logs in {bus.state_dir / 'logs'}")  # fmt: skip
            if measuring_since is not None:
                progress.update(task, completed=time.monotonic() - measuring_since)


def _tell_others(folder: Path, address: str, console: Console) -> None:
    """Print a link that logs in another device, if the page listens on the network."""
    if listens_on_network() and (reached := network_address(port_of(address))):
        secret = Tokens(folder).add_temporary("link", Right.ADMIN, seconds=LINK_S, single_use=True)
        console.print(
            f"from another device, once, within {LINK_S / 60.0:.0f} min: {login_link(reached, secret)}",
            soft_wrap=True, highlight=False,
        )  # fmt: skip


def _how_to_listen(bus: Bus) -> str:
    """The environment with which another terminal receives the messages of this unit, and finds a secret for it."""
    keys = keys_folder(bus.state_dir.parent)
    return how_to_listen(bus.address.url, bus.state_dir, keys)


def why_unhealthy(summary: Summary | PlazaSummary) -> str:
    """Say why a run counts as failed, and what to do."""
    if summary.processes_alive < summary.processes_expected:
        return (
            f"{summary.processes_alive} of {summary.processes_expected} processes were alive at the end: see the logs"
        )
    if isinstance(summary, PlazaSummary):
        return "no passage was charged: the first one takes about 30 s; try --duration 60"
    return _why_unusable(summary) if summary.unusable else _without_position(summary)


def _why_unusable(summary: Summary) -> str:
    """Say why the positions of a run could not be used although all processes ran."""
    missing = f"no position for {summary.trust.get('no_fix', 0.0):.0f} of {summary.duration_s:.0f} s"
    if not summary.too_slow:
        return f"not usable: {missing}; the page System shows which input was missing"
    return (
        f"not usable: this computer is too slow: {missing}, checks paused for {summary.checks_paused_s:.0f} s, "
        f"positions {(summary.end_to_end_latency_p50_ms or 0.0) / 1e3:.1f} s late at the median; end other "
        "programs, or use a faster computer"
    )


def _without_position(summary: Summary) -> str:
    if summary.solutions and summary.without_fix_s is None:
        return "no GNSS fix with a position was received: check the receiver and its antenna"
    if summary.without_fix_s is not None and summary.without_fix_s > WITHOUT_FIX_S:
        return f"no GNSS fix with a position for the last {summary.without_fix_s:.0f} s"
    if not summary.solutions:
        return "there was no position yet: a drive needs about 20 s before its first, --duration 60 shows more"
    return "not every process has reported to be ready: see the logs"


def _detection(attack: AttackSummary) -> str:
    if attack.detected_after_s is None:
        return f"attack {attack.name} at {attack.started_s:.0f} s: not detected"
    by = "; ".join(attack.detected_by)
    return f"attack {attack.name} at {attack.started_s:.0f} s: detected after {attack.detected_after_s:.1f} s by {by}"


def _print(summary: Summary | PlazaSummary, options: DemoOptions, console: Console) -> None:
    if not summary.healthy:
        what = "" if isinstance(summary, Summary) and summary.unusable else "not healthy: "
        console.print(f"{what}{why_unhealthy(summary)}", soft_wrap=True, highlight=False)
    if options.json_output:
        print(json.dumps(asdict(summary)))
        return
    console.print("\n[bold]What was seen[/]")
    shown = asdict(summary)
    if isinstance(summary, Summary):
        for attack in summary.attacks:
            console.print(f"  {_detection(attack)}", highlight=False)
        del shown["attacks"]
        if summary.fusion_worse_than_gnss:
            console.print(
                f"  The fused position is worse than the receiver at the same fixes: "
                f"{summary.fusion_at_fixes_horizontal_rmse_m} m horizontal RMS instead of "
                f"{summary.gnss_horizontal_rmse_m} m.", soft_wrap=True, highlight=False)  # fmt: skip
    for line in lines(shown):
        console.print(f"  {line}", soft_wrap=True, highlight=False)
    sys.stderr.flush()


__all__ = ["DemoOptions", "run"]
