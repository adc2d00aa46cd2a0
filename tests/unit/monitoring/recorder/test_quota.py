"""A flood on one topic, or of one process, leaves the room of the others alone, and is counted."""

from pathlib import Path

from services.monitoring.recorder.codes import Code
from services.monitoring.recorder.process import Config, Process
from services.monitoring.recorder.quota import MAX_BUDGETS, TOPIC_SHARE, Quota
from shared.bus.bus import Envelope
from shared.messages.explanation import topic
from shared.messages.operation import RecordingState
from shared.recording import Recording
from tests.support.bus.envelopes import sent_bytes
from tests.support.bus.fake_bus import FakeBus

START_NS = 1_790_000_000_000_000_000
RATE = 1000.0  # bytes a second
TOTAL = 80_000  # bytes: 10,000 of a topic at once
SECOND_NS = 10**9


def envelope(topic: str, size: int, *, producer: str = "controller.mode", number: int = 1) -> Envelope:
    payload = b'{"n":"' + b"x" * (size - 8) + b'"}'
    return sent_bytes(topic, payload, START_NS, producer, 1, number)


def test_a_topic_gets_its_share_at_once_and_its_rate_after_that() -> None:
    quota, one = Quota(RATE, TOTAL), envelope("gnss/raw", 400)
    size = len(one.payload)
    assert len(quota.admitted([one] * 100, START_NS)) == TOTAL // TOPIC_SHARE // size
    assert len(quota.admitted([one] * 100, START_NS + 5 * SECOND_NS)) in (5000 // size, 5000 // size + 1)
    assert quota.left_out >= 200 - (TOTAL // TOPIC_SHARE + 5000) // size - 1


def test_other_topics_are_recorded_while_one_floods() -> None:
    quota = Quota(RATE, TOTAL)
    quota.admitted([envelope("gnss/raw", 900, producer="sensors.gnss")] * 100, START_NS)
    assert len(quota.admitted([envelope("mode/state", 900)], START_NS)) == 1
    complaint = quota.complaint(START_NS)
    assert complaint is not None and complaint.code == Code.FLOOD
    assert complaint.values["senders"] == (topic("gnss/raw"),)
    assert quota.complaint(START_NS + 11 * SECOND_NS) is None, "a flood is over some time after its last message"


def test_a_process_cannot_evade_its_limit_by_many_topics() -> None:
    quota = Quota(RATE, TOTAL)
    topics = ("gnss/raw", "imu/raw", "can/raw", "v2x/raw")
    flood = [envelope(name, 400, producer="sensors.simulator") for name in topics for _ in range(100)]
    admitted = quota.admitted(flood, START_NS)
    assert sum(len(e.payload) for e in admitted) <= 2 * TOTAL // TOPIC_SHARE
    complaint = quota.complaint(START_NS)
    assert complaint is not None and "sensors.simulator" in str(complaint.values["senders"])


def test_invented_names_take_no_memory() -> None:
    quota = Quota(RATE, TOTAL)
    for number in range(5 * MAX_BUDGETS):
        quota.admitted([envelope("mode/state", 20, producer=f"process{number}")], START_NS)
    assert len(quota._budgets) <= MAX_BUDGETS + 2


def test_the_recorder_counts_and_says_what_it_leaves_out(tmp_path: Path) -> None:
    def script(call: int) -> list[Envelope] | None:
        flood = [envelope("gnss/raw", 2000, producer="sensors.gnss", number=call * 100 + k) for k in range(100)]
        return [*flood, envelope("mode/state", 100, number=call)] if call < 40 else None

    bus = FakeBus(tmp_path, script, start_ns=START_NS)
    Process(Config(minimum_free_bytes=0, maximum_topic_bytes_per_s=RATE, maximum_total_bytes=TOTAL)).run(bus.as_bus())

    states = [message for message in bus.published if isinstance(message, RecordingState)]
    assert states[-1].recording and states[-1].left_out > 2900
    assert states[-1].flood and "gnss/raw" in states[-1].flood
    most = (TOTAL // TOPIC_SHARE + 4 * RATE) / 2000  # an eighth of the room, and 1 kB a second
    assert 4000 - most <= bus.rejects["flood"] < 4000 - most / 2
    (path,) = (tmp_path / "recordings").glob("*.mcap")
    with Recording(path) as recording:
        assert [m.sequence for m in recording if m.topic == "mode/state"] == list(range(40))
