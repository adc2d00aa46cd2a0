"""The driver of corrections and its parser together, without a broker: what the parser states reaches the driver."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from services.parsers.corrections.process import Config as ParserConfig
from services.parsers.corrections.process import Process as Parser
from services.sensors.corrections.process import Config, Process
from shared.messages.base import Message, Tick
from shared.messages.corrections import CorrectionSources, CorrectionsState, CorrectionStream, GnssCorrection
from tests.support.bus.live_bus import LiveBus, running


class Chain:
    """Gives the parser what the driver has published, and the driver what the parser states."""

    def __init__(self, bus: LiveBus, parser: Parser) -> None:
        self.bus, self.parser = bus, parser
        self.corrections: list[GnssCorrection] = []
        self.state: CorrectionsState | None = None
        self._given = 0
        self._tick_ns = 0

    def pump(self) -> None:
        """Process what has come since the last call, and a tick every 50 ms."""
        for message in self.bus.published[self._given :]:
            self._given += 1
            self._take(message)
        if self.bus.now_ns() - self._tick_ns >= 50_000_000:
            self._tick_ns = self.bus.now_ns()
            self._take(Tick(now_ns=self._tick_ns))

    def until(self, condition: Callable[[], bool], within_s: float = 8.0) -> None:
        """Process messages until a condition holds."""
        deadline = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < deadline, (self.state, self.bus.last_error)
            self.pump()
            time.sleep(0.01)

    def stream(self, number: int = 0) -> CorrectionStream:
        """What is stated of a source."""
        assert self.state is not None
        return self.state.streams[number]

    def says(self, words: str, number: int = 0) -> Callable[[], bool]:
        """Whether the driver says something of a source."""
        return lambda: any(words in said.sources[number].reason for said in self.bus.of(CorrectionSources)[-2:])

    def data(self) -> bytes:
        """What has gone to the receiver."""
        return b"".join(correction.data for correction in self.corrections)

    def _take(self, message: Message) -> None:
        for output in self.parser.handle(message):
            if isinstance(output, CorrectionsState):
                self.state = output
                self.bus.deliver(output)
            else:
                self.corrections.append(output)


@contextmanager
def chain(config: Config, parser: ParserConfig | None = None) -> Iterator[Chain]:
    """Run both."""
    with running(Process(config).run) as bus:
        yield Chain(bus, Parser(parser or ParserConfig()))
