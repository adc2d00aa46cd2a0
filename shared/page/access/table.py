"""Which right each route needs: rows of a table that a guard decides by, and that the documentation prints."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Generic, TypeVar

from starlette.routing import compile_path

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")  # which change nothing
WEBSOCKET = "WEBSOCKET"
R = TypeVar("R", bound=StrEnum)  # rights: those of the unit's page, or of a centre's


@dataclass(frozen=True)
class Row(Generic[R]):
    """One method of one route; the first row whose path matches counts. HEAD is allowed wherever GET is."""

    method: str
    path: str  # as the application writes it: {name} is one part of a path, {name:path} the rest
    right: R
    purpose: str


def row_of(rows: Iterable[Row[R]], method: str, path: str) -> Row[R] | None:
    """Find the row that describes a request."""
    method = "GET" if method == "HEAD" else method
    return next((row for row in rows if row.method == method and pattern_of(row.path).match(path)), None)


@cache
def pattern_of(path: str) -> re.Pattern[str]:
    """Translate the path of a route by the router itself: whatever it takes for this route has the right of its row."""
    return compile_path(path)[0]
