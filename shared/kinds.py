"""Counts the messages of a device by kind: nothing that a device sends is ignored in silence."""

from collections import Counter

from .messages.operation import MAX_KINDS, MessageKind, MessageUse

OTHERS = "others"  # kinds beyond those that a table holds


class Kinds:
    """What came since the start: how often, what follows from it, and why it was rejected."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._rejected: Counter[str] = Counter()
        self._uses: dict[str, MessageUse] = {}
        self._reasons: dict[str, str] = {}

    def count(self, kind: str, use: MessageUse) -> None:
        """Count a message."""
        name = self._name(kind)
        self._counts[name] += 1
        self._uses[name] = MessageUse.UNKNOWN if name == OTHERS else use

    def reject(self, kind: str, reason: str) -> None:
        """Count a reject of a message that was counted before."""
        name = self._name(kind)
        self._rejected[name] += 1
        self._reasons[name] = reason[:64]

    def expect(self, kind: str, use: MessageUse) -> None:
        """Keep room for a kind that matters however late it comes."""
        self._counts[self._name(kind)] += 0
        self._uses[kind] = use

    def table(self) -> tuple[MessageKind, ...]:
        """All kinds, those that came most often first."""
        return tuple(
            MessageKind(
                kind=name, use=self._uses[name], count=count, rejected=min(self._rejected[name], count),
                reason=self._reasons.get(name),
            )
            for name, count in self._counts.most_common()
            if count
        )  # fmt: skip

    def _name(self, kind: str) -> str:
        if kind in self._counts or len(self._counts) < MAX_KINDS - 1:
            return kind[:64]
        return OTHERS
