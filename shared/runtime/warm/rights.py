"""What a child may do: limits, user and groups. It is given, and then only less."""

import os
import resource
from dataclasses import asdict, dataclass, field

from .kernel import forbid_new_privileges


@dataclass(frozen=True)
class Rights:
    """Rights of one process; without a value it keeps those of the parent. A user comes with group and groups."""

    user: int | None = None
    group: int | None = None
    groups: tuple[int, ...] | None = None
    memory_bytes: int | None = None  # of its address space
    processes: int | None = None  # of its user, threads included
    files: int | None = None  # that are open at a time

    def __post_init__(self) -> None:
        if self.user is not None and (self.group is None or self.groups is None):
            raise ValueError(f"user {self.user} without group and groups would keep those of the parent")

    def take(self) -> None:
        """Give up every other right, in the order in which each step is still allowed."""
        for number, value in (
            (resource.RLIMIT_AS, self.memory_bytes), (resource.RLIMIT_NPROC, self.processes),
            (resource.RLIMIT_NOFILE, self.files),
        ):  # fmt: skip
            if value is not None:
                resource.setrlimit(number, (value, value))
        if self.groups is not None:
            os.setgroups(self.groups)
        if self.group is not None:
            os.setresgid(self.group, self.group, self.group)
        if self.user is not None:
            os.setresuid(self.user, self.user, self.user)
        forbid_new_privileges()


@dataclass(frozen=True)
class Start:
    """One start that the supervisor asks for; the environment follows in a file, which the parent does not read."""

    arguments: tuple[str, ...]
    supervisor: int  # its process
    rights: Rights = field(default=Rights())

    @property
    def name(self) -> str:
        """Name of the process, as `run` is followed by it."""
        return self.arguments[self.arguments.index("run") + 1] if "run" in self.arguments else self.arguments[-1]

    @classmethod
    def parse(cls, given: dict[str, object]) -> "Start":
        """Read what `asdict` has written, as JSON holds it."""
        rights, arguments, supervisor = given["rights"], given["arguments"], given["supervisor"]
        if not (isinstance(rights, dict) and isinstance(arguments, list) and isinstance(supervisor, int)):
            raise TypeError(f"no start: {given}")
        if rights["groups"] is not None:
            rights = {**rights, "groups": tuple(rights["groups"])}
        return cls(tuple(arguments), supervisor, Rights(**rights))

    def to_json(self) -> dict[str, object]:
        """What `parse` reads."""
        return asdict(self)
