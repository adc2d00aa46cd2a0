"""The frames of the dashboard's WebSocket, as a program follows them."""

from typing import Any

from services.monitoring.status.web.stream.patch import Difference, merge


def followed(state: dict[str, Any], frame: dict[str, Any]) -> dict[str, Any]:
    """Give the state after a frame: a snapshot replaces it, a difference changes it."""
    if frame["kind"] == "snapshot":
        return dict(frame["state"])
    removed = tuple(tuple(path) for path in frame["removed"])
    return merge(state, Difference(frame["state"], removed))
