"""UBX of u-blox: frames, the question for the version, and reasons of rejects.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), sections 3.2 and 3.4.
"""

from collections.abc import Callable

from ..maths.crc import fletcher
from .framing.finder import Sums
from .framing.framing import Framing
from .protocol import Protocol, Question, Reason

SYNC = b"\xb5\x62"
MAX_PAYLOAD = 4096  # [bytes] RXM-RAWX of 120 signals is 3856
MAX_CORRECTION_PAYLOAD = 528  # [bytes] of RXM-PMP; RXM-SPARTNKEY with its two keys has 84
_SYNC_SUM = sum(SYNC)


class UbxFraming(Framing):
    """Two sync bytes, class, number, length, payload, Fletcher's checksum."""

    protocol, begins = "UBX", ((SYNC[:1], SYNC[1:]),)
    starts = rb"\xb5\x62(?s:.){3}[\x00-\x10]"
    begun = rb"\xb5(?:\x62(?s:.){0,3})?"
    malformed = too_long = "ubx_length"
    most_bytes = 8 + MAX_PAYLOAD

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """By the length in the header."""
        return None if header < 6 else 8 + (buffer[start + 5] << 8 | buffer[start + 4])

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """Compare the checksum, which is of what lies between the sync bytes and itself."""
        s, w, _ = at(start)
        s, w = s + _SYNC_SUM, w + 2 * s + _SYNC_SUM + SYNC[0]
        s_end, w_end, _ = at(stop - 2)
        a, b = s_end - s & 0xFF, w_end - w - (stop - start - 4) * s & 0xFF
        return None if a == buffer[stop - 2] and b == buffer[stop - 1] else "ubx_checksum"


class UbxCorrectionFraming(UbxFraming):
    """The two messages that carry corrections: any other one could change the configuration of the receiver."""

    starts = rb"\xb5\x62\x02[\x36\x72](?s:.)[\x00-\x02]"
    begun = rb"\xb5(?:\x62(?:\x02(?:[\x36\x72](?s:.)?)?)?)?"
    malformed = "ubx_no_correction"
    most_bytes = 8 + MAX_CORRECTION_PAYLOAD


def ubx_frame(group: int, number: int, payload: bytes) -> bytes:
    """Frame a message of a class and number."""
    body = bytes((group, number)) + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + fletcher(body)


_DAMAGED = "check ground and the length of the cable, and that the rate of the port carries what is sent"
PROTOCOL = Protocol(
    UbxFraming(), "u-blox UBX", frozenset(("gnss",)),
    questions={"gnss": Question(ubx_frame(0x0A, 0x04, b""))},  # UBX-MON-VER
    reasons={
        "ubx_checksum": Reason("a UBX message with a wrong checksum", _DAMAGED),
        "ubx_length": Reason("a UBX header with a length beyond 4096 bytes, mostly damage", _DAMAGED),
        "ubx_short": Reason("a UBX message that is shorter than its kind", "bring the receiver's firmware up to date"),
        "ubx_date": Reason("an impossible date; the fix is used without UTC", "wait for satellites; check the antenna"),
        "ubx_fix_type": Reason("a kind of fix that is not defined", "bring the receiver's firmware up to date"),
        "ubx_covariance": Reason("a covariance of NAV-COV that is not positive definite; it is not used",
                                 "bring the receiver's firmware up to date"),
        "ubx_time_of_week": Reason("a time of week beyond 604,800 s", "wait for satellites; restart the receiver"),
        "ubx_navigation_words": Reason("subframes of RXM-SFRBX of another length than their signal has",
                                       "bring the receiver's firmware up to date"),
        "ubx_version": Reason("a version of a message that is not read", "report it with the firmware's version"),
        "ubx_signal_without_fix": Reason("signal quality of an epoch whose fix did not come",
                                         "check that the rate of the port carries what is sent"),
        "epoch_without_fix": Reason("an epoch without a message that says whether there is a fix",
                                    "switch NAV-PVT on, or NAV-POSLLH, VELNED and STATUS together"),
        "repeated_epoch": Reason("the receiver's time stands still", "restart the receiver"),
        "ubx_no_correction": Reason("a UBX message in a source of corrections that carries none; it is not passed on",
                                    "let the source send RXM-PMP, RXM-SPARTNKEY, SPARTN or RTCM 3 alone"),
    },
)  # fmt: skip
