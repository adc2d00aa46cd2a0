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
    UNSURE = "ledger.unsure"  # whether the pulse near it is its own
    LANE_BY_PULSE = "ledger.lane_by_pulse"
    UNCONFIRMED = "ledger.unconfirmed"
    MISSED = "ledger.missed"
    CHANGED = "ledger.changed"  # in the file, beside the ledger
    IDENTITY = "ledger.identity"
    NEW_TICKET = "ledger.new_ticket"
    NOT_AUTHENTICATED = "ledger.not_authenticated"
    SILENT = "ledger.silent"  # behind the gate line
    ELSEWHERE = "ledger.elsewhere"
    DRIVE_ROUND = "ledger.drive_round"
    REPLAYED = "ledger.replayed"
    TURNED_COUNTED = "ledger.turned_counted"
    SILENT_COUNTED = "ledger.silent_counted"  # before the gate line
    GHOST = "ledger.ghost"
    ALONE = "ledger.alone"  # explains the only pulse of its group
    CONFIRMED = "ledger.confirmed"
    GHOSTS = "ledger.ghosts"
    MISBEHAVIOUR = "ledger.misbehaviour"
    BY_PICTURE = "ledger.by_picture"
    BY_CONTRACT = "ledger.by_contract"
    BY_COPY = "ledger.by_copy"
    PICTURE_CHARGED = "ledger.picture_charged"
    PICTURE_REVIEW = "ledger.picture_review"
    PICTURE_OWES = "ledger.picture_owes"
    PICTURE_SETTLED = "ledger.picture_settled"


# What decides a review: of those that are not named, the picture of the lane's camera.
DECIDED_BY = {
    Code.TWO_CONTRACTS: Code.BY_CONTRACT,
    Code.TWO_CLASSES: Code.BY_CONTRACT,
    Code.NO_CLASS: Code.BY_CONTRACT,
    Code.LOST_CLASS: Code.BY_CONTRACT,
    Code.IDENTITY: Code.BY_CONTRACT,
    Code.NEW_TICKET: Code.BY_CONTRACT,
    Code.NOT_AUTHENTICATED: Code.BY_CONTRACT,
    Code.ELSEWHERE: Code.BY_CONTRACT,
    Code.DRIVE_ROUND: Code.BY_CONTRACT,
    Code.CHANGED: Code.BY_COPY,
}
