"""What an evidence pack proves besides lane and crossing: the contract, and the pulse that confirms it.

Everything is judged by the pack alone; tables of the ledger are not read.
"""

from collections.abc import Iterator, Mapping, Sequence

from shared.errors import RejectedFrame
from shared.messages.toll import CrossingMode, EvidenceFrame, EvidencePack, LaneProbability, PulseAssignment
from shared.toll.plaza import Plaza
from shared.toll.registration import certificate_of, fault_of, identity_of
from shared.v2x.security.certificates import Certificate
from shared.v2x.security.envelope import without_envelope
from shared.v2x.security.signatures import is_signed_by

from .codes import Code
from .reconciliation import Crossing, Mode, Pulse, PulseModel, ownership
from .registrations import contracts_of, identities_of

SD_GATE = 3.0  # standard deviations of the crossing within which a pulse may be its own


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
    if verdict in (Code.CONFIRMED, Code.ALONE, Code.LANE_BY_PULSE):
        yield from _pulse_faults(pack)
    if pack.charged.lane is None and (verdict != Code.LANE_BY_PULSE or pack.assignment is None):
        yield "its lane is undecided, and nothing in the pack decides it"
    if pack.assignment is not None:
        yield from _assignment_faults(pack, pack.assignment)


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
    found = ownership(crossing, pulses, rivals, model)
    if found is None or found.probability < given.least_probability:
        yield "the pulses around it do not say that it was counted in its lane"
    elif (given.pulses[found.pulse.key],) != pack.pulses:
        yield "another pulse around it is more probably its own"


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
