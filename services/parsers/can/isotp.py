"""Joins the frames of a message of several frames: ISO 15765-2:2016, receiver only.

Flow control is sent by the driver, where it asks for anything. Lengths have 12 bits: the longer ones of the standard
have no use in OBD.
"""

from collections import Counter

from .candump import CanFrame

MAX_MESSAGES = 32  # at a time, of all senders
FRAME_TIMEOUT_NS = 1_000_000_000  # N_Cr: between two consecutive frames


class MessageJoiner:
    """Joins messages by interface and identifier.

    Rejects are `isotp_order` (a frame is missing), `isotp_timeout`, `isotp_length` and `isotp_full`; a consecutive
    frame without a first one is none, since a log may begin anywhere.
    """

    def __init__(self, rejects: Counter[str]) -> None:
        self._rejects = rejects
        # Length, bytes so far, next number, time of the newest frame.
        self._messages: dict[tuple[str, int], tuple[int, bytes, int, int]] = {}

    def take(self, frame: CanFrame) -> bytes | None:
        """The message that a frame completes: alone, or as the last of several; None if it completes none."""
        data, key = frame.data, (frame.interface, frame.identifier)
        kind = data[0] >> 4 if data else None
        if kind == 0:
            return self._single(data)
        if kind == 1:
            self._first(frame, key)
            return None
        return self._consecutive(frame, key) if kind == 2 else None

    def _single(self, data: bytes) -> bytes | None:
        # A length of 0 in a frame of more than eight bytes is followed by the length (CAN FD).
        start, length = (2, data[1]) if data[0] == 0 and len(data) > 8 else (1, data[0])
        if 0 < length <= len(data) - start:
            return data[start : start + length]
        self._rejects["isotp_length"] += 1
        return None

    def _first(self, frame: CanFrame, key: tuple[str, int]) -> None:
        data = frame.data
        length = (data[0] & 0x0F) << 8 | data[1] if len(data) > 1 else 0
        self._messages.pop(key, None)
        if len(data) < 8 or length <= len(data) - 2:
            self._rejects["isotp_length"] += 1
            return
        if len(self._messages) >= MAX_MESSAGES:
            self._drop_old(frame.time_ns)
        if len(self._messages) >= MAX_MESSAGES:
            self._rejects["isotp_full"] += 1
            return
        self._messages[key] = length, data[2:], 1, frame.time_ns

    def _consecutive(self, frame: CanFrame, key: tuple[str, int]) -> bytes | None:
        if key not in self._messages:
            return None
        length, joined, number, newest_ns = self._messages.pop(key)
        if abs(frame.time_ns - newest_ns) > FRAME_TIMEOUT_NS:
            self._rejects["isotp_timeout"] += 1
            return None
        if frame.data[0] & 0x0F != number & 0x0F:
            self._rejects["isotp_order"] += 1
            return None
        joined += frame.data[1:]
        if len(joined) >= length:
            return joined[:length]
        if len(frame.data) < 8:  # only the last frame may be shorter
            self._rejects["isotp_length"] += 1
            return None
        self._messages[key] = length, joined, number + 1, frame.time_ns
        return None

    def _drop_old(self, now_ns: int) -> None:
        old = [key for key, entry in self._messages.items() if abs(now_ns - entry[3]) > FRAME_TIMEOUT_NS]
        for key in old:
            del self._messages[key]
        self._rejects["isotp_timeout"] += len(old)
