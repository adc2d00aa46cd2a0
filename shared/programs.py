"""Roles of programs that are no part of the unit, and what each may read and write on its bus."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ProgramRights:
    """Topics that a program may read and write; `reads` empty: all of them."""

    purpose: str
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()


READER = "reader"
# The sender of what such a program publishes is its role, whatever the name of its user at the broker.
ROLES = {
    READER: ProgramRights("reads every topic"),
    "operator": ProgramRights(
        "registers vehicles, answers transactions, and states who has paid otherwise",
        ("plaza/description", "toll/transaction", "toll/review", "toll/alarm", "toll/seal", "ledger/state"),
        ("toll/registration", "toll/receipt", "toll/paid_otherwise"),
    ),
    "detector": ProgramRights(
        "publishes the pulses of detectors, and takes pictures",
        ("plaza/description", "plaza/picture_order"),
        ("plaza/detector", "plaza/pictures"),
    ),
}
