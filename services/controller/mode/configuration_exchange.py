"""Configures a receiver: sends a request, checks the response, and retries a limited number of times with back-off."""

from collections.abc import Iterator

from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssOutput

NS = 1_000_000_000
BACK_OFF_S = (2.0, 4.0, 8.0)  # delay before each further attempt
TIMEOUT_S = 30.0  # the parser responds within 3 s, or to a receiver of generation 8 within 25 s, in any case


class ConfigurationExchange:
    """The configuration exchange with one receiver.

    `configuring` describes the request in progress, `fault` the reason why the last attempt failed; otherwise None.
    """

    def __init__(self, source: str, period_s: float, outputs: tuple[GnssOutput, ...], model: str | None) -> None:
        self.configuring: str | None = None
        self.fault: str | None = None
        self._source, self._period_s, self._outputs, self._model = source, period_s, outputs, model
        self._request_id: int | None = None  # of the request that waits for a response
        self._due_ns = 0  # time of the next request, or timeout of the response
        self._attempts = 0

    def start(self, now_ns: int) -> Iterator[GnssConfigure]:
        """Send the first request, also after the receiver was disconnected."""
        self._attempts, self.fault = 0, None
        yield self._request(now_ns)

    def tick(self, now_ns: int) -> Iterator[GnssConfigure]:
        """Send the next attempt when it is due."""
        if self.configuring is None or now_ns < self._due_ns:
            return
        if self._request_id is not None:
            self._fail("no response from parsers.gnss", now_ns)
        else:
            yield self._request(now_ns)

    def response(self, configuration: GnssConfiguration, now_ns: int) -> None:
        """Process a response; a response to an earlier request (e.g. retained by the broker) is ignored."""
        if configuration.request_id != self._request_id:
            return
        if configuration.accepted:
            self._request_id = self.configuring = None
        else:
            self._fail(configuration.reason or "no reason given", now_ns)

    def _request(self, now_ns: int) -> GnssConfigure:
        self._attempts += 1
        # The time is an identifier that is unique over restarts of the process.
        self._request_id = now_ns
        self._due_ns = now_ns + round(TIMEOUT_S * NS)
        self.configuring = (
            f"requesting a fix every {self._period_s:g} s from the receiver {self._source}"
            f" (attempt {self._attempts} of {len(BACK_OFF_S) + 1})"
        )
        return GnssConfigure(
            request_id=now_ns, source=self._source, navigation_period_s=self._period_s, outputs=self._outputs,
            dynamic_model=self._model,
        )  # fmt: skip

    def _fail(self, reason: str, now_ns: int) -> None:
        self._request_id = None
        if self._attempts > len(BACK_OFF_S):
            self.configuring, self.fault = None, reason
        else:
            self._due_ns = now_ns + round(BACK_OFF_S[self._attempts - 1] * NS)
