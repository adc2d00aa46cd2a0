"""RTCM 3 on the port of a receiver: as that of a base; counted by type, and not used."""

from collections.abc import Iterator

from shared.messages.operation import MessageUse

from .dialect import Dialect, Output


class RtcmDialect(Dialect):
    """Names messages by their number; corrections come by `sensors.corrections`, and not from the receiver."""

    name = "RTCM"

    def kind(self, frame: bytes) -> str:
        """Name by the message number."""
        return str(frame[3] << 4 | frame[4] >> 4)

    def use(self, kind: str) -> MessageUse:
        """None is used."""
        return MessageUse.UNUSED

    def take(self, frame: bytes, received_ns: int) -> Iterator[Output]:
        """Nothing follows from it."""
        return iter(())
