from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cli.recordings.verify import verify
from cli.recordings.verifying import Repetition, Verdict
from shared.bus.bus import Envelope
from shared.errors import UserError
from shared.messages.base import Message, Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import LastPosition
from shared.messages.operation import Mode, ModeState, ProcessHealth, ProcessState
from shared.messages.vehicle import CanRaw, VehicleSpeed
from shared.recording import RecordingWriter
from shared.runtime.config import parse_vehicle
from shared.runtime.live import Journal, Reactor, load_process
from tests.support.envelopes import sent

SECOND = 1_000_000_000
START_NS = 1_790_000_000 * SECOND
LIFE = START_NS + 5


class Echo:
    """Publishes the speed that it was given, and the sum at the end: its output depends on all that it consumed."""

    def __init__(self) -> None:
        self.total = 0.0

    def handle(self, message: Message) -> Iterator[Message]:
        if isinstance(message, VehicleSpeed):
            self.total += message.speed_m_s
            yield speed(self.total, message.received_ns)
        elif isinstance(message, Tick):
            state = ModeState(sampled_ns=message.now_ns, mode=Mode.BOOT, since_ns=0, reason=f"{self.total}")
            yield state

    def close(self) -> Iterator[Message]:
        yield speed(-self.total, 0)


def speed(value: float, now_ns: int) -> VehicleSpeed:
    return VehicleSpeed(sampled_ns=now_ns, received_ns=now_ns, source="a", speed_m_s=value)


class Recorded:
    """A process that runs as the live runtime runs it, while a recorder listens."""

    def __init__(self, name: str, process: Reactor) -> None:
        self.name, self.process = name, process
        self.now_ns = START_NS
        self.envelopes: list[Envelope] = []
        self._journal = Journal(name, LIFE)
        self._sequences = {name: 0}

    def input(self, message: Message, producer: str = "sensors.can") -> None:
        self.now_ns += SECOND // 10
        self.say(producer, message)
        self.consume(self.envelopes[-1])

    def consume(self, envelope: Envelope) -> None:
        self._journal.add(envelope)
        self.feed(envelope.decode())

    def tick(self) -> None:
        tick = Tick(now_ns=self.now_ns)
        self._journal.add_tick(tick)
        self.feed(tick)

    def feed(self, message: Message) -> None:
        for answer in self.process.handle(message):
            self.say(self.name, answer)

    def journal(self) -> None:
        consumed = self._journal.take()
        assert consumed is not None
        self.say(self.name, consumed)

    def close(self) -> None:
        self._journal.add_close()
        self.journal()

    def health(self) -> None:
        health = ProcessHealth(process=self.name, state=ProcessState.READY, incarnation=LIFE, sent_ns=self.now_ns)
        self.say(self.name, health)

    def say(self, producer: str, message: Message) -> None:
        self._sequences[producer] = self._sequences.get(producer, 0) + 1
        self.envelopes.append(sent(message, self.now_ns, producer, LIFE, self._sequences[producer]))

    def repeat(self, process: Reactor) -> Repetition:
        """Do the life again from what was recorded."""
        store = {(e.topic, e.producer, e.incarnation, e.sequence): e for e in self.envelopes}
        repetition = Repetition(self.name, LIFE, process, store.get)
        for envelope in self.envelopes:
            if envelope.producer != self.name:
                continue
            of_runtime = envelope.topic.startswith(("health/", "consumed/"))
            if not repetition.add_published(envelope, compare=not of_runtime):
                continue
            message = envelope.decode()
            if envelope.topic.startswith("consumed/"):
                repetition.add_journal(message, envelope.received_ns)  # type: ignore[arg-type]  # the topic says so
            repetition.advance(envelope.received_ns)
        repetition.advance(self.now_ns, last=True)
        return repetition

    def index(self, topic: str, nth: int = 0) -> int:
        return [k for k, e in enumerate(self.envelopes) if e.topic == topic and e.producer == self.name][nth]


def echo_life(seconds: int = 20, *, ended: bool = True) -> Recorded:
    life = Recorded("core.fusion", Echo())
    life.health()
    for k in range(seconds * 10):
        life.input(speed(0.1 * k, life.now_ns))
        if k % 5 == 0:
            life.health()
        if k % 10 == 9:
            life.tick()
            life.journal()
    if ended:
        for message in Echo.close(life.process):  # type: ignore[arg-type]  # it is one
            life.say(life.name, message)
        life.close()
    return life


def test_a_life_done_again_says_the_same() -> None:
    repetition = echo_life().repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert (repetition.consumed, repetition.compared, repetition.unrecorded) == (220, 221, 0)


