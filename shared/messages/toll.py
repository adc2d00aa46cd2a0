"""Tolling at a road-side unit: plaza, registrations, passages, charges, receipts, reconciliation."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from .base import (
    Base64,
    Count,
    Deviation,
    Height,
    Latitude,
    Longitude,
    Message,
    Name,
    Nanoseconds,
    Quantity,
    Ratio,
    Reason,
    Seconds,
    Speed,
    unit,
)
from .explanation import Explanation
from .v2x import Authentication, CertificateDigest, Unverified

StationId = Annotated[int, Field(ge=0, le=4_294_967_295), unit("1")]  # pseudonym that a CAM carries
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]  # SHA-256, hexadecimal
Cents = Annotated[int, Field(ge=-10_000_000, le=10_000_000), unit("1/100 of the currency")]
PASSAGES = 400  # at most in one message
STATIONS = 1000  # at most in one message
MAX_SETTLED = 700  # that are listed in one message
STATION_IDS = 16  # of one passage
MAX_USED = 2000  # CAM in one message
OVERLAPS = 16  # of one passage with others in its lane
LANES = 500  # of a plaza
FRAMES, DELTAS, POSTERIORS = 3000, 1800, 600  # of one passage, as evidence
CONTRACTS = 16  # registrations of one passage
MODES = 3  # ways in which a receiver may err
PULSES = 16  # in an evidence pack
KeyName = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]  # the first digits of the SHA-256 of an Ed25519 key
Ed25519Signature = Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")]


class Position(Message):
    """A point on the ground, at the height of the plaza."""

    latitude_deg: Latitude
    longitude_deg: Longitude


class GateMode(StrEnum):
    """How vehicles pass a lane: at a barrier, or without slowing down."""

    STOP_AND_GO = "stop_and_go"
    FREE_FLOW = "free_flow"


class LaneTraffic(StrEnum):
    """Who may use a lane."""

    CITS_ONLY = "cits_only"  # vehicles with CAM and contract; what its detector counts beside them keeps its picture
    MIXED = "mixed"  # also who pays otherwise; only a review keeps a picture


class LaneDescription(Message):
    """One lane: its centre line in driving direction, and the lines that its vehicles cross one after the other."""

    lane: Name
    direction: Name  # of the carriageway
    mode: GateMode
    detector: bool = False  # counts the lane's vehicles: a charge needs its pulse
    detector_direction: bool = False  # its pulses state whether the vehicle drove backwards
    traffic: LaneTraffic = LaneTraffic.CITS_ONLY
    width_m: Deviation
    centre: Annotated[tuple[Position, ...], Field(max_length=500)]
    approach_line: tuple[Position, Position]
    gate_line: tuple[Position, Position]
    exit_line: tuple[Position, Position]


class PlazaDescription(Message):
    """The toll plaza as its file describes it."""

    sampled_ns: Nanoseconds
    plaza: Name
    plaza_digest: Digest  # of the file's bytes
    antenna: Position  # surveyed
    antenna_height_ellipsoid_m: Height
    lanes: Annotated[tuple[LaneDescription, ...], Field(max_length=LANES)]


class TollRegistration(Message):
    """A contract and the authorization ticket of its vehicle, signed by the ticket's key and by the operator.

    Repeated every few seconds on the approach and after each change of the ticket; valid for the time of one passage.
    Without a ticket it names a station ID: accepted only by a plaza that allows CAM that are not authenticated.
    """

    sampled_ns: Nanoseconds
    contract: Name  # token, no name and no number plate
    tariff_class: Name
    station_id: StationId | None = None  # that the vehicle uses now
    valid_until_ns: Nanoseconds
    plaza: Name = ""  # where it is valid
    ticket: CertificateDigest | None = None
    certificate: Annotated[Base64, Field(max_length=2000)] | None = None  # the ticket, in its canonical form (OER)
    possession: Annotated[str, Field(pattern=r"^([0-9a-f]{128}|[0-9a-f]{192})$")] | None = None  # ECDSA, r and s
    operator_key: KeyName | None = None
    countersignature: Ed25519Signature | None = None  # of the operator, over the rest


class TollPayment(Message):
    """Statement of the operator: the vehicle at the gate line of a mixed lane at a time has paid otherwise."""

    sampled_ns: Nanoseconds  # of the vehicle at the gate line
    plaza: Name
    lane: Name
    payment: Name  # number of the operator, so that a repeated one settles no second pulse


class PlazaDetector(Message):
    """A pulse of a lane's detector (loop or laser): a vehicle's front is at the gate line, whoever it is.

    Repeated every few seconds until the next pulse; the earlier stamps recover messages that were lost.
    """

    sampled_ns: Nanoseconds
    plaza: Name
    lane: Name
    since_ns: Nanoseconds  # when the detector began to count
    pulse: Count  # running number since then, from 0
    earlier_ns: Annotated[tuple[Nanoseconds, ...], Field(max_length=100)] = ()  # the pulses before it, newest first
    # Those of them at which the vehicle drove backwards; used only where the plaza's file says that it states this.
    backward_ns: Annotated[tuple[Nanoseconds, ...], Field(max_length=101)] = ()


class PictureAction(StrEnum):
    """What a camera does with a picture."""

    TAKE = "take"  # it is deleted at `until_ns` unless an order to keep it follows
    KEEP = "keep"
    DELETE = "delete"


class PictureOrder(Message):
    """Order to the camera of a lane; the same one again changes nothing."""

    sampled_ns: Nanoseconds
    plaza: Name
    lane: Name
    picture: Digest  # of plaza, lane and number of the pulse
    pulse_ns: Nanoseconds
    action: PictureAction
    until_ns: Nanoseconds  # the camera deletes the picture then, with or without an order
    reason_code: Explanation | None = None


class PictureAnswer(Message):
    """An order that a camera has carried out."""

    picture: Digest
    action: PictureAction


class PictureState(Message):
    """Pictures that the cameras of a plaza hold, and what they have answered since the last state."""

    sampled_ns: Nanoseconds
    plaza: Name
    pictures: Count = 0
    oldest_ns: Nanoseconds | None = None
    failed: Count = 0  # orders that no camera has taken
    answered: Annotated[tuple[PictureAnswer, ...], Field(max_length=100)] = ()


class AlarmKind(StrEnum):
    """What an operator has to look at besides single passages."""

    GHOSTS = "ghosts"  # more stations without a vehicle than a fault explains
    MISBEHAVIOUR = "misbehaviour"  # a valid ticket states a vehicle that is not there


class TollAlarm(Message):
    """An attack on the plaza, or a misbehaviour report for the authority that has issued a ticket."""

    sampled_ns: Nanoseconds
    plaza: Name
    kind: AlarmKind
    lane: Name | None = None
    since_ns: Nanoseconds
    until_ns: Nanoseconds
    ghosts: Count = 1
    ticket: CertificateDigest | None = None
    passage_id: Digest | None = None
    latitude_deg: Latitude
    longitude_deg: Longitude
    reason_code: Explanation | None = None


class TollDelta(Message):
    """Common GNSS error at the plaza: surveyed position of the unit's antenna minus its receiver's fix, smoothed.

    Added to a vehicle's position, it removes the error that the vehicle and the unit have in common.
    """

    sampled_ns: Nanoseconds  # of the newest fix in it
    plaza: Name
    valid: bool
    reason: Reason
    reason_code: Explanation | None = None  # which `reason` says; as that of all codes, absent from earlier releases
    north_m: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None
    east_m: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None
    sd_m: Deviation | None = None  # of each axis
    fixes: Count = 0  # in the smoothing window
    window_s: Seconds | None = None


class LaneProbability(Message):
    """Probability that a vehicle is in a lane; what is missing to 1 is off every lane."""

    lane: Name
    probability: Ratio


class CrossingMode(Message):
    """Time and lane of a crossing if the receiver errs in one way: as the unit's, not at all, or independently."""

    offset_s: Quantity  # after the crossing time
    sd_s: Seconds
    lanes: Annotated[tuple[LaneProbability, ...], Field(max_length=LANES)]  # and that it errs so


