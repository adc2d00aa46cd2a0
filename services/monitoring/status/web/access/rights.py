"""What a visitor of the page may do."""

from enum import StrEnum


class Right(StrEnum):
    """Rights in ascending order; each includes those before it."""

    PUBLIC = "public"  # without a login
    VIEW = "view"
    OPERATE = "operate"
    ADMIN = "admin"

    def includes(self, needed: "Right") -> bool:
        """Whether this right is enough for what needs another one."""
        order = list(Right)
        return order.index(self) >= order.index(needed)


GRANTED = (Right.VIEW, Right.OPERATE, Right.ADMIN)  # what a token may hold
MEANING = {
    Right.PUBLIC: "without a login: the login itself, and whether the unit runs",
    Right.VIEW: "see every page and all data",
    Right.OPERATE: "besides, send commands, attack a simulated vehicle, replay, solve, keep and download recordings",
    Right.ADMIN: "besides, change settings, delete recordings and manage tokens",
}
