"""`monitoring.health` for a simulated unit: envelopes in, its messages out."""

from collections.abc import Sequence

from services.monitoring.health.watch import Watch
from shared.bus.bus import Envelope
from shared.messages.base import Message
from shared.messages.operation import ProcessHealth, RecordingState

REPORT_NS = 500_000_000


class Watchdog:
    """Feeds a `Watch` as `monitoring.health` does."""

    def __init__(self, expected: Sequence[str], now_ns: int) -> None:
        self.watch = Watch(tuple(expected), now_ns)
        self._next_report_ns = now_ns

    def take(self, envelope: Envelope, message: Message | None) -> None:
        """Receive one message, decoded if it is valid."""
        self.watch.take(
            envelope.topic, envelope.payload,
            producer=envelope.producer, received_ns=envelope.received_ns, retained=envelope.retained,
        )  # fmt: skip
        if isinstance(message, ProcessHealth):
            self.watch.take_health(message, envelope.received_ns, retained=envelope.retained)
        elif isinstance(message, RecordingState):
            self.watch.take_recording(message)

    def step(self, now_ns: int, *, connected: bool) -> list[Message]:
        """Advance the time; return what `monitoring.health` publishes."""
        messages: list[Message] = [*self.watch.step(now_ns, connected=connected)]
        if connected and self.watch.answering and now_ns >= self._next_report_ns:
            self._next_report_ns = now_ns + REPORT_NS
            messages.append(self.watch.report(now_ns))
        return messages
