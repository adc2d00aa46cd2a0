"""ELM327 adapters and their clones: requests to the vehicle, and its answers as frames. Without clock and port.

An ELM327 is a dialogue in text: a command ends with a carriage return, its answer with the prompt `>`. It sends nothing
unasked. `ElmDevice` in `elm327_device.py` gives `Elm327` bytes and time, and writes what it returns.

Sources: ELM Electronics, "ELM327 OBD to RS232 Interpreter" (ELM327DSJ), sections "Talking to the ELM327", "AT Command
Summary", "Error Messages and Alerts", "Interpreting Trouble Codes" and "Multiline Responses".
"""

import re
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..messages.operation import DeviceFound
from .elm327_lines import AnswerLines, ElmFrame

RATES = (38400, 9600, 115200, 230400, 500000)  # of adapters as delivered; 38400 is the ELM327's own
MAX_BYTES = 4096  # of one answer: the longest has 4095 bytes, but the adapter's own memory holds 512
MAX_LINE = 64  # an identifier and eight bytes, with blanks: 32
MAX_PENDING = 8  # requests that wait for the adapter
RESET_S = 4.0  # ATZ: an original takes about 1 s, and slow clones three times that
COMMAND_S = 2.0
REQUEST_S = 12.0  # the search for the vehicle's protocol tries up to ten
NOT_SENT_S = 0.2  # before a port that accepts no bytes is tried again
ATTEMPTS = 2  # resets at one rate
LOST_PROMPTS = 3  # after which the adapter is reset
FAILURES = 3  # requests without an answer, after which the vehicle counts as asleep: one PID may be unknown to it
FIRST_REST_S, LONGEST_REST_S = 2.0, 60.0  # between requests to a vehicle that does not answer
NO_ANSWER = "no answer"
FIRST_REQUEST = "0100"  # PIDs that are supported: every vehicle answers it, and the adapter finds out the protocol
FUNCTIONAL = (0x7DF, 0x18DB33F1)  # the adapter's own request identifiers
PROTOCOLS = {
    "1": "SAE J1850 PWM", "2": "SAE J1850 VPW", "3": "ISO 9141-2", "4": "ISO 14230-4 (5 baud)", "5": "ISO 14230-4",
    "6": "ISO 15765-4, 11 bit, 500 kbit/s", "7": "ISO 15765-4, 29 bit, 500 kbit/s",
    "8": "ISO 15765-4, 11 bit, 250 kbit/s", "9": "ISO 15765-4, 29 bit, 250 kbit/s", "A": "SAE J1939",
}  # fmt: skip
ERRORS = (
    "NO DATA", "UNABLE TO CONNECT", "BUS INIT", "CAN ERROR", "BUS ERROR", "BUS BUSY", "FB ERROR", "DATA ERROR",
    "RX ERROR", "BUFFER FULL", "STOPPED", "ACT ALERT", "LP ALERT", "ERR",
)  # fmt: skip
BUS_FAULTS = ("CAN ERROR", "BUS ERROR", "FB ERROR", "BUS BUSY")
NO_BUS = ("UNABLE TO CONNECT", "BUS INIT")
_NOISE = re.compile(rb"[^\x09\x0a\x0d\x20-\x7e]")
_BANNER = re.compile(r"[ -~]{0,16}(ELM ?327|OBD|STN\d|V\d\.\d)[ -~]{0,24}")  # of clones as well: `OBDII v1.5`


@dataclass
class _Command:
    """What was sent, and what ends the wait for its answer."""

    text: str
    until_s: float
    is_request: bool = False


