"""Enrolment at a centre and renewal, from the side of the unit: HTTPS with its admission.

The token names the fingerprint of the centre's authority, so that the unit knows the centre at first contact, in a
network of anybody. A renewal is signed with the old TLS key: TLS itself would refuse a certificate that has ended, and
a vehicle that was parked for a winter could not come back.
"""

import hashlib
import http.client
import json
import secrets
import ssl
import time
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import SplitResult, urlsplit

from ..errors import UserError
from ..evidence.signer import Signer
from ..evidence.statement import printable, signed
from ..tls import reason_of
from .identity import Centre, UplinkIdentity, write_identity
from .topics import VEHICLE

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

STATEMENT = "uplink enrolment"
RENEWAL = b"obu renewal 1\n"
SECRET_BYTES = 24  # of a token
FINGERPRINT_BYTES = 16  # of the SHA-256 of the authority's certificate (DER)
TIMEOUT_S = 15.0
MAX_ANSWER_BYTES = 65_536
MOST_HOST, LATEST_YEAR = 253, 2100  # of a name (RFC 1035), and of an end that the unit can publish


def enrol(url: str, token: str, vehicle: str, folder: Path, signer: Signer) -> UplinkIdentity:
    """Make a TLS key, have it certified by the centre at `url`, and write both into a folder.

    Parameters
    ----------
    url : str
        Address of the centre's admission, https.
    token : str
        One-time token of the centre: a secret, a dot, the fingerprint of its authority.
    vehicle : str
        Name of this unit; the centre may give it another one.
    folder : Path
        Where the enrolment is written.
    signer : Signer
        Evidence key of the unit, which the centre registers.

    Raises
    ------
    UserError
        The address, the token or the centre is wrong, with what to try next.
    """
    secret, _, fingerprint = token.strip().partition(".")
    if not secret or len(fingerprint) != 2 * FINGERPRINT_BYTES:
        raise UserError("this is no token: copy the whole of it, as `obu centre token` or the page Enrolment shows it")
    place = _place(url)
    authority = _authority_of(place, fingerprint)
    key, request = _key_and_request(vehicle)
    body = {"token": secret, "vehicle": vehicle, "request": request, "evidence": _statement(vehicle, request, signer)}
    answer = _ask(place, "/enrol", body, _trusting(authority))
    return _written(folder, answer, key, signer.key_id)


def renew(identity: UplinkIdentity, signer: Signer, utc_ms: int | None = None) -> UplinkIdentity:
    """Have another TLS key certified, and the present evidence key registered; raises `UserError`."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    vehicle = identity.centre.vehicle
    try:
        pem = identity.tls.read_bytes()
        old_key = serialization.load_pem_private_key(pem, None)
        old = x509.load_pem_x509_certificate(pem).public_bytes(serialization.Encoding.PEM).decode()
        authority = identity.authority.read_text(encoding="ascii")
    except (OSError, ValueError) as error:
        raise UserError(f"cannot use {identity.tls}: {error}; run `obu enrol URL TOKEN` again") from error
    if not isinstance(old_key, ec.EllipticCurvePrivateKey):
        raise UserError(f"{identity.tls} holds no P-256 key; run `obu enrol URL TOKEN` again")
    key, request = _key_and_request(vehicle)
    made_ms = time.time_ns() // 1_000_000 if utc_ms is None else utc_ms
    proof = old_key.sign(renewal_text(request, made_ms), ec.ECDSA(hashes.SHA256()))
    body = {
        "certificate": old,
        "request": request,
        "made_ms": made_ms,
        "signature": proof.hex(),
        "evidence": _statement(vehicle, request, signer),
    }
    place = _place(identity.centre.renew_url)
    answer = _ask(place, place.path or "/renew", body, _trusting(authority))
    if answer.get("vehicle") != vehicle:  # under another name it could not send what waits in its outbox
        raise UserError(
            f"the centre answers for {printable(answer.get('vehicle'), 100)}, and this unit is {vehicle} there; ask "
            "the centre, and run `obu enrol URL TOKEN` again for another name"
        )
    return _written(identity.folder, answer, key, signer.key_id)


def new_secret() -> str:
    """Make the secret of a token, in letters and digits: a command line takes what begins with - for an option."""
    return secrets.token_hex(SECRET_BYTES)


def command_for(url: str, token: str, vehicle: str | None) -> str:
    """Give the command for a unit, with the name that the token is bound to, whatever the unit's file says."""
    return f"obu enrol {url} {token}" + (f" --name {vehicle}" if vehicle else "")


def renewal_text(request: str, made_ms: int) -> bytes:
    """Give what the old TLS key signs."""
    return RENEWAL + hashlib.sha256(request.encode()).digest() + str(made_ms).encode()


def request_digest(request: str) -> str:
    """SHA-256 of a certificate request, which the evidence key's statement names."""
    return hashlib.sha256(request.encode()).hexdigest()


def fingerprint_of(authority: str) -> str:
    """Fingerprint of an authority's certificate (PEM), as in a token; raises `ValueError`."""
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(authority)).digest()[:FINGERPRINT_BYTES].hex()


def _statement(vehicle: str, request: str, signer: Signer) -> dict[str, str]:
    return signed(STATEMENT, {"vehicle": vehicle, "request_sha256": request_digest(request)}, signer)


