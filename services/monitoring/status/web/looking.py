"""Asks for the messages of topics that come only while somebody looks, and waits for the first of each."""

import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager

from ..state import State

WAIT_S, STEP_S = 1.0, 0.01


def look_at(
    state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int], names: Iterable[str]
) -> None:
    """Return when the newest message of each topic is known, or will not come soon; at once for most topics."""
    until_s = time.monotonic() + WAIT_S
    with lock:
        state.look(names, now_ns())
        flows = [state.topics[name] for name in names if name in state.topics]
    while any(flow.is_coming(now_ns()) for flow in flows) and time.monotonic() < until_s:
        time.sleep(STEP_S)
