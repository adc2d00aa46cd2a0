"""The operator of the simulated plaza: its key follows from a constant, so that everybody has it."""

import hashlib
from functools import cache

from ..evidence.signer import FileSigner


@cache
def operator() -> FileSigner:
    """Who countersigns the registrations of simulated vehicles."""
    return FileSigner(hashlib.sha256(b"OBU simulation operator").digest())