LaneProbabilities = Annotated[tuple[LaneProbability, ...], Field(max_length=LANES)]


class TollTrack(Message):
    """One vehicle as `core.toll` tracks it: front point, motion, uncertainty, lane."""

    track: Count  # number of the track since the start of the process
    station_id: StationId
    updated_ns: Nanoseconds  # of the last CAM
    latitude_deg: Latitude
    longitude_deg: Longitude
    speed_m_s: Speed
    heading_rad: Quantity
    ellipse_major_m: Deviation  # semi-axes of the 95 % ellipse
    ellipse_minor_m: Deviation
    ellipse_orientation_rad: Quantity  # of the major axis, clockwise from north
    lanes: LaneProbabilities = ()
    lane: Name | None = None  # None: undecided
    delta_applied: bool = False
    registered: bool = False
    passage_id: Digest | None = None
    authentication: Authentication = Authentication.UNSIGNED  # the least of its CAM
    unverified: Unverified | None = None  # why it is signed and not authenticated, of its newest CAM
    ticket: CertificateDigest | None = None  # by which it is authenticated


class TollTracks(Message):
    """Every vehicle that is tracked now."""

    sampled_ns: Nanoseconds
    tracks: Annotated[tuple[TollTrack, ...], Field(max_length=5000)]
    cams: Count = 0  # used since the start of the process
    rejected: Count = 0
    trust: Reason = ""  # state of the surveyed antenna and its receiver


