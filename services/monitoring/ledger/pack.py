"""What an evidence pack proves besides lane and crossing: the contract, and the pulse that confirms it.

Everything is judged by the pack alone; tables of the ledger are not read.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from shared.errors import RejectedFrame
from shared.messages.toll import CrossingMode, EvidenceFrame, EvidencePack, LaneProbability, PulseAssignment
from shared.messages.v2x import Unverified
from shared.toll.plaza import Plaza
from shared.toll.registration import certificate_of, fault_of, identity_of
from shared.v2x import its_time
from shared.v2x.security.certificates import Certificate
from shared.v2x.security.envelope import without_envelope
from shared.v2x.security.signatures import is_issued_by, is_signed_by
from shared.v2x.security.trust import Issuer, TrustStore

from .codes import Code
from .reconciliation import Crossing, Mode, Pulse, PulseModel, ownership
from .registrations import contracts_of, identities_of

SD_GATE = 3.0  # standard deviations of the crossing within which a pulse may be its own
EARLIER_VERSIONS = {"1", "2"}  # of the algorithms: the ledgers of then kept no assignment of pulses
CHARGES = (Code.CONFIRMED, Code.ALONE, Code.LANE_BY_PULSE, Code.UNCONFIRMED)
ASSIGNED = (Code.CONFIRMED, Code.LANE_BY_PULSE)  # follow from the pulses and passages around
# What a ledger may be set to. Beyond these an assignment says nothing: whatever is around it, one pulse is its own.
LEAST_PROBABILITY, MOST_MISSED, MOST_OTHERS_PER_S = 0.5, 0.5, 10.0
MOST_DETECTOR_SD_S, MOST_GATE_S = 1.0, 30.0
SAME_PROBABILITY = 1e-6  # another machine's exponentials may differ in their last bits


def pack_faults(pack: EvidencePack, plaza: Plaza) -> Iterator[str]:
    """Name what contradicts the charge of a pack; nothing for packs of earlier releases, which have no registrations.

    Parameters
    ----------
    pack : EvidencePack
        The pack.
    plaza : Plaza
        Of the file in the pack.
    """
    if pack.form < 2:
        return
    yield from _registration_faults(pack, plaza)
    if pack.charged.station_ids != pack.crossed.station_ids[: len(pack.charged.station_ids)] and not set(
        pack.crossed.station_ids
    ) <= set(pack.charged.station_ids):
        yield "the final statement is of other station IDs than that of the crossing"
    if plaza.require_authenticated and not pack.charged.authenticated:
        yield "its CAM are not authenticated, and the plaza requires that"
    verdict = pack.verdict.code if pack.verdict else ""
    if verdict not in CHARGES:
        yield "its verdict is not that of a charge"
    if verdict in (Code.CONFIRMED, Code.ALONE, Code.LANE_BY_PULSE):
        yield from _pulse_faults(pack)
    yield from _lane_faults(pack, plaza, verdict)
    if pack.charged.lane is None and (verdict != Code.LANE_BY_PULSE or pack.assignment is None):
        yield "its lane is undecided, and nothing in the pack decides it"
    if pack.assignment is not None:
        yield from _threshold_faults(pack, pack.assignment)
        yield from _assignment_faults(pack, pack.assignment)


def _lane_faults(pack: EvidencePack, plaza: Plaza, verdict: str) -> Iterator[str]:
    """Name what contradicts the lane that is charged, or leaves out what confirms it."""
    if pack.charged.lane not in (None, pack.lane):
        yield "the lane that is charged is not that of the final statement"
    lane = next((lane for lane in plaza.lanes if lane.name == pack.lane), None)
    if lane is None:
        yield "the plaza has no such lane"
    elif verdict == Code.UNCONFIRMED and lane.detector:
        yield "its lane has a detector, which has not confirmed it"
    evidence = pack.crossed.evidence
    is_earlier = evidence is not None and evidence.version in EARLIER_VERSIONS
    if verdict in ASSIGNED and pack.assignment is None and not is_earlier:
        yield "it was confirmed by a detector, and the pack does not have the pulses and passages around it"


def _threshold_faults(pack: EvidencePack, given: PulseAssignment) -> Iterator[str]:
    """Name what an assignment rests on that neither the crossing states nor a ledger may be set to."""
    charged, crossed = pack.charged, pack.crossed
    # A final statement without a lane took back what the crossing decided, as for a delta that came too late.
    if charged.lane is not None and (charged.lanes, charged.modes) != (crossed.lanes, crossed.modes):
        yield "lanes and times of the final statement are not those of the crossing"
    if (charged.crossing_sd_s or 0.0) < (crossed.crossing_sd_s or 0.0):
        yield "the final statement is surer of the crossing time than the crossing"
    if not (
        LEAST_PROBABILITY < given.least_probability < 1.0
        and 0.0 < given.missed < MOST_MISSED
        and 0.0 < given.others_per_s <= MOST_OTHERS_PER_S
        and 0.0 < given.detector_sd_s <= MOST_DETECTOR_SD_S
        and 0.0 < (pack.match_gate_s or 0.0) <= MOST_GATE_S
    ):
        yield "its pulses were assigned by limits that no ledger may have"


def frame_faults(pack: EvidencePack) -> Iterator[str]:
    """Name what contradicts that every frame of an authenticated charge is signed by a registered ticket.

    What a pack says of its frames proves nothing: envelopes and signatures are verified again, by the certificates of
    the registrations, which the operator has countersigned. Each fault is named once.

    Parameters
    ----------
    pack : EvidencePack
        The pack.
    """
    if pack.form < 2 or not (pack.charged.authenticated or pack.crossed.authenticated):
        return
    certificates = {
        registration.ticket: certificate_of(registration.certificate)
        for registration in pack.registrations if registration.ticket and registration.certificate
    }  # fmt: skip
    found = (statement.evidence for statement in (pack.crossed, pack.charged))
    frames = [frame for evidence in found if evidence is not None for frame in evidence.frames]
    faults = (_frame_fault(frame, certificates) for frame in frames)
    yield from dict.fromkeys(fault for fault in faults if fault is not None)


def _frame_fault(frame: EvidenceFrame, certificates: Mapping[str, Certificate]) -> str | None:
    try:
        signed = without_envelope(frame.data)[1]
    except RejectedFrame as error:
        return f"a frame cannot be read: {error}"
    if signed is None:
        return "a frame of an authenticated passage is not signed"
    ticket = signed.signer.hex()
    if ticket != frame.signer:
        return "a frame is signed by another ticket than the pack says"
    if (certificate := certificates.get(ticket)) is None:
        return "no registration has the certificate of a frame's ticket"
    if certificate.digest != signed.signer or not is_signed_by(
        certificate, signed.data.tbs_data, signed.data.signature
    ):
        return "the signature of a frame does not verify"
    return None


@dataclass(frozen=True)
class ChainNote:
    """What the trusted certificates and lists say of the ticket of a charge."""

    text: str
    is_fault: bool


def chain_notes(pack: EvidencePack, store: TrustStore, now_s: float) -> Iterator[ChainNote]:
    """Judge the chain above each ticket of an authenticated charge by certificates and lists of today.

    The pack has the certificates of the tickets, and each names its authority. A revocation of which a list shows that
    it came after the crossing takes nothing from the charge, and is named. Of a charge that is not authenticated
    nothing can be judged: no note.

    Parameters
    ----------
    pack : EvidencePack
        The pack.
    store : TrustStore
        Certificates and lists of a folder.
    now_s : float
        [s] ITS time at which the lists ought to be valid.
    """
    if not (pack.charged.authenticated or pack.crossed.authenticated):
        return
    time_s = _signed_time_s(pack)
    if time_s is None:
        yield ChainNote("no signed frame says when the vehicle crossed: its chain cannot be judged", is_fault=True)
        return
    certificates = {
        registration.ticket: certificate_of(registration.certificate)
        for registration in pack.registrations if registration.ticket and registration.certificate
    }  # fmt: skip
    tickets = sorted({*pack.charged.tickets, *pack.crossed.tickets})
    if not tickets:
        yield ChainNote("it names no ticket: no chain can be judged", is_fault=True)
    for ticket in tickets:
        certificate = certificates.get(ticket)
        name = ((certificate.issuer if certificate else None) or b"").hex()
        issuer = store.issuers.get((certificate.issuer if certificate else None) or b"")
        if certificate is None:
            yield ChainNote(f"no registration has the certificate of ticket {ticket}", is_fault=True)
        elif issuer is None:
            yield ChainNote(f"authority {name} of ticket {ticket}: not trusted by the folder", is_fault=True)
        elif not is_issued_by(certificate, issuer.certificate):
            yield ChainNote(f"authority {name} has not signed ticket {ticket}", is_fault=True)
        elif not certificate.start_s <= time_s <= certificate.end_s:
            yield ChainNote(f"ticket {ticket} was not valid at the crossing", is_fault=True)
        else:
            yield _chain_note(issuer, name, time_s, now_s)


def _signed_time_s(pack: EvidencePack) -> float | None:
    """ITS time [s] that the last signed frame of the crossing states; None: no frame is signed."""
    frames = pack.crossed.evidence.frames if pack.crossed.evidence else ()
    for frame in reversed(frames):
        try:
            signed = without_envelope(frame.data)[1]
        except RejectedFrame:
            continue  # `frame_faults` names it
        if signed is not None and (time_us := signed.data.header.get("generationTime")) is not None:
            return float(time_us) / 1e6
    return None


def _chain_note(issuer: Issuer, name: str, time_s: float, now_s: float) -> ChainNote:
    root = issuer.root
    crl, doubt = root.crl, issuer.doubt(now_s, 0.0, is_simulated=False)
    chain = f"authority {name}, root {root.certificate.digest.hex()}"
    if doubt is Unverified.TEST_ROOT:
        return ChainNote(f"{chain}: a test root, which authenticates nobody on the road", is_fault=True)
    if not all(certificate.start_s <= time_s <= certificate.end_s for certificate in issuer.chain):
        return ChainNote(f"{chain}: not valid at the crossing", is_fault=True)
    if crl is None:
        return ChainNote(f"{chain}: no list of revocations", is_fault=False)
    lapsed = "; a list has expired, put newer ones into the folder" if doubt is Unverified.LISTS_EXPIRED else ""
    by_list = f"by the list of {_date(crl.issued_s)}"
    revoked = [certificate.digest for certificate in issuer.chain if certificate.digest in crl.revoked]
    if not revoked:
        text, is_fault = f"trusted, by the list of revocations of {_date(crl.issued_s)}", False
    elif crl.issued_s <= time_s:
        text, is_fault = f"revoked {by_list}", True
    elif all(root.is_revoked_since(digest, time_s) for digest in revoked):
        text, is_fault = f"revoked since, {by_list}", False
    else:
        unknown = "since when is not known: an older list, issued after the crossing, would say"
        text, is_fault = f"revoked {by_list}, {unknown}", True
    return ChainNote(f"{chain}: {text}{lapsed}", is_fault)


def _date(its_s: int) -> str:
    return datetime.fromtimestamp(its_time.utc_ns_from_its_time(its_s * 1000) // 10**9, UTC).date().isoformat()


def is_authenticated(pack: EvidencePack) -> bool:
    """Whether the passage of a pack was authenticated."""
    return pack.charged.authenticated


def _registration_faults(pack: EvidencePack, plaza: Plaza) -> Iterator[str]:
    if contracts_of(pack.registrations) != {(pack.contract, pack.tariff_class)}:
        yield "the contract is not that of its registrations"
    for registration in pack.registrations:
        fault = fault_of(
            registration, plaza=plaza.name, operator_keys=plaza.operator_keys,
            require_ticket=plaza.require_authenticated,
        )  # fmt: skip
        if fault is not None:
            yield f"a registration is not valid: {fault}"
        if registration.valid_until_ns < (pack.charged.crossing_ns or 0):
            yield "a registration ended before the crossing"
    covered = {identity_of(registration) for registration in pack.registrations}
    if not covered >= set(identities_of(pack.charged)) or not covered >= set(identities_of(pack.crossed)):
        yield "no registration covers its ticket or station ID"
    evidence = pack.crossed.evidence
    if evidence is not None and pack.crossed.authenticated:
        signers = {frame.signer for frame in evidence.frames}
        if not signers <= set(pack.crossed.tickets):
            yield "a frame is of another ticket than the passage"


def _assignment_faults(pack: EvidencePack, given: PulseAssignment) -> Iterator[str]:
    """Assign the pulses around the crossing again."""
    charged = pack.charged
    crossing = Crossing(
        -1, charged.crossing_ns or 0, charged.crossing_sd_s or 1.0, charged.lane, _probabilities(charged.lanes),
        _modes(charged.modes),
    )  # fmt: skip
    rivals = [
        Crossing(
            number, rival.crossing_ns, rival.crossing_sd_s, rival.lane, _probabilities(rival.lanes), _modes(rival.modes)
        )
        for number, rival in enumerate(given.rivals)
    ]
    pulses = [Pulse(number, pulse.lane, pulse.sampled_ns) for number, pulse in enumerate(given.pulses)]
    model = PulseModel(given.detector_sd_s, pack.match_gate_s or 0.0, given.missed, given.others_per_s)
    try:
        found = ownership(crossing, pulses, rivals, model)
    except (ValueError, ArithmeticError):  # of limits, which are named, that have no logarithm
        found = None
    if found is None or found.probability < given.least_probability:
        yield "the pulses around it do not say that it was counted in its lane"
    elif (given.pulses[found.pulse.key],) != pack.pulses:
        yield "another pulse around it is more probably its own"
    elif abs(found.probability - given.probability) > SAME_PROBABILITY:
        yield f"its lane has the probability {found.probability:.6f} by them, and {given.probability:.6f} is said"


def _modes(modes: Sequence[CrossingMode]) -> tuple[Mode, ...]:
    return tuple(Mode(mode.offset_s, mode.sd_s, _probabilities(mode.lanes)) for mode in modes)


def _probabilities(lanes: Sequence[LaneProbability]) -> dict[str, float]:
    return {lane.lane: lane.probability for lane in lanes}


def _pulse_faults(pack: EvidencePack) -> Iterator[str]:
    gate_s = max(pack.match_gate_s or 0.0, SD_GATE * (pack.charged.crossing_sd_s or 0.0))
    crossing_ns = pack.charged.crossing_ns or 0
    if not pack.pulses:
        yield "it was confirmed by a detector, and the pack has no pulse"
    for pulse in pack.pulses:
        if pulse.lane != pack.lane or pulse.backward or abs(pulse.sampled_ns - crossing_ns) * 1e-9 > gate_s:
            yield "a pulse is not that of the crossing"