def test_a_life_that_goes_on_is_compared_as_far_as_its_journal_goes() -> None:
    life = echo_life(ended=False)
    for k in range(4):
        life.input(speed(k, life.now_ns))

    repetition = life.repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert repetition.compared == 220


@pytest.mark.parametrize("topic", ["vehicle/speed", "mode/state"])
def test_one_changed_byte_is_found_and_shown(topic: str) -> None:
    life = echo_life()
    at = life.index(topic, 7)
    old = life.envelopes[at]
    life.envelopes[at] = old._replace(payload=old.payload[:-3] + b"7" + old.payload[-2:])
    repetition = life.repeat(Echo())

    assert repetition.verdict is Verdict.DIFFERENT
    assert repetition.reason is not None
    assert repetition.reason.startswith(f"message {old.sequence}: {topic} byte {len(old.payload) - 3}: recorded ")


def test_another_order_of_consumption_is_not_the_same_life() -> None:
    class Doubling(Echo):
        def handle(self, message: Message) -> Iterator[Message]:
            self.total *= 1.0 if isinstance(message, Tick) else 1.0 + 1e-15
            yield from super().handle(message)

    assert echo_life().repeat(Doubling()).verdict is Verdict.DIFFERENT


def test_a_process_that_now_says_more_or_less_differs() -> None:
    class Chatty(Echo):
        def handle(self, message: Message) -> Iterator[Message]:
            yield from super().handle(message)
            if isinstance(message, VehicleSpeed) and message.received_ns == START_NS + 18 * SECOND:
                yield speed(1.0, 1)

    class Shy(Echo):
        def close(self) -> Iterator[Message]:
            yield from ()

    assert echo_life().repeat(Chatty()).verdict is Verdict.DIFFERENT
    shy = echo_life().repeat(Shy())
    assert shy.verdict is Verdict.DIFFERENT
    assert shy.reason == "message 282: published vehicle/speed, now nothing"


def test_a_process_that_now_dies_is_told_and_not_a_crash_of_the_check() -> None:
    class Mortal(Echo):
        def handle(self, message: Message) -> Iterator[Message]:
            yield from super().handle(message)
            if self.total > 5.0:
                raise ZeroDivisionError("too much")

    repetition = echo_life().repeat(Mortal())

    assert repetition.verdict is Verdict.DIFFERENT
    assert repetition.reason == "now it ends by ZeroDivisionError: too much"


def test_words_that_the_recorder_missed_are_skipped_and_counted() -> None:
    life = echo_life()
    for topic, nth in (("vehicle/speed", 3), ("vehicle/speed", 60), ("mode/state", 5), ("health/core.fusion", 4)):
        del life.envelopes[life.index(topic, nth)]

    repetition = life.repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert (repetition.compared, repetition.unrecorded) == (218, 3)


def test_a_missing_input_makes_a_life_incomplete_and_is_named() -> None:
    life = echo_life()
    k = [n for n, e in enumerate(life.envelopes) if e.producer == "sensors.can"][50]
    del life.envelopes[k]

    repetition = life.repeat(Echo())

    assert repetition.verdict is Verdict.INCOMPLETE
    assert repetition.reason == "it consumed vehicle/speed 51 of sensors.can, which is not recorded"


def test_a_missing_part_of_the_journal_is_incomplete_rather_than_different() -> None:
    life = echo_life()
    del life.envelopes[life.index("consumed/core.fusion", 3)]

    repetition = life.repeat(Echo())

    assert repetition.verdict is Verdict.INCOMPLETE
    assert repetition.reason is not None
    assert repetition.reason.startswith("1 of its messages are not recorded, then ")


def test_messages_delivered_twice_are_compared_once() -> None:
    life = echo_life()
    doubled = [life.index("mode/state", nth) for nth in (2, 9)] + [life.index("consumed/core.fusion", 4)]
    for at in sorted(doubled, reverse=True):
        life.envelopes.insert(at + 40, life.envelopes[at])

    repetition = life.repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert repetition.compared == 221


def test_a_saved_message_that_the_process_says_and_consumes_itself_is_an_input() -> None:
    life = Recorded("core.fusion", Echo())
    life.say("core.fusion", speed(5.0, 1))
    life._journal.add(life.envelopes[-1])
    life.feed(speed(5.0, 1))
    for _ in range(10):
        life.input(speed(1.0, life.now_ns))
    life.journal()

    repetition = life.repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert (repetition.consumed, repetition.compared) == (11, 11)


def test_a_life_without_a_journal_says_so() -> None:
    life = Recorded("core.fusion", Echo())
    life.health()

    assert life.repeat(Echo()).verdict is Verdict.NO_JOURNAL


