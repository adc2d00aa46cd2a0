"""The live runtime: messages that a process receives, and those it does not."""

import time
from collections import Counter
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from shared.bus import codec
from shared.bus.bus import QUEUE_LENGTH, Bus, Envelope
from shared.errors import TooManyFaults
from shared.maths.dates import MIN_DATE_NS
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssRaw
from shared.messages.navigation import FilterState
from shared.messages.operation import ConsumptionOrder
from shared.messages.v2x import CamFrames
from shared.messages.vehicle import CanRaw
from shared.runtime.live import MAX_RUNS, PORTION_BYTES, SERVE_S, Journal, LiveReactor, portions
from shared.topics import BY_NAME

OLD_LIFE, LIFE = 1_000, 2_000


def state(sampled_ns: int) -> FilterState:
    zero = (0.0, 0.0, 0.0)
    return FilterState(
        sampled_ns=sampled_ns, fingerprint="", imu="i", quaternion_ned_from_body=(1.0, *zero), velocity_ned_m_s=zero,
        latitude_deg=0.0, longitude_deg=0.0, height_ellipsoid_m=0.0, accelerometer_bias_m_s2=zero,
        gyroscope_bias_rad_s=zero, accelerometer_scale=zero, gyroscope_scale=zero, parameters=(),
        specific_force_body_m_s2=zero, angular_rate_body_rad_s=zero, covariance=(),
    )  # fmt: skip


def envelope(message: FilterState, life: int, number: int) -> Envelope:
    return Envelope("navigation/filter_state", codec.encode(message), 0, "core.fusion", life, number)


class Broker:
    """A bus that delivers once, stops after a number of readings, and stores what is published."""

    process, incarnation, connected, stopping = "core.fusion", LIFE, True, False
    state_dir = Path("nothing was saved")

    def __init__(self, inbox: list[Envelope], readings: int = 1) -> None:
        self.rejects: Counter[str] = Counter()
        self.last_error: str | None = None
        self.dropped = 0
        self.published: list[Message] = []
        self.readings_s: list[float] = []
        self._inbox, self._readings = inbox, readings

    def now_ns(self) -> int:
        return 0

    def receive(self, _timeout_s: float) -> list[Envelope]:
        self.readings_s.append(time.monotonic())
        self.stopping = len(self.readings_s) >= self._readings
        inbox, self._inbox = self._inbox, []
        return inbox

    def publish(self, message: Message, **_at_once: bool) -> None:
        self.published.append(message)

    def flush(self) -> None:
        """There is nothing to write."""


class StoringProcess:
    """A process that stores what it received."""

    def __init__(self) -> None:
        self.messages: list[Message] = []

    def handle(self, message: Message) -> tuple[Message, ...]:
        self.messages.append(message)
        return ()


def test_a_process_receives_states_of_an_earlier_incarnation_and_not_its_own() -> None:
    bus, process = Broker([envelope(state(1), OLD_LIFE, 7), envelope(state(2), LIFE, 1)]), StoringProcess()
    LiveReactor(process, cast(Bus, bus)).run()
    assert [m for m in process.messages if not isinstance(m, Tick)] == [state(1)]
    (journal,) = [m for m in bus.published if isinstance(m, ConsumptionOrder)]
    assert [run for run in journal.runs if run[0] != "tick"] == [
        ("navigation/filter_state", "core.fusion", OLD_LIFE, 7, 1)
    ]


def test_a_process_with_a_pause_reads_the_bus_no_more_often_than_that() -> None:
    bus, process = Broker([envelope(state(1), OLD_LIFE, 7)], readings=4), StoringProcess()
    started_s = time.monotonic()
    LiveReactor(process, cast(Bus, bus), pause_s=0.05).run()
    waits_s = np.diff([started_s, *bus.readings_s])
    assert len(waits_s) == 4
    assert min(waits_s) >= 0.05
    assert state(1) in process.messages


class Faulty(StoringProcess):
    """A process that cannot handle what it is told to."""

    def handle(self, message: Message) -> tuple[Message, ...]:
        if getattr(message, "sampled_ns", 0) < 0:
            raise OverflowError("too large")
        return super().handle(message)


