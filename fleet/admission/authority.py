"""The centre's certificate authority: it certifies vehicles for 30 days, and the centre's own servers."""

import ipaddress
import os
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from shared.errors import UserError
from shared.fleet.topics import VEHICLE

VEHICLE_DAYS, SERVER_DAYS, AUTHORITY_DAYS = 30, 365, 3650
SERVER_AGAIN_DAYS = 30  # before its end, when a server's certificate is made anew
CLOCK_SKEW = timedelta(days=1)  # a vehicle's clock may be slow by so much
MAX_REQUEST_BYTES = 8192
MAX_COMMON_NAME = 64  # characters (RFC 5280); clients look at the alternative names
UNREADABLE = (ValueError, TypeError, UnsupportedAlgorithm, x509.InvalidVersion)  # of a certificate of anybody
AUTHORITY, AUTHORITY_KEY, SERVER, SERVER_KEY = "ca.pem", "ca.key", "server.pem", "server.key"


class BadRequest(ValueError):
    """A certificate request that is not certified; the text says why."""


@dataclass(frozen=True)
class IssuedCertificate:
    """A certificate of a vehicle."""

    pem: str
    serial: str  # hexadecimal
    public_key: bytes  # uncompressed point
    begin: datetime
    end: datetime


class Authority:
    """The authority's key and certificate, from files that are made at the first start."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not (folder / AUTHORITY).exists():
                self._make()
            self.pem = (folder / AUTHORITY).read_text(encoding="ascii")
            self._certificate = x509.load_pem_x509_certificate(self.pem.encode())
            key = serialization.load_pem_private_key((folder / AUTHORITY_KEY).read_bytes(), None)
        except OSError as error:
            raise UserError(f"cannot use the authority in {folder}: {error.strerror}; check its owner") from error
        except ValueError as error:
            raise UserError(f"the authority in {folder} is damaged: {error}; restore it from a backup") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise UserError(f"{folder / AUTHORITY_KEY} is no P-256 key; restore it from a backup")
        self._key = key

    def certify(self, request_pem: str, vehicle: str, now: datetime | None = None) -> IssuedCertificate:
        """Certify a vehicle's key for 30 days; raises `BadRequest`."""
        key = key_of_request(request_pem)
        now = now or datetime.now(UTC)
        begin, end = now - CLOCK_SKEW, now + timedelta(days=VEHICLE_DAYS)
        built = (
            _builder(_name(vehicle), self._certificate.subject, key, begin, end)
            .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False)
            .sign(self._key, hashes.SHA256())
        )
        point = key.public_bytes(serialization.Encoding.X962, serialization.PublicFormat.UncompressedPoint)
        return IssuedCertificate(_pem(built), f"{built.serial_number:x}", point, begin, end)

    def server(self, names: Sequence[str]) -> tuple[Path, Path]:
        """Give certificate and key of the centre's servers for these names, made anew near their end."""
        certificate, key = self.folder / SERVER, self.folder / SERVER_KEY
        if not _serves(certificate, names):
            self._make_server(certificate, key, names)
        return certificate, key

    def issued(self, pem: str) -> x509.Certificate | None:
        """Read a certificate that this authority has signed, whether it has ended or not; None for any other."""
        try:
            found = x509.load_pem_x509_certificate(pem.encode())
            found.verify_directly_issued_by(self._certificate)
        except (*UNREADABLE, InvalidSignature):
            return None
        return found

    def _make(self) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        now = datetime.now(UTC)
        name, end = _name("OBU control centre"), now + timedelta(days=AUTHORITY_DAYS)
        built = (
            _builder(name, name, key.public_key(), now - CLOCK_SKEW, end, authority=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .sign(key, hashes.SHA256())
        )
        _write(self.folder / AUTHORITY_KEY, _key_pem(key), 0o400)
        _write(self.folder / AUTHORITY, _pem(built), 0o444)

    def _make_server(self, certificate: Path, key_path: Path, names: Sequence[str]) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        now = datetime.now(UTC)
        begin, end = now - CLOCK_SKEW, now + timedelta(days=SERVER_DAYS)
        built = (
            _builder(_name(names[0][:MAX_COMMON_NAME]), self._certificate.subject, key.public_key(), begin, end)
            .add_extension(x509.SubjectAlternativeName([_general(name) for name in names]), critical=False)
            .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
            .sign(self._key, hashes.SHA256())
        )
        _write(key_path, _key_pem(key), 0o400)
        _write(certificate, _pem(built), 0o444)


def key_of_request(pem: str) -> ec.EllipticCurvePublicKey:
    """Read the P-256 key of a request that its owner has signed; raises `BadRequest`."""
    if len(pem) > MAX_REQUEST_BYTES:
        raise BadRequest("the certificate request is too long")
    try:
        request = x509.load_pem_x509_csr(pem.encode())
        key, genuine = request.public_key(), request.is_signature_valid
    except UNREADABLE as error:
        raise BadRequest("the certificate request cannot be read") from error
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1) or not genuine:
        raise BadRequest("the certificate request is not of a P-256 key that has signed it")
    return key


def name_in(certificate: x509.Certificate) -> str | None:
    """Name of the vehicle of a certificate; None if there is none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    name = str(names[0].value) if len(names) == 1 else ""
    return name if VEHICLE.fullmatch(name) else None


def _builder(
    name: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePublicKey,
    begin: datetime,
    end: datetime,
    *,
    authority: bool = False,
) -> x509.CertificateBuilder:
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(issuer).public_key(key)
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(begin).not_valid_after(end)
    constraints = x509.BasicConstraints(ca=authority, path_length=0 if authority else None)
    return builder.add_extension(constraints, critical=True)


def _serves(path: Path, names: Sequence[str]) -> bool:
    """Whether a server's certificate is for these names, has begun, as the clock is now, and does not end soon."""
    try:
        found = x509.load_pem_x509_certificate(path.read_bytes())
        there = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (OSError, ValueError, x509.ExtensionNotFound):
        return False
    now = datetime.now(UTC)
    lasts = found.not_valid_before_utc <= now < found.not_valid_after_utc - timedelta(days=SERVER_AGAIN_DAYS)
    return lasts and set(there) == {_general(name) for name in names}


def _general(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(serialization.Encoding.PEM).decode()


def _key_pem(key: ec.EllipticCurvePrivateKey) -> str:
    form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    return key.private_bytes(*form).decode()


def _write(path: Path, text: str, mode: int) -> None:
    if path.exists():  # in containers a group may read the key of the servers, and goes on to
        mode = stat.S_IMODE(path.stat().st_mode)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    draft.unlink(missing_ok=True)
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "w", encoding="ascii") as file:
        os.fchmod(file.fileno(), mode)
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    draft.replace(path)
