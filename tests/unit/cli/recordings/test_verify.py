import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cli.recordings.repetition import Repetition, Verdict
from cli.recordings.verify import verify
from shared.bus.bus import Envelope
from shared.errors import UserError
from shared.evidence import KeyFile, keys_folder
from shared.evidence.outcome import OTHER_RELEASE
from shared.messages.base import Message, Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import LastPosition
from shared.messages.operation import Mode, ModeState, ProcessHealth, ProcessState
from shared.messages.vehicle import CanRaw, VehicleSpeed
from shared.recording import RecordingWriter, channels, writer
from shared.recording.seals import Sealer
from shared.runtime.config import parse_vehicle
from shared.runtime.live import Journal, Reactor, load_process
from tests.support.bus.envelopes import sent
from tests.support.patience import HANGS_S

SECOND = 1_000_000_000
START_NS = 1_790_000_000 * SECOND
INCARNATION = START_NS + 5


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The state folder, with the key that signs."""
    folder = tmp_path / "state"
    monkeypatch.setenv("OBU_STATE", str(folder))
    monkeypatch.delenv("OBU_KEYS", raising=False)
    return folder


def signed_writer(path: Path, vehicle_toml: str = "") -> RecordingWriter:
    sealer = Sealer(KeyFile(keys_folder(Path(os.environ["OBU_STATE"]))).signer(), vehicle="car")
    return RecordingWriter(path, vehicle="car", vehicle_toml=vehicle_toml, sealer=sealer)


class Echo:
    """Publishes the sum of the speeds, and its negative at the end: its messages depend on all inputs."""

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


class RecordedProcess:
    """A process under the live runtime, with everything recorded."""

    def __init__(self, name: str, process: Reactor) -> None:
        self.name, self.process = name, process
        self.now_ns = START_NS
        self.envelopes: list[Envelope] = []
        self.order = Journal(name, INCARNATION)
        self._sequences = {name: 0}

    def input(self, message: Message, producer: str = "sensors.can") -> None:
        self.now_ns += SECOND // 10
        self.publish(producer, message)
        self.consume(self.envelopes[-1])

    def consume(self, envelope: Envelope) -> None:
        self.order.add(envelope)
        self.feed(envelope.decode())

    def tick(self) -> None:
        tick = Tick(now_ns=self.now_ns)
        self.order.add_tick(tick)
        self.feed(tick)

    def feed(self, message: Message) -> None:
        for answer in self.process.handle(message):
            self.publish(self.name, answer)

    def journal(self) -> None:
        consumed = next(self.order.take(), None)
        assert consumed is not None
        self.publish(self.name, consumed)

    def close(self) -> None:
        self.order.add_close()
        self.journal()

    def health(self) -> None:
        health = ProcessHealth(
            process=self.name, state=ProcessState.READY, incarnation=INCARNATION, sent_ns=self.now_ns
        )
        self.publish(self.name, health)

    def publish(self, producer: str, message: Message) -> None:
        self._sequences[producer] = self._sequences.get(producer, 0) + 1
        self.envelopes.append(sent(message, self.now_ns, producer, INCARNATION, self._sequences[producer]))

    def repeat(self, process: Reactor) -> Repetition:
        """Repeat the incarnation from the recorded inputs."""
        store = {(e.topic, e.producer, e.incarnation, e.sequence): e for e in self.envelopes}
        repetition = Repetition(self.name, INCARNATION, process, store.get)
        for envelope in self.envelopes:
            if envelope.producer != self.name:
                continue
            of_runtime = envelope.topic.startswith(("health/", "consumed/"))
            if not repetition.add_message(envelope, compare=not of_runtime):
                continue
            message = envelope.decode()
            if envelope.topic.startswith("consumed/"):
                repetition.add_journal(message, envelope.received_ns)  # type: ignore[arg-type]  # by its topic
            repetition.advance(envelope.received_ns)
        repetition.advance(self.now_ns, last=True)
        return repetition

    def index(self, topic: str, nth: int = 0) -> int:
        return [k for k, e in enumerate(self.envelopes) if e.topic == topic and e.producer == self.name][nth]


def echo_incarnation(seconds: int = 20, *, ended: bool = True) -> RecordedProcess:
    recorded = RecordedProcess("core.fusion", Echo())
    recorded.health()
    for k in range(seconds * 10):
        recorded.input(speed(0.1 * k, recorded.now_ns))
        if k % 5 == 0:
            recorded.health()
        if k % 10 == 9:
            recorded.tick()
            recorded.journal()
    if ended:
        for message in Echo.close(recorded.process):  # type: ignore[arg-type]  # it is one
            recorded.publish(recorded.name, message)
        recorded.close()
    return recorded


def test_a_repeated_incarnation_publishes_the_same() -> None:
    repetition = echo_incarnation().repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert (repetition.consumed, repetition.compared, repetition.unrecorded) == (220, 221, 0)


def test_an_incarnation_that_continues_is_compared_up_to_the_end_of_its_journal() -> None:
    recorded = echo_incarnation(ended=False)
    for k in range(4):
        recorded.input(speed(k, recorded.now_ns))

    repetition = recorded.repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert repetition.compared == 220


@pytest.mark.parametrize("topic", ["vehicle/speed", "mode/state"])
def test_one_changed_byte_is_reported(topic: str) -> None:
    recorded = echo_incarnation()
    at = recorded.index(topic, 7)
    old = recorded.envelopes[at]
    place = max(i for i, byte in enumerate(old.payload) if chr(byte).isdigit())
    other = b"3" if old.payload[place : place + 1] == b"7" else b"7"
    recorded.envelopes[at] = old._replace(payload=old.payload[:place] + other + old.payload[place + 1 :])
    repetition = recorded.repeat(Echo())

    assert repetition.verdict is Verdict.DIFFERENT
    assert repetition.reason is not None
    assert repetition.reason.startswith(f"message {old.sequence}: {topic} byte {place}: was ")


def test_another_arithmetic_of_the_inputs_is_different() -> None:
    class Doubling(Echo):
        def handle(self, message: Message) -> Iterator[Message]:
            self.total *= 1.0 if isinstance(message, Tick) else 1.0 + 1e-15
            yield from super().handle(message)

    assert echo_incarnation().repeat(Doubling()).verdict is Verdict.DIFFERENT


def test_a_process_that_publishes_more_or_less_is_different() -> None:
    class VerboseProcess(Echo):
        def handle(self, message: Message) -> Iterator[Message]:
            yield from super().handle(message)
            if isinstance(message, VehicleSpeed) and message.received_ns == START_NS + 18 * SECOND:
                yield speed(1.0, 1)

    class ReticentProcess(Echo):
        def close(self) -> Iterator[Message]:
            yield from ()

    assert echo_incarnation().repeat(VerboseProcess()).verdict is Verdict.DIFFERENT
    shy = echo_incarnation().repeat(ReticentProcess())
    assert shy.verdict is Verdict.DIFFERENT
    assert shy.reason == "message 282: was vehicle/speed, now nothing"


def test_a_process_that_now_ends_by_an_error_is_reported() -> None:
    class EndingProcess(Echo):
        def handle(self, message: Message) -> Iterator[Message]:
            yield from super().handle(message)
            if self.total > 5.0:
                raise ZeroDivisionError("too much")

    repetition = echo_incarnation().repeat(EndingProcess())

    assert repetition.verdict is Verdict.DIFFERENT
    assert repetition.reason == "it now ends by ZeroDivisionError: too much"


def test_messages_missing_in_the_recording_are_skipped_and_counted() -> None:
    recorded = echo_incarnation()
    for topic, nth in (("vehicle/speed", 3), ("vehicle/speed", 60), ("mode/state", 5), ("health/core.fusion", 4)):
        del recorded.envelopes[recorded.index(topic, nth)]

    repetition = recorded.repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert (repetition.compared, repetition.unrecorded) == (218, 3)


def test_a_missing_input_makes_a_repetition_incomplete_and_is_named() -> None:
    recorded = echo_incarnation()
    k = [n for n, e in enumerate(recorded.envelopes) if e.producer == "sensors.can"][50]
    del recorded.envelopes[k]

    repetition = recorded.repeat(Echo())

    assert repetition.verdict is Verdict.INCOMPLETE
    assert repetition.reason == "it consumed vehicle/speed 51 of sensors.can, which is not recorded"


def test_a_missing_part_of_the_journal_is_incomplete_rather_than_different() -> None:
    recorded = echo_incarnation()
    del recorded.envelopes[recorded.index("consumed/core.fusion", 3)]

    repetition = recorded.repeat(Echo())

    assert repetition.verdict is Verdict.INCOMPLETE
    assert repetition.reason is not None
    assert repetition.reason.startswith("1 of its messages are not recorded, then ")


def test_messages_delivered_twice_are_compared_once() -> None:
    recorded = echo_incarnation()
    doubled = [recorded.index("mode/state", nth) for nth in (2, 9)] + [recorded.index("consumed/core.fusion", 4)]
    for at in sorted(doubled, reverse=True):
        recorded.envelopes.insert(at + 40, recorded.envelopes[at])

    repetition = recorded.repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert repetition.compared == 221


def test_a_saved_message_that_the_process_publishes_and_consumes_is_an_input() -> None:
    recorded = RecordedProcess("core.fusion", Echo())
    recorded.publish("core.fusion", speed(5.0, 1))
    recorded.order.add(recorded.envelopes[-1])
    recorded.feed(speed(5.0, 1))
    for _ in range(10):
        recorded.input(speed(1.0, recorded.now_ns))
    recorded.journal()

    repetition = recorded.repeat(Echo())

    assert repetition.verdict is Verdict.IDENTICAL
    assert (repetition.consumed, repetition.compared) == (11, 11)


def test_an_incarnation_without_a_journal_is_reported_as_such() -> None:
    recorded = RecordedProcess("core.fusion", Echo())
    recorded.health()

    assert recorded.repeat(Echo()).verdict is Verdict.NO_JOURNAL


def candump(k: int) -> CanRaw:
    now_ns = START_NS + (k + 1) * SECOND // 10
    line = f"({now_ns // SECOND}.{now_ns % SECOND:09d}) can0 7E8#03410D{k % 200:02X}00000000\n"
    return CanRaw(received_ns=now_ns, source="can0", data=line.encode())


def can_recording(path: Path, change: Callable[[list[Envelope]], None] = lambda envelopes: None) -> Path:
    """Record parsers.can as the unit does, and change something afterwards."""
    process = load_process("parsers.can", parse_vehicle(""))
    recorded = RecordedProcess("parsers.can", process)  # type: ignore[arg-type]  # it is one, by its layer
    for k in range(300):
        recorded.input(candump(k))
        if k % 10 == 9:
            recorded.tick()
            recorded.journal()
    change(recorded.envelopes)
    writer = signed_writer(path, '[vehicle]\nname = "car"\n')
    for envelope in recorded.envelopes:
        writer.write(envelope)
    writer.close()
    return path


def test_a_recorded_process_is_verified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify([can_recording(tmp_path / "a.mcap")], None, None) == 0
    out = capsys.readouterr().out
    assert "parsers.can" in out
    assert "identical" in out


def test_a_recording_with_a_changed_message_is_different(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify([can_recording(tmp_path / "a.mcap", forge_a_speed)], "parsers.can", None) == 1
    captured = capsys.readouterr()
    assert "different" in captured.out
    assert "vehicle/speed byte " in captured.err


def forge_a_speed(envelopes: list[Envelope]) -> None:
    k = [n for n, e in enumerate(envelopes) if e.topic == "vehicle/speed"][10]
    old = envelopes[k]
    envelopes[k] = old._replace(payload=old.payload.replace(b'"speed_m_s":', b'"speed_m_s":1'))


def other_version(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(writer, "VERSION", "0.0.9")


def other_schema(patch: pytest.MonkeyPatch) -> None:
    def schema_of(topic: str) -> tuple[str, bytes] | None:
        name, schema = channels.schema_of(topic) or ("", b"{}")
        return name, schema.replace(b"speed_m_s", b"speed") if topic == "vehicle/speed" else schema

    patch.setattr(writer, "schema_of", schema_of)


@pytest.mark.parametrize("other", [other_version, other_schema])
def test_a_difference_in_what_another_release_has_made_is_its_release(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    other: Callable[[pytest.MonkeyPatch], None],
) -> None:
    with monkeypatch.context() as patch:
        other(patch)
        differs = can_recording(tmp_path / "a.mcap", forge_a_speed)
        same = can_recording(tmp_path / "b.mcap")
    assert verify([differs], None, None, as_json=True) == OTHER_RELEASE
    [found] = json.loads(capsys.readouterr().out)["processes"]
    assert found["verdict"] == "other_release" and found["reason"]
    assert verify([same], None, None) == 0, "what is identical needs no other release"


def test_words_about_a_field_make_no_other_release(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        described = [channels.schema_of("vehicle/speed")]
        assert described[0] is not None
        other = json.dumps({**json.loads(described[0][1]), "description": "of before"}).encode()
        patch.setattr(writer, "schema_of", lambda topic: ("VehicleSpeed", other) if topic == "vehicle/speed" else None)
        path = can_recording(tmp_path / "a.mcap", forge_a_speed)
    assert verify([path], None, None) == 1


def test_an_incarnation_in_two_files_is_verified_if_both_are_given(tmp_path: Path) -> None:
    whole: list[Envelope] = []
    can_recording(tmp_path / "all.mcap", whole.extend)
    for name, part in (("a.mcap", whole[:300]), ("b.mcap", whole[300:])):
        writer = signed_writer(tmp_path / name)
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


def test_a_retained_message_is_found_by_an_incarnation_that_begins_much_later(tmp_path: Path) -> None:
    """It is consumed at once, and a newer one follows before the journal that names it."""
    process = load_process("core.fusion", parse_vehicle(""))
    recorded = RecordedProcess("core.fusion", process)  # type: ignore[arg-type]  # it is one, by its layer
    kept = LastPosition(
        sampled_ns=START_NS, latitude_deg=48.0, longitude_deg=11.0, height_ellipsoid_m=500.0, yaw_rad=1.0,
        position_sd_ned_m=(1.0, 1.0, 2.0), yaw_sd_rad=0.02,
    )  # fmt: skip
    recorded.publish("controller.mode", kept)
    (retained,) = recorded.envelopes
    for _ in range(100):
        recorded.now_ns += SECOND
        recorded.publish("sensors.can", candump(1))
    recorded.consume(retained)
    recorded.publish("controller.mode", kept)
    recorded.input(GnssFix(sampled_ns=recorded.now_ns, received_ns=recorded.now_ns, source="g", fix_type=FixType.NONE))
    recorded.journal()
    writer = signed_writer(tmp_path / "a.mcap", '[vehicle]\nname = "car"\n')
    for envelope in recorded.envelopes:
        writer.write(envelope)
    writer.close()
    assert verify([tmp_path / "a.mcap"], "core.fusion", None) == 0


def test_user_errors_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"cannot read .*missing\.mcap"):
        verify([tmp_path / "missing.mcap"], None, None)
    with pytest.raises(UserError, match=r"'sensors.imu' cannot be repeated; name one of controller.cam"):
        verify([can_recording(tmp_path / "a.mcap")], "sensors.imu", None)


def test_a_check_that_sigterm_ends_has_not_succeeded(tmp_path: Path) -> None:
    """Of a pipe, on which it waits for bytes."""
    pipe = tmp_path / "drive.mcap"
    os.mkfifo(pipe)
    process = subprocess.Popen([sys.executable, "-m", "cli", "verify", str(pipe)], stderr=subprocess.PIPE)
    deadline = time.monotonic() + HANGS_S
    while True:
        try:
            writer = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
            break
        except OSError:  # nobody reads yet
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
    process.terminate()
    _, errors = process.communicate(timeout=HANGS_S)
    os.close(writer)
    assert process.returncode == 143 and b"Traceback" not in errors