class PassageState(StrEnum):
    """How far a passage has come, and what came of it."""

    OPEN = "open"  # behind the approach line
    CROSSED = "crossed"  # the front point has passed the gate line forward
    CHARGED = "charged"  # `core.toll`: the exit line is passed, charge it; the ledger: it is charged
    HELD = "held"  # the ledger: complete, and waits for the pulse of the lane's detector; nothing is booked
    UNDECIDED = "undecided"  # the exit line is passed, and no lane is certain
    UNREGISTERED = "unregistered"  # the exit line is passed, and no contract is known
    SUSPECT = "suspect"  # to be reviewed (`toll/review`): not confirmed, contradictory, or without evidence
    VOID = "void"  # did not pass the exit line: turned around or left
    MISSED = "missed"  # a detector pulse without a passage

    @property
    def is_final(self) -> bool:
        """Whether nothing follows."""
        return self not in (PassageState.OPEN, PassageState.CROSSED, PassageState.HELD)


class EvidenceFrame(Message):
    """One received frame, as it is."""

    sampled_ns: Nanoseconds  # generation time on the unit's clock, as it was used
    received_ns: Nanoseconds
    data: Base64
    # As its parser had found.
    authentication: Annotated[Authentication, Field(exclude_if=lambda value: value is Authentication.UNSIGNED)] = (
        Authentication.UNSIGNED
    )
    signer: CertificateDigest | None = None


class LanePosterior(Message):
    """Lane probabilities at one time."""

    sampled_ns: Nanoseconds
    lanes: LaneProbabilities


class PassageEvidence(Message):
    """Everything from which the lane and the crossing of a passage are computed again, bit for bit."""

    version: Name  # of the algorithms
    settings: Annotated[str, Field(max_length=20_000)]  # of core.toll, as JSON
    track_since_ns: Nanoseconds  # start of the track that made the decision
    # Used by that track, in the order of use; deltas of its time; lanes once a second and at the crossing.
    frames: Annotated[tuple[EvidenceFrame, ...], Field(max_length=FRAMES)]
    deltas: Annotated[tuple[TollDelta, ...], Field(max_length=DELTAS)]
    lanes: Annotated[tuple[LanePosterior, ...], Field(max_length=POSTERIORS)]


