"""Configures a receiver: asks, checks the answer, asks again with back-off, and at last goes on with what there is."""

from collections.abc import Iterator

from shared.messages.gnss import GnssConfiguration, GnssConfigure

NS = 1_000_000_000
BACK_OFF_S = (2.0, 4.0, 8.0)  # before each further attempt
PATIENCE_S = 6.0  # the parser answers in 3 s, even for a receiver that does not


class Dialogue:
    """The configuration of one receiver.

    `configuring` says what is being asked, `fault` why the last attempt of all failed; each is None otherwise.
    """

    def __init__(self, source: str, period_s: float, messages: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
        self.configuring: str | None = None
        self.fault: str | None = None
        self._source, self._period_s, self._messages, self._optional = source, period_s, messages, optional
        self._request_id: int | None = None  # of the question that waits for an answer
        self._due_ns = 0  # of the next question, or of the answer
        self._attempts = 0

    def start(self, now_ns: int) -> Iterator[GnssConfigure]:
        """Ask for the first time, or anew after the receiver was away."""
        self._attempts, self.fault = 0, None
        yield self._ask(now_ns)

    def tick(self, now_ns: int) -> Iterator[GnssConfigure]:
        """Ask again when it is time."""
        if self.configuring is None or now_ns < self._due_ns:
            return
        if self._request_id is not None:
            self._fail("parsers.gnss does not answer", now_ns)
        else:
            yield self._ask(now_ns)

    def answer(self, configuration: GnssConfiguration, now_ns: int) -> None:
        """Take an answer; one to an older question, as the broker may have kept, does not count."""
        if configuration.request_id != self._request_id:
            return
        if configuration.accepted:
            self._request_id = self.configuring = None
        else:
            self._fail(configuration.reason or "it did not say why", now_ns)

    def _ask(self, now_ns: int) -> GnssConfigure:
        self._attempts += 1
        # The number of a question must differ from those of earlier lives: the time does.
        self._request_id = now_ns
        self._due_ns = now_ns + round(PATIENCE_S * NS)
        self.configuring = (
            f"asking the receiver {self._source} for a fix every {self._period_s:g} s"
            f" (attempt {self._attempts} of {len(BACK_OFF_S) + 1})"
        )
        return GnssConfigure(
            request_id=now_ns, source=self._source, navigation_period_s=self._period_s, messages=self._messages,
            optional_messages=self._optional,
        )  # fmt: skip

    def _fail(self, reason: str, now_ns: int) -> None:
        self._request_id = None
        if self._attempts > len(BACK_OFF_S):
            self.configuring, self.fault = None, reason
        else:
            self._due_ns = now_ns + round(BACK_OFF_S[self._attempts - 1] * NS)
