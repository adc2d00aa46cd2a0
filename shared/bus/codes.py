"""Codes of the state of the broker, which every process can find out; `words.toml` beside this file has their words."""

from enum import StrEnum

from ..messages.explanation import Explanation, explain


class Code(StrEnum):
    """Why nothing passes through the broker."""

    UNREACHABLE = "broker.unreachable"
    HANGS = "broker.hangs"


def broker_down(*, connected: bool) -> Explanation:
    """Say why nothing passes: a broker to which one is connected hangs."""
    return explain(Code.HANGS if connected else Code.UNREACHABLE)