class TollPassage(Message):
    """A statement of `core.toll` on one passage: each change of its state, and a checkpoint once a second.

    A final state is repeated once a second until the ledger lists it as settled.
    """

    sampled_ns: Nanoseconds
    passage_id: Digest  # of the plaza and the digest of the track's first CAM at the approach line
    plaza: Name
    plaza_digest: Digest
    state: PassageState
    reason: Reason = ""
    reason_code: Explanation | None = None  # which `reason` says
    checkpoint: bool = False  # the state is that of an earlier statement
    station_ids: Annotated[tuple[StationId, ...], Field(max_length=STATION_IDS)]  # used on this passage, in their order
    opened_ns: Nanoseconds
    crossing_ns: Nanoseconds | None = None
    crossing_sd_s: Deviation | None = None
    exit_ns: Nanoseconds | None = None
    lane: Name | None = None  # None: undecided
    lanes: LaneProbabilities = ()
    modes: Annotated[tuple[CrossingMode, ...], Field(max_length=MODES)] = ()  # of the crossing; their lanes add up
    # Where the front point is, for a process that continues the passage after a restart.
    latitude_deg: Latitude
    longitude_deg: Longitude
    heading_rad: Quantity
    speed_m_s: Speed
    position_sd_m: Deviation
    delta_ns: Nanoseconds | None = None  # stamp of the delta that was applied; None: none was
    trust: Reason = ""  # state of the surveyed antenna and its receiver
    authenticated: bool = False  # whether signature, chain and permissions of all its CAM were verified
    # Authorization tickets of an authenticated passage, in the order of their use.
    tickets: Annotated[tuple[CertificateDigest, ...], Field(max_length=STATION_IDS)] = ()
    # Passages whose vehicles were at the gate line of the same lane within this vehicle's length: detectors count them.
    overlaps: Annotated[tuple[Digest, ...], Field(max_length=OVERLAPS)] = ()
    derivable: bool = True  # whether lane and crossing follow from the evidence; False: it begins behind the gate line
    evidence: PassageEvidence | None = None  # with CROSSED and CHARGED; the ledger keeps that of charged vehicles


class GateCommand(Message):
    """Open the gate of a lane for one passage, or hold it."""

    sampled_ns: Nanoseconds
    plaza: Name
    lane: Name
    passage_id: Digest
    open: bool
    mode: GateMode
    crossing_ns: Nanoseconds | None = None  # predicted
    crossing_sd_s: Deviation | None = None
    valid_until_ns: Nanoseconds
    reason: Reason = ""
    reason_code: Explanation | None = None  # which `reason` says


class TransactionKind(StrEnum):
    """A correction is a reversal: nothing is edited."""

    CHARGE = "charge"
    REVERSAL = "reversal"


class LedgerSeal(Message):
    """Place of a transaction in the chain of the ledger, signed: what the operator has cannot be taken back."""

    ledger: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]  # random name of the ledger
    number: Count  # from 1
    link: Digest  # hash of this entry and all before it
    key: KeyName
    public_key: Digest  # Ed25519, 32 bytes
    signature: Ed25519Signature


class LedgerHead(Message):
    """The newest entry of a ledger, signed; the operator keeps it, so that a ledger that was put back is recognised."""

    sampled_ns: Nanoseconds
    plaza: Name
    # The signed statement: names and values as text, in the form that `obu verify-toll --seal` reads.
    statement: Annotated[str, Field(max_length=4000)]