def candump(k: int) -> CanRaw:
    now_ns = START_NS + (k + 1) * SECOND // 10
    line = f"({now_ns // SECOND}.{now_ns % SECOND:09d}) can0 7E8#03410D{k % 200:02X}00000000\n"
    return CanRaw(received_ns=now_ns, source="can0", data=line.encode())


def can_recording(path: Path, change: Callable[[list[Envelope]], None] = lambda envelopes: None) -> Path:
    """Record parsers.can as the unit does, and change something afterwards."""
    process = load_process("parsers.can", parse_vehicle(""))
    life = Recorded("parsers.can", process)  # type: ignore[arg-type]  # it is one, by its layer
    for k in range(300):
        life.input(candump(k))
        if k % 10 == 9:
            life.tick()
            life.journal()
    change(life.envelopes)
    writer = RecordingWriter(path, vehicle="car", vehicle_toml='[vehicle]\nname = "car"\n')
    for envelope in life.envelopes:
        writer.write(envelope)
    writer.close()
    return path


def test_a_recorded_process_is_verified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify([can_recording(tmp_path / "a.mcap")], None, None) == 0
    out = capsys.readouterr().out
    assert "parsers.can" in out
    assert "identical" in out


def test_a_recording_with_a_changed_word_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def forge(envelopes: list[Envelope]) -> None:
        k = [n for n, e in enumerate(envelopes) if e.topic == "vehicle/speed"][10]
        old = envelopes[k]
        envelopes[k] = old._replace(payload=old.payload.replace(b'"speed_m_s":', b'"speed_m_s":1'))

    assert verify([can_recording(tmp_path / "a.mcap", forge)], "parsers.can", None) == 1
    captured = capsys.readouterr()
    assert "different" in captured.out
    assert "vehicle/speed byte " in captured.err


def test_a_life_that_goes_over_two_files_is_verified_when_both_are_given(tmp_path: Path) -> None:
    whole: list[Envelope] = []
    can_recording(tmp_path / "all.mcap", whole.extend)
    for name, part in (("a.mcap", whole[:300]), ("b.mcap", whole[300:])):
        writer = RecordingWriter(tmp_path / name)
        for envelope in part:
            writer.write(envelope)
        writer.close()

    assert verify([tmp_path / "a.mcap", tmp_path / "b.mcap"], None, None) == 0
    assert verify([tmp_path / "b.mcap"], None, None) == 1


def test_nothing_compared_is_not_success(tmp_path: Path) -> None:
    def only_inputs(envelopes: list[Envelope]) -> None:
        envelopes[:] = [e for e in envelopes if e.topic != "vehicle/speed" and not e.topic.startswith("consumed/")]

    with pytest.raises(UserError, match="holds no message of a process"):
        verify([can_recording(tmp_path / "a.mcap", only_inputs)], None, None)


def test_what_the_broker_keeps_is_found_by_a_life_that_begins_much_later(tmp_path: Path) -> None:
    """It is consumed at once, and a newer one follows before the journal says so."""
    process = load_process("core.fusion", parse_vehicle(""))
    life = Recorded("core.fusion", process)  # type: ignore[arg-type]  # it is one, by its layer
    kept = LastPosition(
        sampled_ns=START_NS, latitude_deg=48.0, longitude_deg=11.0, height_ellipsoid_m=500.0, yaw_rad=1.0,
        position_sd_ned_m=(1.0, 1.0, 2.0), yaw_sd_rad=0.02,
    )  # fmt: skip
    life.say("controller.mode", kept)
    (retained,) = life.envelopes
    for _ in range(100):
        life.now_ns += SECOND
        life.say("sensors.can", candump(1))
    life.consume(retained)
    life.say("controller.mode", kept)
    life.input(GnssFix(sampled_ns=life.now_ns, received_ns=life.now_ns, source="g", fix_type=FixType.NONE))
    life.journal()
    writer = RecordingWriter(tmp_path / "a.mcap", vehicle="car", vehicle_toml='[vehicle]\nname = "car"\n')
    for envelope in life.envelopes:
        writer.write(envelope)
    writer.close()
    assert verify([tmp_path / "a.mcap"], "core.fusion", None) == 0


def test_mistakes_of_the_user_are_told_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"cannot read .*missing\.mcap"):
        verify([tmp_path / "missing.mcap"], None, None)
    with pytest.raises(UserError, match=r"'sensors.imu' cannot be repeated; name one of controller.cam"):
        verify([can_recording(tmp_path / "a.mcap")], "sensors.imu", None)
