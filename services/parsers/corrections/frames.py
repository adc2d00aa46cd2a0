"""Extracts frames of corrections from a byte stream that may hold invalid bytes: RTCM 3, SPARTN, and two of UBX.

Only two messages of UBX pass (RXM-PMP, RXM-SPARTNKEY): any other one could change the receiver's configuration.
"""

from collections import Counter
from dataclasses import dataclass

from shared.messages.corrections import CorrectionProtocol
from shared.protocols.framing.framer import Frame, Framer
from shared.protocols.rtcm import RtcmFraming
from shared.protocols.spartn import SpartnFraming
from shared.protocols.ubx import UbxCorrectionFraming

FRAMINGS = (RtcmFraming(), SpartnFraming(), UbxCorrectionFraming())


@dataclass(frozen=True, slots=True)
class CorrectionFrame:
    """One whole frame with a valid checksum; `kind` is the number of an RTCM message or of a SPARTN or UBX one."""

    protocol: CorrectionProtocol
    kind: tuple[int, int]
    data: bytes


class CorrectionFramer:
    """Splits the stream of a source into frames; `rejects` are those of the framings, and `judged` as in the finder."""

    def __init__(self, rejects: Counter[str] | None = None) -> None:
        self._framer = Framer(FRAMINGS, rejects)
        self.rejects = self._framer.rejects

    @property
    def judged(self) -> int:
        """Number of candidates that were checked."""
        return self._framer.judged

    def feed(self, data: bytes) -> list[CorrectionFrame]:
        """Process the next bytes; return the completed frames."""
        return [_correction(frame) for frame in self._framer.feed(data)]


def _correction(frame: Frame) -> CorrectionFrame:
    data = frame.data
    match frame.protocol:
        case "RTCM":
            return CorrectionFrame(CorrectionProtocol.RTCM3, (data[3] << 4 | data[4] >> 4, 0), data)
        case "SPARTN":
            return CorrectionFrame(CorrectionProtocol.SPARTN, (data[1] >> 1, data[4] >> 4), data)
        case _:
            return CorrectionFrame(CorrectionProtocol.UBX, (data[2], data[3]), data)
