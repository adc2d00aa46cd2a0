"""The choice of a source, and what is stated of each."""

from collections.abc import Sequence

from services.parsers.corrections.process import Config, Process
from shared.messages.base import Tick
from shared.messages.corrections import (
    MAX_CORRECTION_SOURCES,
    MAX_CORRECTION_TYPES,
    CorrectionBytes,
    CorrectionSource,
    CorrectionSources,
    CorrectionsState,
    GnssCorrection,
    SourcePhase,
)
from tests.support.gnss.frames import rtcm, spartn

S = 1_000_000_000
FRAME = rtcm(1005, 19)


class Run:
    """A parser with two sources, in the order a, b; time in seconds."""

    def __init__(self, names: Sequence[str] = ("a", "b")) -> None:
        self.process = Process(Config(silent_s=30.0, settle_s=10.0))
        connections = tuple(CorrectionSource(source=name, phase=SourcePhase.RECEIVING, reason="") for name in names)
        list(self.process.handle(CorrectionSources(now_ns=S, sources=connections)))

    def send(self, source: str, at_s: float, data: bytes = FRAME) -> list[GnssCorrection]:
        message = CorrectionBytes(received_ns=round(at_s * S), source=source, data=data)
        return [out for out in self.process.handle(message) if isinstance(out, GnssCorrection)]

    def state(self, at_s: float) -> CorrectionsState:
        (state,) = self.process.handle(Tick(now_ns=round(at_s * S)))
        assert isinstance(state, CorrectionsState)
        return state


def test_the_first_frame_of_any_source_is_used_and_a_better_source_must_deliver_for_a_while() -> None:
    run = Run()
    assert run.send("b", 2) and run.state(2).active == "b"
    used = [(second, bool(run.send("a", second)), bool(run.send("b", second))) for second in range(3, 20)]
    assert [second for second, a, _ in used if a] == list(range(13, 20))  # ten seconds after its first frame
    assert [second for second, _, b in used if b] == list(range(3, 13))


def test_after_silence_the_next_source_is_used_and_an_interrupted_better_one_begins_anew() -> None:
    run = Run()
    assert run.send("a", 2)
    assert not run.send("b", 31)
    assert run.send("b", 33) and run.state(33).active == "b"  # a is silent for 31 s
    run.send("a", 34)
    assert run.send("b", 60) and not run.send("a", 65)  # its frames of 34 s are 31 s old: it begins anew
    assert run.state(70).active == "b" and run.state(100).active is None


def test_protocols_of_one_portion_are_separate_messages_and_each_type_is_counted() -> None:
    run = Run()
    sent = run.send("a", 2, FRAME + spartn(0, 0) + spartn(1, 2) + FRAME)
    assert [(gnss_correction.protocol, gnss_correction.frames) for gnss_correction in sent] == [
        ("rtcm3", 1),
        ("spartn", 2),
        ("rtcm3", 1),
    ]
    assert b"".join(gnss_correction.data for gnss_correction in sent) == FRAME + spartn(0, 0) + spartn(1, 2) + FRAME
    assert run.state(3).types == {"RTCM 1005 station position": 2, "SPARTN OCB GPS": 1, "SPARTN HPAC Galileo": 1}


def test_sources_and_types_are_bounded() -> None:
    run = Run([str(k) for k in range(MAX_CORRECTION_SOURCES)])
    assert not run.send("one too many", 2) and run.process.rejects["too_many_sources"] == 1
    for number in range(1001, 1101):
        run.send("0", 3, rtcm(number, 10))
    types = run.state(4).types
    assert len(types) == MAX_CORRECTION_TYPES + 1 and types["other"] == 100 - MAX_CORRECTION_TYPES


def test_a_source_of_bytes_without_frames_is_said_to_be_wrong() -> None:
    run = Run()
    run.send("a", 2, b"$GPGGA,this is no correction\r\n" * 20)
    state = run.state(3)
    assert state.active is None and "is this the right mount point" in state.streams[0].reason
    assert "a: sends bytes, but no frame" in state.reason
    assert state.streams[0].received_bytes == 600 and state.streams[0].frames == 0


def test_a_source_that_the_driver_does_not_name_any_more_is_forgotten() -> None:
    run = Run()
    run.send("b", 2)
    only = CorrectionSource(source="a", phase=SourcePhase.CONNECTED, reason="")
    (state,) = run.process.handle(CorrectionSources(now_ns=3 * S, sources=(only,)))
    assert isinstance(state, CorrectionsState) and state.active is None and [s.source for s in state.streams] == ["a"]
