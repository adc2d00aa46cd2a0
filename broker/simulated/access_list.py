"""The access list: who may read and write which topic, in the format of Mosquitto's `acl_file`."""

from dataclasses import dataclass

from .topic_filters import is_filter, matches, overlap

READS = frozenset(("read", "readwrite"))
WRITES = frozenset(("write", "readwrite"))
ACCESSES = READS | WRITES | {"deny"}
REMEMBERED = 1_000  # answers


@dataclass(frozen=True, slots=True)
class Rule:
    """One `topic` line."""

    access: str
    pattern: str


class AclError(ValueError):
    """A line that is not understood."""


class Acl:
    """Rules of each user; those before the first `user` line are for clients without a name."""

    def __init__(self, rules: dict[str | None, list[Rule]]) -> None:
        self.rules = rules
        self._answers: dict[tuple[str | None, str, bool], bool] = {}

    def may_read(self, user: str | None, topic: str) -> bool:
        """Whether a message on this topic may reach the user."""
        return self._ask(user, topic, write=False)

    def may_write(self, user: str | None, topic: str) -> bool:
        """Whether the user may publish to this topic."""
        return self._ask(user, topic, write=True)

    def may_subscribe(self, user: str | None, pattern: str) -> bool:
        """Whether a filter could ever bring the user a message."""
        return any(rule.access in READS and overlap(rule.pattern, pattern) for rule in self.rules.get(user, ()))

    def _ask(self, user: str | None, topic: str, *, write: bool) -> bool:
        question = (user, topic, write)
        answer = self._answers.get(question)
        if answer is None:
            if len(self._answers) >= REMEMBERED:
                self._answers.clear()
            answer = self._answers[question] = self._judge(user, topic, WRITES if write else READS)
        return answer

    def _judge(self, user: str | None, topic: str, accesses: frozenset[str]) -> bool:
        found = {rule.access for rule in self.rules.get(user, ()) if matches(rule.pattern, topic)}
        return "deny" not in found and not accesses.isdisjoint(found)


def parse(text: str) -> Acl:
    """Read an access list; raises AclError with the number of the line."""
    rules: dict[str | None, list[Rule]] = {}
    user: str | None = None
    for number, line in enumerate(text.splitlines(), 1):
        word, _, rest = line.strip().partition(" ")
        rest = rest.strip()
        if not word or word.startswith("#"):
            continue
        if word == "user" and rest:
            user = rest
        elif word == "topic" and rest:
            rules.setdefault(user, []).append(_rule(rest, number))
        else:
            raise AclError(f"line {number} is neither `user NAME` nor `topic ACCESS PATTERN`: {line.strip()}")
    return Acl(rules)


def _rule(words: str, number: int) -> Rule:
    access, _, pattern = words.partition(" ")
    if access not in ACCESSES:
        access, pattern = "readwrite", words
    pattern = pattern.strip()
    if not is_filter(pattern):
        raise AclError(f"line {number}: {pattern!r} is not a topic filter")
    return Rule(access, pattern)
