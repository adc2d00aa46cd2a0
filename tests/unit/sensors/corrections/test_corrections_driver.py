"""Driver and parser together: failover, fail-back, and what each source is said to do."""

import socket
import threading
import time
from collections.abc import Callable
from itertools import pairwise

from services.parsers.corrections.process import Config as ParserConfig
from services.sensors.corrections.process import Config
from shared.messages.corrections import CorrectionProtocol, CorrectionSources, SourcePhase
from tests.support.gnss.casters import fake_caster, saying
from tests.support.gnss.correction_chain import chain
from tests.support.gnss.frames import rtcm

ICY = b"ICY 200 OK\r\n\r\n"
GOOD, SPARE = rtcm(1005, 19), rtcm(1006, 21)
QUICK = ParserConfig(silent_s=0.3, settle_s=0.2)


def sending(frame: bytes, allowed: threading.Event, head: bytes = ICY) -> Callable[[socket.socket, bytes], None]:
    """Send a frame every 20 ms while it is allowed, at most for 10 s."""

    def answer(connection: socket.socket, _request: bytes) -> None:
        connection.sendall(head)
        for _ in range(500):
            if allowed.is_set():
                connection.sendall(frame)
            time.sleep(0.02)

    return answer


def test_whole_frames_go_on_with_their_source_and_are_counted_by_type() -> None:
    on = threading.Event()
    on.set()
    with fake_caster(sending(b"noise" + GOOD, on)) as caster, chain(Config(sources=(caster.url(user="me"),))) as run:
        run.until(lambda: len(run.corrections) > 3 and run.state is not None and run.state.active is not None)
        name = f"ntrip://127.0.0.1:{caster.port}/MOUNT"
        assert {(correction.source, correction.protocol) for correction in run.corrections} == {
            (name, CorrectionProtocol.RTCM3)
        }
        assert run.data() == GOOD * (len(run.data()) // len(GOOD))
        run.until(lambda: run.state is not None and run.state.types.get("RTCM 1005 station position", 0) > 3)
        assert run.state is not None and run.state.active == name and run.stream().phase is SourcePhase.RECEIVING
        assert run.state.rejects["garbage_bytes"] >= 5 and run.bus.last_error is None
        assert all("me@" not in message.model_dump_json() for message in run.bus.published)


def test_the_next_source_takes_over_after_silence_and_the_better_one_comes_back_without_a_gap() -> None:
    first, second = threading.Event(), threading.Event()
    first.set()
    second.set()
    with (
        fake_caster(sending(GOOD, first)) as better,
        fake_caster(sending(SPARE, second)) as spare,
        chain(Config(sources=(better.url(), spare.url("SPARE")), failover_s=0.3), QUICK) as run,
    ):
        run.until(lambda: GOOD in run.data())
        assert not spare.requests  # not needed
        first.clear()
        run.until(lambda: SPARE in run.data())
        first.set()
        before = len(run.corrections)
        run.until(lambda: run.corrections[-1].data.endswith(GOOD))
        times = [correction.received_ns for correction in run.corrections[before:]]
        assert max(later - earlier for earlier, later in pairwise(times)) < 300_000_000
        run.until(lambda: any(
            said.sources[1].phase is SourcePhase.IDLE for said in run.bus.of(CorrectionSources)[-1:]
        ))  # fmt: skip


def test_a_source_that_sends_rubbish_is_replaced_and_said() -> None:
    on = threading.Event()
    on.set()
    with (
        fake_caster(sending(b"\xd3\x00\x13\x3e\xd0 rubbish", on)) as bad,
        fake_caster(sending(SPARE, on)) as spare,
        chain(Config(sources=(bad.url(), spare.url("SPARE")), failover_s=0.3), QUICK) as run,
    ):
        run.until(lambda: SPARE in run.data())
        run.until(lambda: run.state is not None and "no frame" in run.stream(0).reason)
        assert run.data() == SPARE * (len(run.data()) // len(SPARE))


def test_of_two_sources_that_both_fail_each_says_why() -> None:
    with (
        fake_caster(saying(b"HTTP/1.1 401 Unauthorized\r\n\r\n")) as locked,
        fake_caster(saying(b"SOURCETABLE 200 OK\r\n\r\nSTR;OTHER;\r\nENDSOURCETABLE\r\n")) as lost,
        chain(Config(sources=(locked.url(user="me"), lost.url("0THER")), failover_s=0.3), QUICK) as run,
    ):
        run.until(lambda: run.says("user or password", 0)() and run.says("near to it are OTHER", 1)())
        run.until(lambda: run.state is not None and "user or password" in run.state.reason)
        assert run.bus.last_error is not None and "password_file" in run.bus.last_error