class TollTransaction(Message):
    """A charge or its reversal, sent to the operator until the receipt is here."""

    transaction_id: Digest
    passage_id: Digest
    kind: TransactionKind
    booked_ns: Nanoseconds
    plaza: Name
    lane: Name
    lane_probability: Ratio
    crossing_ns: Nanoseconds
    crossing_sd_s: Deviation
    contract: Name
    tariff_class: Name
    tariff_version: Name
    amount_cents: Cents
    currency: Annotated[str, Field(pattern=r"^[A-Z]{3}$")]
    authenticated: bool  # False: from CAM without a verified signature, which can be forged
    ticket: CertificateDigest | None = None  # the one of the crossing; None: not authenticated
    ghosts: Count = 0  # stations at the same place that no detector has counted
    confirmed: bool = False  # True: by a pulse of the lane's detector; False: not confirmed by a detector
    evidence_digest: Digest
    attempt: Count = 1  # how often it was sent
    reason: Reason = ""  # signed with the rest, and without a code
    seal: LedgerSeal | None = None  # None: as stored, or sent without a key


class TollReceipt(Message):
    """Answer of the operator to a transaction; a repeated transaction gets the same answer."""

    received_ns: Nanoseconds  # by the operator
    transaction_id: Digest
    passage_id: Digest
    operator: Name
    accepted: bool
    duplicate: bool = False  # it was there before, and was ignored
    reason: Reason = ""


class TollReview(Message):
    """A passage that a person has to judge: it is not charged, or its charge is reversed. Sent once, or repeated."""

    sampled_ns: Nanoseconds  # when the ledger found that it is to be reviewed
    passage_id: Digest
    plaza: Name
    reason: Reason
    reason_code: Explanation | None = None  # which `reason` says
    lane: Name | None = None
    crossing_ns: Nanoseconds | None = None
    overlaps: Annotated[tuple[Digest, ...], Field(max_length=OVERLAPS)] = ()  # passages reviewed together with it
    contract: Name | None = None  # None: not registered, or several
    # Where its station IDs belong to several; a person has to tell which of them has passed.
    contracts: Annotated[tuple[Name, ...], Field(max_length=STATION_IDS)] = ()
    tariff_class: Name | None = None
    amount_cents: Cents | None = None  # that a charge would have
    currency: Name | None = None
    reversed: bool = False  # it was charged, and the charge is reversed
    evidence_digest: Digest | None = None
    authenticated: bool = False
    decided_by: Explanation | None = None  # what decides it: a picture, the operator's contracts, the detector


class PulseEvidence(Message):
    """A detector pulse as it was stored."""

    lane: Name
    since_ns: Nanoseconds
    pulse: Count
    sampled_ns: Nanoseconds
    backward: bool = False


class RivalCrossing(Message):
    """A passage around another one, that may be the one which a detector has counted; who it was is not kept."""

    crossing_ns: Nanoseconds
    crossing_sd_s: Seconds
    lane: Name | None = None  # None: undecided
    lanes: Annotated[tuple[LaneProbability, ...], Field(max_length=LANES)]
    modes: Annotated[tuple[CrossingMode, ...], Field(max_length=MODES)] = ()


class PulseAssignment(Message):
    """What it follows from that a detector has counted a passage, in the lane of its pulse."""

    pulses: Annotated[tuple[PulseEvidence, ...], Field(max_length=PULSES)]  # around it
    rivals: Annotated[tuple[RivalCrossing, ...], Field(max_length=PULSES)]
    detector_sd_s: Seconds
    missed: Ratio  # share of vehicles that detectors miss
    others_per_s: Annotated[float, Field(gt=0.0, le=1e6), unit("1/s")]  # pulses of a lane that are of no crossing
    least_probability: Ratio  # that a charge requires
    probability: Ratio


