"""Closed hours of the lanes: each account has the hash of the one before, and the newest is in the ledger's signature.

link = SHA-256(link of the account before, JSON of number, hour, lane and counts)
"""

import hashlib
import json
from collections.abc import Mapping

from .store import Store

HOUR_NS = 3_600_000_000_000
COUNTS = (
    "detections", "charged", "review", "undecided", "unregistered", "paid_otherwise", "suspect", "void", "missed",
    "charged_without_detection", "unconfirmed",
)  # fmt: skip


def account_link(previous: str, number: int, hour_ns: int, lane: str, counts: str) -> str:
    """Give the hash of a closed account: of the one before, and of everything that it states."""
    content = json.dumps([number, hour_ns, lane, counts], separators=(",", ":"))
    return hashlib.sha256(bytes.fromhex(previous) + content.encode()).hexdigest()


def counts_of(values: Mapping[str, int]) -> str:
    """Write the counts of an hour, those that are zero left out."""
    return json.dumps({name: values[name] for name in COUNTS if values.get(name)}, separators=(",", ":"))


def is_closed(store: Store, hour_ns: int) -> bool:
    """Whether the accounts of an hour are closed."""
    return store.row("SELECT 1 FROM account WHERE hour_ns >= ?", hour_ns) is not None


def close(store: Store, before_ns: int) -> None:
    """Append the accounts of the hours before a time; each lane and hour is closed once."""
    newest = store.row("SELECT MAX(hour_ns) AS hour_ns FROM account")
    since_ns = (newest["hour_ns"] if newest else None) or 0
    hours: dict[tuple[int, str], dict[str, int]] = {}
    for row in store.rows(
        "SELECT * FROM balance WHERE hour_ns > ? AND hour_ns < ? ORDER BY hour_ns, lane", since_ns, before_ns
    ):
        hours.setdefault((row["hour_ns"], row["lane"]), {})[row["outcome"]] = row["n"]
    last = store.row("SELECT number, link FROM account ORDER BY number DESC LIMIT 1")
    number, previous = (last["number"], last["link"]) if last else (0, "")
    for (hour_ns, lane), values in hours.items():
        number, counts = number + 1, counts_of(values)
        previous = account_link(previous, number, hour_ns, lane, counts)
        store.execute("INSERT INTO account VALUES (?, ?, ?, ?, ?)", number, hour_ns, lane, counts, previous)
