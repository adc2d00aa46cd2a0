"""`obu replay`: a recording in the dashboard, with a broker and a dashboard of its own."""

import logging
import os
import tempfile
import time
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from services.monitoring.status.web.access.tokens import FOLDER_VARIABLE
from shared.bus import codec
from shared.bus.envelope import Envelope
from shared.errors import UserError
from shared.messages.base import Message, Sender
from shared.messages.replay import FASTEST, SLOWEST
from shared.processes import Role
from shared.recording import Recording, RecordingWriter
from shared.runtime.config import ADDRESS_FILE, BrokerAddress, Table, VehicleFile, load_vehicle, state_dir
from shared.runtime.reports import tell
from shared.topics import BY_MESSAGE

from ..demo.local import as_toml, free_port, how_to_listen, local_broker, port_or_free
from ..demo.supervisor import Supervisor
from ..progress import progress_on
from .common import open_recording, vehicle_of

START_LIMIT_S = 30.0
RUN_HERE = ("sensors.replay", "monitoring.status")


def replay(  # one argument an option
    file: Annotated[Path, typer.Argument(help="A recording, from `obu record`, the unit's recorder or `obu import`.")],
    *,
    speed: Annotated[
        float,
        typer.Option(
            min=SLOWEST, max=FASTEST, metavar="FACTOR", help="Recorded seconds per second; the page changes it."
        ),
    ] = 1.0,
    port: Annotated[
        int, typer.Option(min=0, max=65535, metavar="PORT", help="Port of the dashboard; if taken, a free one.")
    ] = 8080,
    broker: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Play the bytes of the devices onto this broker instead, for a unit that runs without sensors.",
        ),
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option("--vehicle", metavar="FILE", help="The vehicle's TOML file; without it the recorded one."),
    ] = None,
) -> int:
    """Show a recording in a dashboard: play, pause, speed, and any position of the drive.

    Starts a broker and a dashboard of its own, and prints the address. A recording without solutions, such as one of
    `obu import`, is processed first.

    Examples:
    [bold]obu replay drive.mcap[/]
    [bold]obu replay drive.mcap --speed 10 --port 8090[/]
    [bold]obu replay drive.mcap --broker mqtt://127.0.0.1:1884[/]
    """
    if broker is not None:
        from .onto_bus import play_onto

        return play_onto(file, speed, BrokerAddress.parse(broker), vehicle)
    console = Console(stderr=True)
    base = state_dir().resolve() / "replays"
    base.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=base, prefix=f"{file.stem[:40]}-") as folder:
        return _serve(file, Path(folder), (speed, port), vehicle, console)


def _serve(file: Path, folder: Path, options: tuple[float, int], vehicle: Path | None, console: Console) -> int:
    speed, wanted_port = options
    unit = _vehicle_of(file, vehicle)
    played = _playable(file, unit, folder, console)
    summaries = folder if played != file else state_dir().resolve() / "recordings"
    summaries.mkdir(exist_ok=True)
    broker_port, (http_port, taken) = free_port(), port_or_free(wanted_port)
    text = _with_sections(unit, {
        "sensors.replay": {"file": str(played.resolve()), "speed": speed, "summaries": str(summaries)},
        "monitoring.status": {"port": http_port, "replay": True, **_login()},
    })  # fmt: skip
    (folder / "vehicle.toml").write_text(text, encoding="utf-8")
    (folder / "logs").mkdir()
    environment = {
        "OBU_VEHICLE": str(folder / "vehicle.toml"),
        "OBU_STATE": str(folder),
    }
    broker = local_broker(folder, broker_port, "auto", load_vehicle(folder / "vehicle.toml"), replay=True)
    environment["OBU_BROKER"] = broker.address.url
    if broker.remark:
        console.print(broker.remark, soft_wrap=True)
    supervisor = Supervisor({**os.environ, **environment}, folder / "logs")
    supervisor.add("broker", broker.command, throughout=True)
    for name in RUN_HERE:
        supervisor.add_process(name)
    if taken:
        console.print(f"port {wanted_port} {taken}: the dashboard uses {http_port}; to choose one: --port NUMBER")
    logging.getLogger("cli.demo.supervisor").setLevel(logging.ERROR)
    try:
        _wait_for_page(supervisor, folder)
        tell(port=http_port)
        console.print(
            f"{file.name} is replayed at [bold]http://127.0.0.1:{http_port}[/]   (end with Ctrl-C)", soft_wrap=True
        )
        console.print(how_to_listen(environment["OBU_BROKER"], folder), style="dim", soft_wrap=True, highlight=False)
        while True:
            supervisor.watch()
            supervisor.raise_rejected()
            time.sleep(0.2)
    except (KeyboardInterrupt, SystemExit):
        return 0
    finally:
        supervisor.stop()


