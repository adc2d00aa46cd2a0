"""Registrations: a contract is bound to an authorization ticket by two signatures.

The vehicle signs with the key of the ticket: the ticket of another vehicle cannot be registered. The operator signs the
whole with its own key: the contract of another holder cannot be named. Both sign statements in the canonical
form of `shared/evidence/statement.py`, of the kinds "toll possession" and "toll registration".
"""

from collections.abc import Callable, Collection

from ..errors import RejectedFrame
from ..evidence.signer import Signer, is_signature, key_id_of
from ..evidence.statement import canonical
from ..messages.toll import TollRegistration
from ..v2x.security.certificates import Certificate, take_certificate
from ..v2x.security.reader import Reader

POSSESSION, REGISTRATION = "toll possession", "toll registration"
MAX_VALID_NS = 600 * 1_000_000_000  # the time of one passage, with the approach


def identity_of(registration: TollRegistration) -> str:
    """What a registration binds its contract to: "ticket" and the HashedId8, or "station" and the station ID."""
    if registration.ticket is not None:
        return f"ticket {registration.ticket}"
    return f"station {registration.station_id}"


def possession_bytes(registration: TollRegistration) -> bytes:
    """Encode what the ticket's key signs."""
    return canonical(POSSESSION, _fields(registration))


def countersigned_bytes(registration: TollRegistration) -> bytes:
    """Encode what the operator signs: all of it, with the signature of the ticket's key."""
    fields = {**_fields(registration), "possession": registration.possession or "",
              "operator_key": registration.operator_key or ""}  # fmt: skip
    return canonical(REGISTRATION, fields)


def sign_possession(
    registration: TollRegistration, certificate: bytes, sign: Callable[[bytes], bytes]
) -> TollRegistration:
    """Add the ticket and the signature of its key; `sign` gives r and s of ECDSA, each as long as the curve's field."""
    bound = registration.model_copy(update={"certificate": certificate, "ticket": ticket_of(certificate)})
    return bound.model_copy(update={"possession": sign(possession_bytes(bound)).hex()})


def countersign(registration: TollRegistration, operator: Signer) -> TollRegistration:
    """Add the operator's signature."""
    named = registration.model_copy(update={"operator_key": operator.key_id})
    return named.model_copy(update={"countersignature": operator.sign(countersigned_bytes(named)).hex()})


def ticket_of(certificate: bytes) -> str:
    """Give the HashedId8 of a certificate in its canonical form, as hexadecimal digits.

    Raises
    ------
    RejectedFrame
        The bytes are no explicit certificate with a key of a known curve.

    References
    ----------
    IEEE 1609.2, 6.4.3: SHA-256, and SHA-384 for keys of 384 bits.
    """
    return certificate_of(certificate).digest.hex()


def fault_of(
    registration: TollRegistration, *, plaza: str, operator_keys: Collection[str], require_ticket: bool
) -> str | None:
    """Say why a registration is not accepted, as the name of a reject; None if it is good.

    Parameters
    ----------
    registration : TollRegistration
        As received.
    plaza : str
        Name of the plaza.
    operator_keys : collection of str
        Ed25519 public keys of the operator, hexadecimal.
    require_ticket : bool
        Whether a registration of a station ID, which proves nothing, is refused.
    """
    if registration.ticket is None:
        is_allowed = not require_ticket and registration.station_id is not None
        return None if is_allowed else "registration_without_ticket"
    if not 0 < registration.valid_until_ns - registration.sampled_ns <= MAX_VALID_NS:
        return "registration_validity"
    if registration.plaza != plaza:
        return "registration_of_another_plaza"
    if not _is_possessed(registration):
        return "registration_not_possessed"
    if not _is_countersigned(registration, operator_keys):
        return "registration_not_countersigned"
    return None


def _fields(registration: TollRegistration) -> dict[str, str]:
    return {
        "plaza": registration.plaza,
        "contract": registration.contract,
        "tariff_class": registration.tariff_class,
        "ticket": registration.ticket or "",
        "station_id": "" if registration.station_id is None else str(registration.station_id),
        "sampled_ns": str(registration.sampled_ns),
        "valid_until_ns": str(registration.valid_until_ns),
    }


def _is_possessed(registration: TollRegistration) -> bool:
    """Whether the key of the ticket has signed it, and the certificate is the ticket's."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec, utils

    from ..v2x.security.signatures import public_key

    if registration.certificate is None or registration.possession is None:
        return False
    try:
        certificate = certificate_of(registration.certificate)
        if certificate.digest.hex() != registration.ticket:
            return False
        raw = bytes.fromhex(registration.possession)
        half = len(raw) // 2
        signature = utils.encode_dss_signature(int.from_bytes(raw[:half], "big"), int.from_bytes(raw[half:], "big"))
        algorithm = hashes.SHA384() if certificate.hash_name == "sha384" else hashes.SHA256()
        key = public_key(certificate.curve, certificate.point)
        key.verify(signature, possession_bytes(registration), ec.ECDSA(algorithm))
    except (RejectedFrame, InvalidSignature, ValueError):
        return False
    return True


def _is_countersigned(registration: TollRegistration, operator_keys: Collection[str]) -> bool:
    if registration.countersignature is None:
        return False
    data = countersigned_bytes(registration)
    signature = bytes.fromhex(registration.countersignature)
    named = [bytes.fromhex(key) for key in operator_keys if key_id_of(bytes.fromhex(key)) == registration.operator_key]
    return any(is_signature(public, signature, data) for public in named)


def certificate_of(encoded: bytes) -> Certificate:
    """Read a certificate; raises `RejectedFrame` for other bytes, and for those behind it."""
    reader = Reader(encoded)
    certificate = take_certificate(reader)
    if reader.position != len(encoded):
        raise RejectedFrame("security_encoding", "bytes behind the certificate")
    return certificate
