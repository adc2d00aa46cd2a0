"""Finds out what a device speaks, and at which rate of its port: by its bytes, never by a fix.

The state machine has no clock and no port: `RateRecognition` in `recognising.py` gives it bytes and time. It listens at
each rate first. Only then it asks at each rate, and only where it may: at a wrong rate a question is noise.
"""

from dataclasses import dataclass

from ..messages.operation import DeviceFound
from ..protocols.recognition import ProtocolCounts, recognise
from ..protocols.registry import BY_NAME, PROTOCOLS, read_at

RATES = (38400, 9600, 115200, 460800, 921600, 230400)  # of receivers as delivered, the most frequent first
LISTEN_S = 1.2  # a rate: a burst comes once a second
ANSWER_S = 0.6  # a question
SEARCH_PAUSE_S = 10.0  # after a search that found nothing, and without messages after which a new search begins
SAMPLE_BYTES = 4096


@dataclass(frozen=True)
class Step:
    """What the port has to do next."""

    before: bytes = b""  # to write at the present rate
    rate_baud: int | None = None  # to set; None: as it is
    write: bytes = b""  # to write after that


class Search:
    """One device: what was found, and the rate at which.

    Parameters
    ----------
    kind : str
        gnss or imu: what is expected at this port.
    rate_baud : int or None
        The configured rate, which is tried first; None for a device without a rate.
    may_write : bool
        Whether questions may be asked.
    """

    def __init__(self, kind: str, rate_baud: int | None, *, may_write: bool) -> None:
        self.found = DeviceFound.SEARCHING
        self.protocols: tuple[str, ...] = ()
        self.rate_baud = rate_baud
        self.remedy = "check cable, power, and that TX and RX are not exchanged"  # of silence
        self._configured_baud = rate_baud
        self._rates = () if rate_baud is None else (rate_baud, *(rate for rate in RATES if rate != rate_baud))
        asked = [protocol.questions[kind] for protocol in PROTOCOLS if kind in protocol.questions]
        self._questions = tuple(asked) if may_write else ()
        self._wanted = read_at(kind)
        self._kind = kind
        self._sample = b""
        self._noise_bytes = 0  # at all rates together
        self._other: tuple[tuple[str, ...], int | None] | None = None
        self._place = -1  # in the plan; -1 before the first step
        self._until_s = self._message_s = 0.0
        self._then = b""

    @property
    def sure(self) -> bool:
        """Whether the present rate is right, as far as is known: the bytes are worth passing on."""
        return self.found is not DeviceFound.SEARCHING or self.rate_baud == self._configured_baud

    def take(self, data: bytes, now_s: float) -> Step | None:
        """Use bytes that arrived and the time; say what to do, None: go on."""
        if self._place < 0:
            self._place, self._until_s, self._message_s = 0, now_s + LISTEN_S, now_s
        if data:
            self._sample = (self._sample + data)[-SAMPLE_BYTES:]
        if self.found is DeviceFound.SEARCHING:
            return self._search(now_s)
        return self._watch(now_s)

    def sentence(self) -> str:
        """What was found, and what to do about it."""
        at = f" at {self.rate_baud} baud" if self.rate_baud else ""
        spoken = ", ".join(self.protocols)
        match self.found:
            case DeviceFound.WORKING if self.rate_baud != self._configured_baud:
                return (
                    f"{spoken}{at}, not at the {self._configured_baud} of the vehicle file: "
                    f"write baud={self.rate_baud} in the device's URL to find it at once"
                )
            case DeviceFound.WORKING:
                return f"{spoken}{at}"
            case DeviceFound.SEARCHING:
                return f"listening{at}: no message so far"
            case DeviceFound.OTHER:
                return self._of_other(at)
            case DeviceFound.NOISE:
                return (
                    f"bytes that are no message{self._rates_tried()}: check that this is the {self._kind} device, "
                    "its rate, and that ground is connected"
                )
            case _:
                return f"no bytes{self._rates_tried()}: {self.remedy}"

    def _of_other(self, at: str) -> str:
        """What to do about a protocol that is not read at this port."""
        first = BY_NAME[self.protocols[0]]
        if first.remedy:
            return f"{first.title}{at}: not {'read at this port' if first.read_at else 'decoded'}; {first.remedy}"
        wanted = " or ".join(self._wanted)
        return f"speaks {', '.join(self.protocols)}{at}, which is not read here: set the device to send {wanted}"

    def _rates_tried(self) -> str:
        return f" at {', '.join(str(rate) for rate in sorted(self._rates))} baud" if self._rates else ""

    def _search(self, now_s: float) -> Step | None:
        seen = recognise(self._sample)
        if self._settle(seen, now_s):
            return Step(before=self._then) if self._then else None
        if now_s < self._until_s:
            return None
        self._noise_bytes += len(self._sample)
        if seen.names and self._other is None:
            self._other = seen.names, self.rate_baud
        self._sample, before, self._then = b"", self._then, b""
        self._place += 1
        rates = self._rates or (None,)
        listening, asking = len(rates), len(rates) * len(self._questions)
        if self._place < listening:
            self.rate_baud, self._until_s = rates[self._place], now_s + LISTEN_S
            return Step(before, self.rate_baud)
        if self._place < listening + asking:
            turn, which = divmod(self._place - listening, len(self._questions))
            question = self._questions[which]
            self.rate_baud, self._until_s, self._then = rates[turn], now_s + ANSWER_S, question.then
            return Step(before, self.rate_baud, question.ask)
        return self._fail(now_s, before)

    def _settle(self, seen: ProtocolCounts, now_s: float) -> bool:
        """Whether a protocol that is read here was found."""
        names = tuple(name for name in seen.names if name in self._wanted)
        certain = [name for name in names if BY_NAME[name].framing.least == 1]
        # Lines of text are a weak sign, and a question may have caused them.
        if not names or (not certain and now_s < self._until_s):
            return False
        self.found, self.protocols, self._message_s = DeviceFound.WORKING, names, now_s
        self._sample = b""
        return True

    def _fail(self, now_s: float, before: bytes) -> Step:
        """Nothing that is read here: say what there is, and rest."""
        self.rate_baud = self._configured_baud
        if self._other is not None:
            self.found, (self.protocols, self.rate_baud) = DeviceFound.OTHER, self._other
        else:
            self.found = DeviceFound.NOISE if self._noise_bytes else DeviceFound.SILENT
            self.protocols = ()
        self._until_s = self._message_s = now_s + SEARCH_PAUSE_S
        return Step(before, self.rate_baud)

    def _watch(self, now_s: float) -> Step | None:
        """Look now and then whether messages still come, and search again where they do not."""
        if now_s < self._until_s:
            return None
        seen = recognise(self._sample)
        self._until_s = now_s + LISTEN_S * 2
        if names := tuple(name for name in seen.names if name in self._wanted):
            self.found, self._message_s = DeviceFound.WORKING, now_s
            self.protocols = tuple(dict.fromkeys((*self.protocols, *names))) if self.protocols else names
        self._sample = b""
        if now_s - self._message_s < (SEARCH_PAUSE_S if self.found is DeviceFound.WORKING else 0.0):
            return None
        self.found, self._place, self._noise_bytes, self._other = DeviceFound.SEARCHING, 0, 0, None
        self._until_s, self._message_s = now_s + LISTEN_S, now_s
        self.rate_baud, self._then = self._configured_baud, b""
        return Step(rate_baud=self.rate_baud)