def _login() -> Table:
    """Settings of the login: a replay that a page has started takes that of its unit, another one needs none here."""
    return {} if FOLDER_VARIABLE in os.environ else {"login_on_loopback": False}


def _wait_for_page(supervisor: Supervisor, folder: Path) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while not (folder / ADDRESS_FILE).exists():
        supervisor.watch()
        supervisor.raise_rejected()
        time.sleep(0.05)
        if time.monotonic() > deadline:
            raise UserError(f"the dashboard did not start in {START_LIMIT_S:.0f} s; `obu doctor` checks this machine")


def _vehicle_of(file: Path, vehicle: Path | None) -> VehicleFile:
    with open_recording(file) as recording:
        return vehicle_of(recording, vehicle)


def _playable(file: Path, vehicle: VehicleFile, folder: Path, console: Console) -> Path:
    """The recording itself, or a copy with the index or the solutions that it lacks."""
    with open_recording(file) as recording:
        topics = recording.topics
        if not topics:
            console.print(f"{file.name} was not closed: reading all of it first")
            from .record import repair_into

            copy = folder / f"whole-{file.name}"
            repair_into(recording, copy, console)
            return _playable(copy, vehicle, folder, console)
        if "navigation/solution" in topics or vehicle.role is not Role.OBU:
            return file
        console.print(f"{file.name} holds no solutions: computing them first")
        return _solved(recording, vehicle, folder / f"solved-{file.name}", console)


def _solved(recording: Recording, vehicle: VehicleFile, path: Path, console: Console) -> Path:
    """Write the inputs of a recording, and the outputs of layers 2 to 4, into a new one."""
    from shared.runtime.live import arrival_ns
    from shared.runtime.offline import OfflineUnit

    from ..solve.inputs import inputs_of

    inputs = inputs_of(recording)
    if not inputs.envelopes:
        raise UserError(f"{recording.path} holds no bytes of a device; record a unit with sensors or a simulator")
    unit = OfflineUnit(vehicle)
    try:
        writer = RecordingWriter(path, vehicle=vehicle.name, vehicle_toml=vehicle.text)
        with progress_on(console) as progress:
            task = progress.add_task("solving", total=len(inputs.envelopes))
            now_ns = 0
            for count, message in enumerate(chain(unit.run(inputs.messages(vehicle)), unit.close())):
                now_ns = max(now_ns, arrival_ns(message) or 0)
                writer.write(_envelope(message, now_ns, count))
                if count % 1000 == 0:
                    progress.update(task, completed=count)
        writer.close()
    except OSError as error:
        raise UserError(
            f"cannot write {path}: {error.strerror}; make room, or set OBU_STATE to another disk"
        ) from error
    return path


def _envelope(message: Message, now_ns: int, sequence: int) -> Envelope:
    topic = codec.topic_name(message)
    producers = BY_MESSAGE[type(message)].producers
    payload = codec.signed(
        codec.encode(message), Sender(process=producers[0] if producers else "", incarnation=0, sequence=sequence)
    )
    return Envelope(topic, payload, now_ns)


def _with_sections(vehicle: VehicleFile, sections: dict[str, Table]) -> str:
    """The vehicle's file with some sections replaced."""
    return as_toml({**vehicle.tables, **sections})
