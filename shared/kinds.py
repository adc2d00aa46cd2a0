"""Counts the messages of a device by kind: nothing that a device sends is ignored in silence."""

from collections import Counter

from .messages.operation import MAX_KINDS, MessageKind, MessageUse

OTHER_KINDS = "others"  # kinds beyond those that a table holds


class Kinds:
    """What came since the start: how often, what follows from it, and why it was rejected."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._rejected: Counter[str] = Counter()
        self._uses: dict[str, MessageUse] = {}
        self._reasons: dict[str, str] = {}
        self._expected: set[str] = set()

    def count(self, kind: str, use: MessageUse) -> None:
        """Count a message; one that is used has a row of its own, however late it comes."""
        if use is MessageUse.USED:
            self._make_room(kind[:64])
        name = self._name(kind)
        self._counts[name] += 1
        self._uses[name] = MessageUse.UNKNOWN if name == OTHER_KINDS else use

    def reject(self, kind: str, reason: str) -> None:
        """Count a reject of a message that was counted before."""
        name = self._name(kind)
        self._rejected[name] += 1
        self._reasons[name] = reason[:64]

    def expect(self, kind: str, use: MessageUse) -> None:
        """Keep room for a kind that matters however late it comes."""
        self._counts[self._name(kind)] += 0
        self._uses[kind] = use
        self._expected.add(kind)

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

    def _make_room(self, kind: str) -> None:
        """Where the table is full, add the rarest kind that is not used to the others."""
        if self._name(kind) != OTHER_KINDS:
            return
        kept = self._expected | {OTHER_KINDS}
        unused = [name for name, use in self._uses.items() if use is not MessageUse.USED and name not in kept]
        if not unused:
            return
        rarest = min(unused, key=lambda name: self._counts[name])
        self._counts[OTHER_KINDS] += self._counts.pop(rarest)
        self._rejected[OTHER_KINDS] += self._rejected.pop(rarest, 0)
        self._uses[OTHER_KINDS] = MessageUse.UNKNOWN
        del self._uses[rarest]
        if reason := self._reasons.pop(rarest, None):
            self._reasons[OTHER_KINDS] = reason

    def _name(self, kind: str) -> str:
        if kind[:64] in self._counts or len(self._counts) - (OTHER_KINDS in self._counts) < MAX_KINDS - 1:
            return kind[:64]
        return OTHER_KINDS
