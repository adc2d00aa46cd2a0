"""`obu replay --broker`: publishes the device data of a recording on a bus, in place of devices."""

import time
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console

from shared.bus.bus import Bus, Envelope
from shared.errors import BadPayload, UserError
from shared.messages.operation import Origin, OriginKind
from shared.recording import Recording
from shared.runtime.config import BrokerAddress, load_vehicle, state_dir
from shared.runtime.mounting import RecordedAxes
from shared.topics import BY_NAME

from ..progress import progress_on
from .common import await_broker, open_recording, print_problems, vehicle_of
from .device_data import inputs_among, shifted

ORIGIN_S = 2.0
ORIGIN_AGE_NS = 10_000_000_000  # an older one is the retained message of a source that has ended
LISTEN_S = 1.0  # in which messages of another source of data are awaited
STEP = 200


def play_onto(file: Path, speed: float, address: BrokerAddress, vehicle: Path | None) -> int:
    """Publish the device data on the bus of a unit that runs without sensors; stamps are shifted to now.

    At a speed other than 1 the stamps keep the recorded intervals and differ from the unit's clock: good for watching,
    not for measuring latency.
    """
    console = Console(stderr=True)
    with open_recording(file) as recording:
        wanted = inputs_among({envelope.topic for envelope in recording})
        axes = RecordedAxes(vehicle_of(recording, None))
        print_problems(recording, console)
        if not wanted:
            raise UserError(f"{file} holds no data of a device; record a unit with sensors or a simulator")
        bus = Bus("replay", load_vehicle(vehicle).name, address, (BY_NAME["origin/state"],), state_dir(), observer=True)
        try:
            await_broker(bus)
            _insist_on_silence(bus)
            count = Player(bus, Origin(now_ns=0, kind=OriginKind.REPLAY, name=file.stem[:64], speed=speed)).play(
                recording, wanted, axes, console
            )
        finally:
            bus.close()
    print(f"played {count} messages of {', '.join(sorted(wanted))}")
    return 0


class Player:
    """Publishes each message when it is due."""

    def __init__(self, bus: Bus, origin: Origin) -> None:
        self._bus, self._origin = bus, origin
        self._origin_due = 0.0

    def play(self, recording: Recording, wanted: frozenset[str], axes: RecordedAxes, console: Console) -> int:
        """Publish a recording to its end; returns the number of messages."""
        count = 0
        with progress_on(console) as progress:
            task = progress.add_task(recording.path.name, total=recording.size)
            for envelope, shift_ns in self._paced(e for e in recording if e.topic in wanted):
                try:
                    message = axes.apply(shifted(envelope, shift_ns))
                except BadPayload:
                    continue  # its consumers would reject it as well
                self._bus.publish(message)
                if count % STEP == 0:
                    progress.update(task, completed=recording.position)
                count += 1
        return count

    def _paced(self, envelopes: Iterator[Envelope]) -> Iterator[tuple[Envelope, int]]:
        """Yield each message when it is due, with the shift from its stamps to now."""
        started, first_ns, shift_ns = time.monotonic(), 0, 0
        for envelope in envelopes:
            if not first_ns:
                first_ns = envelope.received_ns
                shift_ns = self._bus.now_ns() - first_ns
            due = started + (envelope.received_ns - first_ns) * 1e-9 / self._origin.speed
            while True:
                self._say_origin()
                self._bus.receive(min(max(due - time.monotonic(), 0.0), 0.1))
                if time.monotonic() >= due:
                    break
            yield envelope, shift_ns

    def _say_origin(self) -> None:
        if time.monotonic() >= self._origin_due:
            self._origin_due = time.monotonic() + ORIGIN_S
            self._bus.publish(self._origin.model_copy(update={"now_ns": self._bus.now_ns()}))


def _insist_on_silence(bus: Bus) -> None:
    """Raise `UserError` if a vehicle, a simulator or another recording publishes data on the bus."""
    deadline = time.monotonic() + LISTEN_S
    while time.monotonic() < deadline:
        for envelope in bus.receive(0.1):
            try:
                other = envelope.decode()
            except BadPayload:
                continue
            if isinstance(other, Origin) and bus.now_ns() - other.now_ns < ORIGIN_AGE_NS:
                raise UserError(
                    f"{envelope.producer} already sends {other.kind} data of {other.name} on this bus; stop it"
                    " and wait for 10 s, or play to another broker with --broker"
                )
