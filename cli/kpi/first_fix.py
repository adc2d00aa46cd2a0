"""`obu kpi ttff`: times to the first fix after restarts of a receiver, with mean and standard deviation."""

import json
import statistics
import time
from collections.abc import Iterator, Mapping
from typing import Annotated, Protocol

import typer
from rich.console import Console

from services.parsers.gnss.process import Config, Process
from services.sensors.simulator.scenarios import BY_NAME
from services.sensors.simulator.world import DEFAULT_START_NS, World
from shared.devices.device import Device, DeviceLost, open_device
from shared.errors import UserError
from shared.messages.gnss import GnssFix, GnssRaw, GnssReset, GnssStart, GnssWrite

from ..progress import progress_on

NS = 1_000_000_000
READY_S = 10.0  # of fixes before a restart
LONGEST_S = 300.0  # [s] search after which a restart counts as failed
SETTLED_S = 2.0  # after a restart: fixes of before are still on the line


class Source(Protocol):
    """A receiver: what it sends with the arrival, and what is written to it."""

    def read(self) -> Iterator[GnssRaw]:
        """Bytes in order, without end; empty ones where nothing has come for a while."""
        ...

    def write(self, data: bytes, now_ns: int) -> None:
        """Write bytes."""
        ...


class SimulatedReceiver:
    """The simulator's receiver, as fast as it can be computed."""

    def __init__(self) -> None:
        self._world = World(BY_NAME["parking_lot"], 1, DEFAULT_START_NS)

    def read(self) -> Iterator[GnssRaw]:
        """Bytes of the receiver."""
        return (message for _, message in self._world if isinstance(message, GnssRaw))

    def write(self, data: bytes, now_ns: int) -> None:
        """Write bytes."""
        self._world.write(data, now_ns)


class RealReceiver:
    """A receiver at a port that no other program has open."""

    def __init__(self, device: Device) -> None:
        self._device = device

    def read(self) -> Iterator[GnssRaw]:
        """Bytes of the port."""
        while True:
            try:
                data = self._device.read(0.2)
            except DeviceLost as lost:
                raise UserError(f"the receiver is lost: {lost}") from lost
            yield GnssRaw(received_ns=time.monotonic_ns(), source="gnss0", data=data)

    def write(self, data: bytes, now_ns: int) -> None:
        """Write bytes."""
        self._device.write(data)


def first_fix(
    start: Annotated[GnssStart, typer.Argument(help="What the receiver keeps: hot: all; warm: no ephemerides; cold.")],
    *,
    repeat: Annotated[int, typer.Option(metavar="NUMBER", min=1, max=1000, help="Number of restarts.")] = 20,
    device: Annotated[
        str | None,
        typer.Option(metavar="URL", help="A u-blox receiver, such as serial:///dev/obu-gnss?baud=115200; the unit must "
                     "not run. Default: the simulated receiver."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the times as one JSON object.")] = False,
) -> int:  # fmt: skip
    """Restart a receiver by UBX-CFG-RST many times, and give mean and standard deviation of the time to first fix.

    Without a device it is the simulated receiver, whose times are assumptions. With a real one the command has not been
    tried.

    Examples:
    [bold]obu kpi ttff cold --repeat 20[/]
    [bold]obu kpi ttff hot --device serial:///dev/ttyACM0[/]
    """
    receiver: Source = SimulatedReceiver() if device is None else RealReceiver(open_device(device))
    console = Console(stderr=True)
    with progress_on(console) as progress:
        shown = progress.track(times_to_first_fix(receiver, start, repeat), total=repeat, description="restarting")
        times = list(shown)
    found = [time_s for time_s in times if time_s is not None]
    source = "simulated receiver; its times are assumptions" if device is None else device
    document = {
        "start": start.value, "receiver": source, "restarts": repeat, "without_fix": repeat - len(found),
        "mean_s": statistics.mean(found) if found else None,
        "sigma_s": statistics.stdev(found) if len(found) > 1 else None, "times_s": found,
    }  # fmt: skip
    if as_json:
        print(json.dumps(document))
    else:
        print(_sentence(document))
    return 0 if len(found) == repeat else 1


def _sentence(document: Mapping[str, object]) -> str:
    mean, sigma = document["mean_s"], document["sigma_s"]
    found = f"{mean:.1f} s" if isinstance(mean, float) else "none"
    spread = f", sigma {sigma:.1f} s" if isinstance(sigma, float) else ""
    return (
        f"{document['restarts']} {document['start']} starts ({document['receiver']}): time to first fix "
        f"{found}{spread}; without a fix within {LONGEST_S:.0f} s: {document['without_fix']}"
    )


def times_to_first_fix(receiver: Source, start: GnssStart, repeat: int) -> Iterator[float | None]:
    """Time [s] from each restart to the first fix with a position; None where there is none within 300 s."""
    parser, restarted_ns, restarts, fixed_since_ns = Process(Config()), None, 0, None
    begun_ns: int | None = None
    for raw in receiver.read():
        now_ns = raw.received_ns
        begun_ns = now_ns if begun_ns is None else begun_ns
        outputs = list(parser.handle(raw)) if raw.data else []
        has_fix = any(isinstance(one, GnssFix) and one.latitude_deg is not None for one in outputs)
        if restarted_ns is None:
            fixed_since_ns = now_ns if has_fix and fixed_since_ns is None else fixed_since_ns
            if fixed_since_ns is not None and now_ns - fixed_since_ns >= READY_S * NS:
                for written in parser.handle(GnssReset(request_id="ttff", source=raw.source, start=start)):
                    if isinstance(written, GnssWrite):
                        receiver.write(written.data, now_ns)
                restarted_ns, fixed_since_ns = now_ns, None
            elif fixed_since_ns is None and now_ns - begun_ns > LONGEST_S * NS:
                raise UserError("the receiver has no fix to begin with: place its antenna under open sky")
            continue
        searched_s = (now_ns - restarted_ns) / NS
        if (has_fix and searched_s > SETTLED_S) or searched_s > LONGEST_S:
            yield searched_s if has_fix else None
            restarted_ns, begun_ns, restarts = None, now_ns, restarts + 1
            if restarts == repeat:
                return