class EvidencePack(Message):
    """Everything that a charge was derived from; its digest is in the transaction."""

    plaza_file: Annotated[str, Field(max_length=1_000_000)]  # its text
    tariff_version: Name
    contract: Name
    tariff_class: Name
    lane: Name
    amount_cents: Cents
    crossed: TollPassage  # the statement of the crossing, with its evidence
    charged: TollPassage  # the final statement
    # Packs of earlier releases end here: 1.
    form: Count = 1
    registrations: Annotated[tuple[TollRegistration, ...], Field(max_length=CONTRACTS)] = ()  # as they were signed
    pulses: Annotated[tuple[PulseEvidence, ...], Field(max_length=PULSES)] = ()  # that confirm it
    match_gate_s: Seconds | None = None  # between pulse and crossing, by the ledger's settings then
    verdict: Explanation | None = None  # why it was charged, or went to review, by what was known then
    # Passages at the same place that no detector has counted.
    ghosts: Annotated[tuple[Digest, ...], Field(max_length=OVERLAPS)] = ()
    assignment: PulseAssignment | None = None  # None: alone with its ghosts, without a detector, or of earlier releases


class RegisteredStation(Message):
    """A ticket, or a station ID, that a contract covers."""

    station_id: StationId | None = None
    ticket: CertificateDigest | None = None
    valid_until_ns: Nanoseconds


class UsedCam(EvidenceFrame):
    """One CAM that a track has used."""

    clock_offset_ns: Nanoseconds  # that is in `sampled_ns`: what is added to the times of a station with a wrong clock


class UsedCams(Message):
    """The CAM that `core.toll` has used since its last message of this kind, in the order of use.

    The ledger keeps them for 70 s, in memory, for the next process; the first message of a process asks for them.
    """

    sampled_ns: Nanoseconds
    since_ns: Nanoseconds  # start of the process
    cams: Annotated[tuple[UsedCam, ...], Field(max_length=MAX_USED)]
    deltas: Annotated[tuple[TollDelta, ...], Field(max_length=DELTAS)] = ()
    anew: bool = False  # what was sent before is repeated, from the oldest on: the ledger had restarted


class RestoredCams(Message):
    """What a process of `core.toll` before this one has used; `toll/open_passages` follows when all are sent."""

    since_ns: Nanoseconds  # of the process that is to use them
    used: UsedCams


class OpenPassages(Message):
    """What the ledger holds for a restart of `core.toll`: passages to continue, those settled, registered stations."""

    sampled_ns: Nanoseconds
    passages: Annotated[tuple[TollPassage, ...], Field(max_length=PASSAGES)]  # newest statement of each, no evidence
    # Final and stored in the last minutes, the newest: their statements need not be repeated.
    settled: Annotated[tuple[Digest, ...], Field(max_length=5000)]
    registered: Annotated[tuple[RegisteredStation, ...], Field(max_length=STATIONS)] = ()  # the newest
    since_ns: Nanoseconds | None = None  # start of the ledger's process
    core_since_ns: Nanoseconds | None = None  # process of `core.toll` that has all RestoredCams; None: none is known


class LaneBalance(Message):
    """One hour of a lane: detections are the sum of its outcomes, and of those held and pending.

    Outcomes are charged, review, undecided, unregistered, paid otherwise, suspect, void and missed; they are counted
    as soon as a passage or a payment explains a detection.
    """

    lane: Name
    hour_ns: Nanoseconds  # its begin
    detections: Count = 0
    charged: Count = 0
    review: Count = 0  # of a contract: a person has to judge
    undecided: Count = 0
    unregistered: Count = 0
    paid_otherwise: Count = 0
    suspect: Count = 0  # contradictory, and of no contract
    void: Count = 0
    missed: Count = 0
    held: Count = 0  # complete passages that wait for a pulse of their own, or for the count of an overlap
    charged_without_detection: Count = 0  # in a lane with a detector
    unconfirmed: Count = 0  # charges of a lane without a detector
    pending: Count = 0  # detections that no passage explains yet
    provisional: Count = 0  # detections with an outcome that may still change: younger than `match_after_s`
    agrees: bool = True


