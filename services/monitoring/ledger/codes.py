"""Codes of what the ledger decides on passages; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """Why a passage is charged, held, reversed, reviewed or not charged."""

    NO_STATEMENT = "ledger.no_statement"
    NOT_ACCEPTED = "ledger.not_accepted"
    TWO_CONTRACTS = "ledger.two_contracts"
    TWO_CLASSES = "ledger.two_classes"
    NO_LANE = "ledger.no_lane"
    NO_CONTRACT = "ledger.no_contract"
    NO_EVIDENCE = "ledger.no_evidence"
    NO_CLASS = "ledger.no_class"
    LOST_CLASS = "ledger.lost_class"
    WAITS = "ledger.waits"
    SAME_VEHICLE = "ledger.same_vehicle"
    NOT_DERIVABLE = "ledger.not_derivable"
    OVERLAP_WITHOUT_DETECTOR = "ledger.overlap_without_detector"
    OVERLAP_COUNTED = "ledger.overlap_counted"
    NOT_COUNTED = "ledger.not_counted"
    UNCONFIRMED = "ledger.unconfirmed"
    MISSED = "ledger.missed"