def _place(url: str) -> SplitResult:
    try:
        place = urlsplit(url if "//" in url else f"https://{url}")
        usable = place.scheme == "https" and place.hostname and place.port != 0
    except ValueError:
        usable = False
    if usable:
        return place
    raise UserError(f"{printable(url)} is no https address of a centre, such as https://centre.example:8444")


def _trusting(authority: str) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(cadata=authority)
    except (ssl.SSLError, ValueError) as error:  # ValueError: it is empty
        raise UserError(f"the centre's authority cannot be read: {error}; run `obu enrol URL TOKEN` again") from error
    return context


def _authority_of(place: SplitResult, fingerprint: str) -> str:
    """Fetch the authority of a centre that is not known yet; it is believed for its fingerprint alone."""
    unknown = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    unknown.check_hostname, unknown.verify_mode = False, ssl.CERT_NONE
    status, data = _exchange(place, "GET", "/authority.pem", None, unknown)
    try:
        text = data.decode("ascii")
        found = fingerprint_of(text)
    except (UnicodeDecodeError, ValueError):
        found = ""
    if status != http.client.OK or found != fingerprint.lower():
        raise UserError(
            f"{place.netloc} is not the centre that made this token; check the address, or ask for another token"
        )
    return text


def _key_and_request(vehicle: str) -> "tuple[EllipticCurvePrivateKey, str]":
    """Make a P-256 key, and the request to certify it (PEM)."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, vehicle)])
    request = x509.CertificateSigningRequestBuilder().subject_name(name).sign(key, hashes.SHA256())
    return key, request.public_bytes(serialization.Encoding.PEM).decode()


def _ask(place: SplitResult, path: str, body: object, context: ssl.SSLContext) -> dict[str, object]:
    """Post JSON to a centre; raises `UserError` with what it says."""
    status, data = _exchange(place, "POST", path, json.dumps(body).encode(), context)
    try:
        answer = json.loads(data)
    except (ValueError, RecursionError):
        answer = None
    if not isinstance(answer, dict):
        raise UserError(f"{place.netloc} does not answer as a centre (status {status}); check the address")
    if status != http.client.OK:
        raise UserError(f"the centre refuses: {printable(answer.get('detail', status), 400)}")
    return answer


def _exchange(
    place: SplitResult, method: str, path: str, body: bytes | None, context: ssl.SSLContext
) -> tuple[int, bytes]:
    link = http.client.HTTPSConnection(place.hostname or "", place.port, timeout=TIMEOUT_S, context=context)
    try:
        link.request(method, path, body, {"Content-Type": "application/json"} if body else {})
        answer = link.getresponse()
        data = answer.read(MAX_ANSWER_BYTES + 1)
    except ssl.SSLCertVerificationError as error:
        raise UserError(
            f"{place.netloc} does not prove to be the centre: {error.verify_message}; check the address, and the "
            "clock of this unit"
        ) from error
    except (OSError, http.client.HTTPException, ValueError) as error:  # ValueError: no possible host or path
        raise UserError(
            f"no answer of a centre at {place.netloc}: {_reason(error)}; check the network, and the address with its "
            "port, as `obu centre token` or the page Enrolment shows it"
        ) from error
    finally:
        link.close()
    if len(data) > MAX_ANSWER_BYTES:
        raise UserError(f"{place.netloc} does not answer as a centre: it sends too much; check the address")
    return answer.status, data


def _reason(error: Exception) -> str:
    is_other = isinstance(error, http.client.BadStatusLine) and not isinstance(error, OSError)
    return "it does not speak HTTP, so it is another kind of server, or another port" if is_other else reason_of(error)


def _written(
    folder: Path, answer: dict[str, object], key: "EllipticCurvePrivateKey", evidence_key: str
) -> UplinkIdentity:
    """Check what the centre has answered, and write it."""
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
    from cryptography.hazmat.primitives import serialization

    try:
        names = ("vehicle", "tenant", "certificate", "authority", "host", "renew_url")
        vehicle, tenant, certificate, authority, host, renew_url = (str(answer[name]) for name in names)
        port = int(str(answer["mqtt_port"]))
        made = x509.load_pem_x509_certificate(certificate.encode())
        made.verify_directly_issued_by(x509.load_pem_x509_certificate(authority.encode()))
        _place(renew_url)
        if not (0 < len(host) <= MOST_HOST and host.isascii() and host.isprintable()):
            raise ValueError("it names no possible host")
        if made.not_valid_after_utc.year > LATEST_YEAR:
            raise ValueError("its certificate ends beyond any sense")
        fits = made.public_key() == key.public_key() and VEHICLE.fullmatch(vehicle) and 0 < port < 65536
    except (KeyError, ValueError, TypeError, UnsupportedAlgorithm, InvalidSignature, x509.InvalidVersion) as error:
        raise UserError(f"the centre's answer cannot be used: {printable(error)}; is it of a newer version?") from error
    if not fits:
        raise UserError("the centre's answer is for another key or vehicle; ask for another token")
    form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    begin, end = (int(at.timestamp()) * 1_000_000_000 for at in (made.not_valid_before_utc, made.not_valid_after_utc))
    centre = Centre(vehicle, tenant, host, port, renew_url, evidence_key, begin, end)
    return write_identity(folder, centre, key.private_bytes(*form).decode() + certificate, authority)