class PassageSummary(Message):
    """One passage for a table: no station ID, no contract."""

    passage_id: Digest
    state: PassageState
    lane: Name | None = None
    crossing_ns: Nanoseconds | None = None
    probability: Ratio | None = None
    tariff_class: Name | None = None
    amount_cents: Cents | None = None
    currency: Name | None = None
    receipt: bool = False
    confirmed: bool | None = None  # of a charge: by a detector; None: not charged
    reversed: bool = False  # a reversal is booked
    in_review: bool = False  # a person has to judge it
    authenticated: bool = False
    ghosts: Count = 0  # stations at the same place that no detector has counted
    evidence_digest: Digest | None = None
    reason: Reason = ""
    reason_code: Explanation | None = None  # which `reason` says


class ReviewSummary(Message):
    """One passage that a person has to judge, and what decides it: no station ID, no contract."""

    passage_id: Digest
    since_ns: Nanoseconds
    lane: Name | None = None
    crossing_ns: Nanoseconds | None = None
    contracts: Count = 0
    authenticated: bool = False
    reversed: bool = False
    reason: Reason = ""
    reason_code: Explanation | None = None
    decided_by: Reason = ""
    decided_by_code: Explanation | None = None


class PictureSummary(Message):
    """One picture that is kept, and why."""

    lane: Name
    pulse_ns: Nanoseconds
    until_ns: Nanoseconds
    reason: Reason = ""
    reason_code: Explanation | None = None


class LedgerState(Message):
    """Charges, outbox and reconciliation of the ledger."""

    now_ns: Nanoseconds
    plaza: Name
    problem: Reason | None = None  # why nothing is charged now
    transactions: Count = 0
    reversals: Count = 0
    amount_cents: Cents = 0
    held: Count = 0  # complete passages that wait for a detector; nothing is booked
    in_review: Count = 0  # passages of this hour and the last that a person has to judge
    unconfirmed: Count = 0  # charges that are not confirmed by a detector
    outbox: Count = 0  # transactions without a receipt
    last_receipt_ns: Nanoseconds | None = None
    lanes: Annotated[tuple[LaneBalance, ...], Field(max_length=2 * LANES + 2)] = ()  # of this hour and the last
    recent: Annotated[tuple[PassageSummary, ...], Field(max_length=PASSAGES)] = ()
    require_authenticated: bool | None = None  # None: of an earlier release
    not_authenticated: Count = 0  # charges that rest on CAM without a verified signature
    reviews: Annotated[tuple[ReviewSummary, ...], Field(max_length=50)] = ()  # the newest
    pictures: Annotated[tuple[PictureSummary, ...], Field(max_length=50)] = ()  # the newest that are kept
    pictures_kept: Count = 0
    pictures_waiting: Count = 0  # taken, and neither kept nor deleted yet
    pictures_failed: Count = 0  # attempts at orders that the camera has not answered
    alarms: Count = 0  # of this hour and the last
    newest_alarm: TollAlarm | None = None


class TrafficVehicle(Message):
    """A simulated vehicle where it really is, and what it is."""

    vehicle: Count
    latitude_deg: Latitude
    longitude_deg: Longitude
    heading_rad: Quantity
    speed_m_s: Speed
    lane: Name
    equipped: bool
    registered: bool
    station_id: StationId | None = None


class TrafficPassage(Message):
    """A simulated vehicle that has passed the gate line."""

    vehicle: Count
    lane: Name
    crossing_ns: Nanoseconds
    equipped: bool
    registered: bool
    contract: Name | None = None


class PlazaTruth(Message):
    """Where the simulated vehicles really are, and who has passed the gate since the last message."""

    sampled_ns: Nanoseconds
    vehicles: tuple[TrafficVehicle, ...]
    passages: tuple[TrafficPassage, ...] = ()
    frames: Count = 0  # sent since the start
    turned: Count = 0  # vehicles that turned around before the gate