class Elm327:
    """One adapter.

    Parameters
    ----------
    rate_baud : int or None
        Rate of its port; None of one without a rate, such as a socket.
    request_identifier : int
        CAN identifier of the requests: 7DF and 18DB33F1 are functional ones, others are physical.
    """

    def __init__(self, rate_baud: int | None, request_identifier: int) -> None:
        self.found = DeviceFound.SEARCHING
        self.rejects: Counter[str] = Counter()
        self.rate_baud = self._configured_baud = rate_baud
        self._rates = () if rate_baud is None else (rate_baud, *(rate for rate in RATES if rate != rate_baud))
        self._identifier = request_identifier
        self._name = ""
        self._protocol = ""
        self._setup: deque[str] = deque()
        self._waiting: _Command | None = None
        self._pending: deque[str] = deque()
        self._buffer = b""
        self._noise_bytes = 0
        self._answer_bytes = 0
        self._attempts = 0  # resets without an answer
        self._lost = 0  # prompts in succession
        self._error = NO_ANSWER  # of the last request that failed
        self._request_error = NO_ANSWER  # of the present request
        self._answered = False  # whether the present request has an answer
        self._rest_s, self._next_request_s = 0.0, 0.0
        self._lines = AnswerLines()
        self._failures = 0  # requests in succession without an answer
        self._set_rate = False

    @property
    def protocols(self) -> tuple[str, ...]:
        """The adapter, and the protocol of the vehicle once it has answered."""
        return tuple(name for name in (self._name[:64], PROTOCOLS.get(self._protocol, "")) if name)

    @property
    def ready(self) -> bool:
        """Whether the adapter is set up."""
        return bool(self._name) and not self._setup

    def request(self, payload: bytes) -> bool:
        """Queue a request, such as 01 0D; false where too many wait. One that waits already is not queued again."""
        text = payload.hex().upper()
        if text in self._pending or (self._waiting is not None and self._waiting.text == text):
            return True
        if len(self._pending) >= MAX_PENDING:
            return False
        self._pending.append(text)
        return True

    def take_rate(self) -> int | None:
        """The rate to which the port must be set now; None: as it is."""
        changed, self._set_rate = self._set_rate, False
        return self.rate_baud if changed else None

    def take(self, data: bytes, now_s: float) -> Iterator[ElmFrame]:
        """Use bytes that arrived; yield the frames of the completed lines."""
        clean = _NOISE.sub(b"", data)  # 00 and FF come now and then, as the data sheet warns, and noise at a wrong rate
        if noise := len(data) - len(clean):
            self._noise_bytes += noise
            self.rejects["adapter_byte"] += noise
        self._buffer += clean
        *lines, self._buffer = re.split(rb"[\r\n]|(?<=>)", self._buffer)
        if len(self._buffer) > MAX_LINE:
            self.rejects["adapter_line"] += 1
            self._buffer = b""
        for line in lines:
            yield from self._line(line.decode("ascii").strip(), now_s)

    def due(self, now_s: float) -> bytes:
        """Bytes that must be written now; empty while an answer is awaited or nothing is to be asked."""
        if self._waiting is not None:
            if now_s < self._waiting.until_s:
                return b""
            self._lose_prompt(now_s)
        if not self._name:
            return self._reset(now_s)
        if self._setup:
            return self._send(self._setup.popleft(), now_s, COMMAND_S)
        if self._pending and now_s >= self._next_request_s:
            self._answered, self._request_error = False, NO_ANSWER
            text = self._pending.popleft() if self._protocol else FIRST_REQUEST
            return self._send(text, now_s, REQUEST_S, is_request=True)
        return b""

    def not_sent(self, now_s: float) -> None:
        """The port has not accepted what `due` returned: it is tried again soon."""
        if self._waiting is not None:
            if self._waiting.text == "ATZ":
                self._attempts -= 1
            self._waiting.until_s = now_s + NOT_SENT_S

    def sentence(self) -> str:
        """What was found, and what to do about it."""
        at = f" at {self.rate_baud} baud" if self.rate_baud else ""
        if not self._name:
            return self._no_adapter(at)
        known = ", ".join(self.protocols)
        rate = ""
        if self.rate_baud != self._configured_baud:
            rate = f", not at the {self._configured_baud} of the vehicle file: write baud={self.rate_baud} in its URL"
        if self.found is DeviceFound.WORKING:
            headers = "; it ignores ATH1, so answers count as the engine's" * self._lines.without_identifiers
            return f"{known}{at}{rate}{headers}"
        if self.found is DeviceFound.SEARCHING:
            return f"{known}{at}{rate}: set up, the vehicle has not been asked yet"
        if self.found is DeviceFound.NOISE:
            return (
                f"{known}{at}: it answers, and states {self._error}: check the plug, and that no other device "
                "disturbs the bus"
            )
        asked = f"; it is asked every {self._rest_s:g} s" if self._rest_s else ""
        return (
            f"{known}{at}: the adapter answers and the vehicle does not ({self._error}): switch the "
            f"ignition on, and check that the plug is pushed in{asked}"
        )

    def _no_adapter(self, at: str) -> str:
        if self.found is DeviceFound.SEARCHING:
            return f"waiting for the adapter{at}"
        tried = f" at {', '.join(str(rate) for rate in sorted(self._rates))} baud" if self._rates else ""
        if self.found is DeviceFound.NOISE:
            return f"bytes that are no answer of an ELM327{tried}: check that this is the adapter, and its rate"
        return (
            f"the adapter does not answer{tried}: check that it is plugged in and paired, that its light is on, and "
            "that no other program is connected to it"
        )

    def _reset(self, now_s: float) -> bytes:
        """Set the adapter up from the beginning, at the next rate after some attempts."""
        if self._attempts and self._attempts % ATTEMPTS == 0:
            if len(self._rates) > 1:
                place = self._rates.index(self.rate_baud or 0)
                self.rate_baud = self._rates[(place + 1) % len(self._rates)]
                self._set_rate = True
            if self._attempts >= ATTEMPTS * max(len(self._rates), 1):
                self.found = DeviceFound.NOISE if self._noise_bytes else DeviceFound.SILENT
        self._attempts += 1
        self._buffer, self._protocol, self._lines = b"", "", AnswerLines()
        # A clone that is busy takes the first character as an interruption: the carriage return ends what it does.
        return b"\r" * (self._attempts > 1) + self._send("ATZ", now_s, RESET_S)

    def _setup_of(self) -> Sequence[str]:
        """Commands after the reset: no echo, no line feeds, no blanks, identifiers shown, protocol found out."""
        header: tuple[str, ...] = ()
        if self._identifier not in FUNCTIONAL:
            wide = self._identifier > 0x7FF
            text = f"{self._identifier:08X}"
            header = (f"ATCP{text[:2]}", f"ATSH{text[2:]}") if wide else (f"ATSH{self._identifier:03X}",)
        return "ATE0", "ATL0", "ATS0", "ATH1", "ATSP0", *header

    def _send(self, text: str, now_s: float, wait_s: float, *, is_request: bool = False) -> bytes:
        self._waiting = _Command(text, now_s + wait_s, is_request)
        self._answer_bytes = 0
        return f"{text}\r".encode()

    def _lose_prompt(self, now_s: float) -> None:
        """The time for an answer is over: a prompt was lost, or the adapter has stopped."""
        waiting, self._waiting = self._waiting, None
        if waiting is None or waiting.text == "ATZ":
            return
        self.rejects["adapter_silent"] += 1
        self._lost += 1
        if waiting.is_request and not self._answered:
            self._fail(NO_ANSWER, now_s)
        if self._lost >= LOST_PROMPTS:
            self._begin_again()

    def _begin_again(self) -> None:
        self._name, self._lost, self._attempts = "", 0, 0
        self._setup.clear()
        self._waiting = None
        self.found = DeviceFound.SEARCHING

    def _line(self, line: str, now_s: float) -> Iterator[ElmFrame]:
        self._answer_bytes += len(line)
        if self._answer_bytes > MAX_BYTES:  # an answer without end
            self.rejects["adapter_line"] += 1
            self._begin_again()
            return
        prompt = line.endswith(">")
        text = line.rstrip(">").strip().upper()
        if text:
            yield from self._text(text, now_s)
        if prompt:
            self._prompt(now_s)

    def _prompt(self, now_s: float) -> None:
        waiting, self._waiting = self._waiting, None
        self._lines.end()
        if waiting is None or (waiting.text == "ATZ" and not self._name):
            self._waiting = waiting  # of the interruption before the reset: its own answer is still to come
            return
        self._lost = 0
        if waiting.is_request and not self._answered:
            self._fail(self._request_error, now_s)
        elif waiting.is_request and not self._protocol:
            self._setup.append("ATDPN")

    def _text(self, text: str, now_s: float) -> Iterator[ElmFrame]:
        """Use one line of an answer."""
        waiting = self._waiting
        if _BANNER.fullmatch(text):
            self._banner(text)
        elif text in {"LV RESET", "<LV RESET"}:
            self._begin_again()  # its voltage broke down: it has forgotten its settings
        elif waiting is None:
            self.rejects["adapter_line"] += 1
        elif text.replace(" ", "") == waiting.text:
            return  # the echo of a clone that ignores ATE0
        elif waiting.is_request:
            yield from self._answer(text, now_s)
        elif waiting.text == "ATDPN":
            self._protocol = text.replace(" ", "").removeprefix("A")[:1] or "A"  # A6: found by itself
        elif text == "?":
            self.rejects[f"adapter_refuses_{waiting.text[:4]}"] += 1

    def _banner(self, text: str) -> None:
        waiting = self._waiting
        if waiting is None or waiting.text != "ATZ":  # it has reset itself
            self._begin_again()
        self._name, self._attempts, self._noise_bytes = text, 0, 0
        self._setup.clear()
        self._setup.extend(self._setup_of())

    def _answer(self, text: str, now_s: float) -> Iterator[ElmFrame]:
        """Use one line of the answer to a request."""
        for words in ("SEARCHING", "BUS INIT"):  # with dots, and what follows in the same line
            if text.startswith(words) and "ERROR" not in text:
                text = text[len(words) :].lstrip(":. ").removeprefix("OK").strip()
        if not text:
            return
        digits = text.replace(" ", "")  # some clones write NODATA
        if text == "?" or any(error.replace(" ", "") in digits for error in ERRORS):
            yield from self._fault(digits)
            return
        # How a line is to be read depends on the protocol, which is asked for behind the first answer.
        try:
            frame = self._lines.frame(digits, self._protocol) if self._protocol else None
        except ValueError:
            self.rejects["adapter_line"] += 1
            return
        if frame is None and self._protocol:
            return
        self._answered, self._failures, self._rest_s, self._next_request_s = True, 0, 0.0, now_s
        self.found = DeviceFound.WORKING
        if frame is not None:
            yield frame

    def _fault(self, text: str) -> Iterator[ElmFrame]:
        error = next((known for known in ERRORS if known.replace(" ", "") in text), "? (the request is not understood)")
        self._request_error = error
        self.rejects[f"adapter_{error.split(' (')[0].lower().replace(' ', '_').replace('?', 'refuses')}"] += 1
        if error in BUS_FAULTS:
            yield ElmFrame(0, False, b"", is_error=True)

    def _fail(self, error: str, now_s: float) -> None:
        """A request without an answer: a vehicle that sleeps is asked ever less often."""
        self._error = error
        self._failures += 1
        if self._failures < FAILURES and error not in NO_BUS:
            return
        self._rest_s = min(max(2.0 * self._rest_s, FIRST_REST_S), LONGEST_REST_S)
        self._next_request_s = now_s + self._rest_s
        self._pending.clear()  # what was asked meanwhile is old by then
        self.found = DeviceFound.NOISE if error in BUS_FAULTS else DeviceFound.SILENT
