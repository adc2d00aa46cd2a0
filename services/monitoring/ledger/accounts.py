"""Closed hours of the lanes: each account has the hash of the one before, and the newest is in the ledger's signature.

link = SHA-256(link of the account before, JSON of number, hour, lane and counts)
"""

import hashlib
import json
from collections.abc import Mapping

from shared.messages.toll import LaneBalance

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


def close(store: Store, balances: tuple[LaneBalance, ...]) -> None:
    """Append the accounts of hours that are over; each lane and hour is closed once."""
    for balance in balances:
        if store.row("SELECT 1 FROM account WHERE hour_ns = ? AND lane = ?", balance.hour_ns, balance.lane):
            continue
        last = store.row("SELECT number, link FROM account ORDER BY number DESC LIMIT 1")
        number, previous = (last["number"] + 1, last["link"]) if last else (1, "")
        counts = counts_of(balance.model_dump())
        store.execute(
            "INSERT INTO account VALUES (?, ?, ?, ?, ?)", number, balance.hour_ns, balance.lane, counts,
            account_link(previous, number, balance.hour_ns, balance.lane, counts),
        )  # fmt: skip