def test_a_message_that_a_process_cannot_handle_costs_itself_and_is_said() -> None:
    bus, process = Broker([envelope(state(n), OLD_LIFE, k) for k, n in enumerate((1, -2, 3))]), Faulty()
    LiveReactor(process, cast(Bus, bus)).run()
    assert [m for m in process.messages if not isinstance(m, Tick)] == [state(1), state(3)]
    assert bus.rejects["fault"] == 1 and bus.last_error == "OverflowError: too large"
    (journal,) = [m for m in bus.published if isinstance(m, ConsumptionOrder)]
    assert ("navigation/filter_state", "core.fusion", OLD_LIFE, 0, 3) in journal.runs, "so that it can be repeated"


def test_the_third_message_that_a_process_cannot_handle_ends_it() -> None:
    bus, process = Broker([envelope(state(-1), OLD_LIFE, k) for k in range(3)]), Faulty()
    with pytest.raises(TooManyFaults):
        LiveReactor(process, cast(Bus, bus)).run()


@pytest.mark.parametrize(("received_ns", "used"), [(MIN_DATE_NS - 1, False), (MIN_DATE_NS, True)])
def test_a_message_that_arrived_before_1980_or_after_2100_is_one_reject(received_ns: int, used: bool) -> None:
    raw = CanRaw(received_ns=received_ns, source="can0", data=b"")
    bus, process = Broker([Envelope("can/raw", codec.encode(raw), 0, "sensors.can", 1, 1)]), StoringProcess()
    LiveReactor(process, cast(Bus, bus)).run()
    assert (raw in process.messages, bus.rejects["stamp"]) == (used, int(not used))


class SlowProcess(StoringProcess):
    """A process that takes a tenth of a second for each portion, on a clock of its own."""

    def __init__(self, clock: list[float]) -> None:
        super().__init__()
        self._clock = clock

    def handle(self, message: Message) -> tuple[Message, ...]:
        self._clock[0] += 0.1
        return super().handle(message)


@pytest.mark.parametrize("one_long_message", [True, False])
def test_the_bus_is_served_within_a_long_batch_so_that_the_heartbeat_goes_on(
    one_long_message: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    raw = [GnssRaw(received_ns=MIN_DATE_NS + k, source="g", data=bytes(PORTION_BYTES)) for k in range(20)]
    if one_long_message:
        raw = [GnssRaw(received_ns=MIN_DATE_NS, source="g", data=bytes(1 << 19))]
    inbox = [Envelope("gnss/raw", codec.encode(gnss_raw), 0, "sensors.gnss", 1, k) for k, gnss_raw in enumerate(raw)]
    bus, process = Broker(inbox, readings=6), SlowProcess(clock)
    LiveReactor(process, cast(Bus, bus)).run()
    portions = [m for m in process.messages if isinstance(m, GnssRaw)]
    assert b"".join(m.data for m in portions) == b"".join(gnss_raw.data for gnss_raw in raw), (
        "nothing is lost or repeated"
    )
    assert len(portions) in (16, 20) and max(len(m.data) for m in portions) == PORTION_BYTES
    assert max(np.diff(bus.readings_s[: len(portions) // 2])) <= SERVE_S + 0.11


def test_frames_that_cannot_be_cut_are_handled_as_they_are() -> None:
    frames = CamFrames(received_ns=MIN_DATE_NS, source="v", data=bytes(1 << 19))
    assert list(portions(frames)) == [frames]


def test_what_arrives_meanwhile_is_consumed_and_the_oldest_of_too_much_is_dropped() -> None:
    ahead = [envelope(state(k), OLD_LIFE, k) for k in range(QUEUE_LENGTH + 3)]
    bus, process = Broker(ahead), StoringProcess()
    LiveReactor(process, cast(Bus, bus)).run()
    stamps = [m.sampled_ns for m in process.messages if isinstance(m, FilterState)]
    assert stamps == list(range(3, QUEUE_LENGTH + 3)) and bus.dropped == 3


def test_the_journal_of_a_long_burst_is_divided_among_messages_that_the_broker_passes_on() -> None:
    life = 4 * 10**18
    journal = Journal(64 * "p", life)
    for number in range(2 * MAX_RUNS + 1):
        journal.add(Envelope(64 * "t", b"", 1, producer=64 * "q", incarnation=life, sequence=2 * number))
    parts = list(journal.take())
    assert [run[3] for part in parts for run in part.runs] == [2 * number for number in range(2 * MAX_RUNS + 1)]
    assert max(len(codec.encode(part)) for part in parts) + 300 <= BY_NAME["consumed/+"].most_bytes
    assert list(journal.take()) == []
