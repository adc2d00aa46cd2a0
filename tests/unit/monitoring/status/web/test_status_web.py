import logging
import time
from pathlib import Path

import pytest

from services.monitoring.status.process import Config, Process
from services.monitoring.status.web.stream.websocket import Stream
from shared.bus.bus import Envelope
from shared.errors import ObuError
from tests.support.bus.fake_bus import FakeBus

START_NS = 1_795_000_000 * 10**9


def at_leisure(call: int) -> list[Envelope] | None:
    """Deliver nothing for five seconds at most."""
    time.sleep(0.02)
    return [] if call < 250 else None


def test_a_stream_that_fails_ends_the_process_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def fail(_stream: Stream) -> None:
        raise ValueError("a state that cannot be shown")

    monkeypatch.setattr(Stream, "run", fail)

    with pytest.raises(ObuError, match="the web server has ended"):
        Process(Config(port=0)).run(FakeBus(tmp_path, at_leisure, start_ns=START_NS).as_bus())

    assert "a state that cannot be shown" in caplog.text


def test_a_stop_that_was_asked_for_is_no_failure(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def briefly(call: int) -> list[Envelope] | None:
        return at_leisure(call) if call < 25 else None

    Process(Config(port=0)).run(FakeBus(tmp_path, briefly, start_ns=START_NS).as_bus())

    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]
