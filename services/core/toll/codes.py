"""Codes of passages, gates and the delta position; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """Why a passage is in its state, a gate is closed, or there is no delta position; how far a sender is known."""

    TURNED_BEFORE = "toll.turned_before"  # the gate line
    TURNED_BEHIND = "toll.turned_behind"
    UNREGISTERED = "toll.unregistered"
    UNDECIDED = "toll.undecided"
    PASSED = "toll.passed"
    SAME_STATION = "toll.same_station"
    SILENT_BEFORE = "toll.silent_before"  # the gate line
    SILENT_BETWEEN = "toll.silent_between"  # gate line and exit line
    IDENTITY = "toll.identity"  # one station ID, two tickets
    CONTINUES = "toll.continues"
    NO_CONTRACT = "toll.no_contract"
    QUEUED = "toll.queued"
    TRACKS_FULL = "toll.tracks_full"
    NO_FIX = "toll.no_fix"
    OLD_FIX = "toll.old_fix"
    FEW_FIXES = "toll.few_fixes"
    UNSIGNED = "toll.unsigned"  # as the values of `Authentication`
    SIGNED_NOT_VERIFIED = "toll.signed_not_verified"
    AUTHENTICATED = "toll.authenticated"
    NO_TRUST = "toll.no_trust"  # signed, not verified: as the values of `Unverified`
    NO_CERTIFICATE = "toll.no_certificate"
    UNKNOWN_ISSUER = "toll.unknown_issuer"
    TEST_ROOT = "toll.test_root"
    NO_REVOCATIONS = "toll.no_revocations"
    LISTS_EXPIRED = "toll.lists_expired"
    TOO_MANY = "toll.too_many"
