"""Certificates for a listener beyond this machine: an authority of the unit's own, and a server's certificate by it."""

import datetime
import ipaddress
import re
from collections.abc import Sequence
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from shared.errors import UserError

from .keys import write_file

AUTHORITY, CERTIFICATE, KEY = "ca.pem", "server.pem", "server.key"
AUTHORITY_KEY = "ca.key"
AUTHORITY_DAYS, SERVER_DAYS = 3650, 730
EARLIER = datetime.timedelta(days=1)  # of another machine, whose clock is behind
HOST = re.compile(r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9-]{0,62})(\.[A-Za-z0-9-]{1,63})*")


def make(folder: Path, secret_folder: Path, names: Sequence[str], now: datetime.datetime) -> Path:
    """Write a server's certificate for names and addresses, by the authority that is there or a new one.

    The key of the authority stays in the folder of the secrets. Gives the authority's certificate, which clients need.
    """
    alternatives = [_alternative(name) for name in names]
    folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    authority, authority_key = _authority(folder, secret_folder, now)
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, names[0][:64])])
    certificate = (
        _begun(subject, authority.subject, key, now, SERVER_DAYS)
        .add_extension(x509.SubjectAlternativeName(alternatives), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(authority_key, hashes.SHA256())
    )
    write_file(folder / KEY, _private(key), mode=0o600)
    write_file(folder / CERTIFICATE, certificate.public_bytes(serialization.Encoding.PEM), mode=0o644)
    return folder / AUTHORITY


def _alternative(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        pass  # a name, then
    if not HOST.fullmatch(name):
        raise UserError(f"{name[:60]!r} is no name of a host and no address; try the unit's host name, as car.local")
    return x509.DNSName(name)


def _authority(
    folder: Path, secret_folder: Path, now: datetime.datetime
) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    path = secret_folder / AUTHORITY_KEY
    if path.exists() and (folder / AUTHORITY).exists():
        try:
            key = serialization.load_pem_private_key(path.read_bytes(), None)
            certificate = x509.load_pem_x509_certificate((folder / AUTHORITY).read_bytes())
        except (OSError, ValueError) as error:
            raise UserError(
                f"cannot read the authority {path}: {error}; remove it, and distribute a new one"
            ) from error
        if isinstance(key, ec.EllipticCurvePrivateKey) and certificate.not_valid_after_utc > now:
            return certificate, key
    made = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "bus of an on-board unit")])
    certificate = (
        _begun(name, name, made, now, AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(made, hashes.SHA256())
    )
    write_file(path, _private(made), mode=0o400)
    write_file(folder / AUTHORITY, certificate.public_bytes(serialization.Encoding.PEM), mode=0o644)
    return certificate, made


def _begun(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, now: datetime.datetime, days: int
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - EARLIER)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
