"""An authority with certificates of a server and of vehicles, for tests of the connection to a centre."""

from datetime import UTC, datetime, timedelta
from ipaddress import IPv4Address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from shared.fleet.identity import Centre, UplinkIdentity, write_identity


class Authority:
    """Signs certificates with a key of its own."""

    def __init__(self, name: str = "test authority") -> None:
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        self._certificate = (
            _begun(self._name, self._name, self._key)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .sign(self._key, hashes.SHA256())
        )

    @property
    def pem(self) -> str:
        return self._certificate.public_bytes(Encoding.PEM).decode()

    def certified(self, name: str, days: float = 30.0) -> tuple[str, str]:
        """Make a key and its certificate, both PEM; the certificate is also that of 127.0.0.1."""
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        names = x509.SubjectAlternativeName([x509.IPAddress(IPv4Address("127.0.0.1"))])
        made = _begun(subject, self._name, key, days).add_extension(names, critical=False)
        made = made.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        certificate = made.sign(self._key, hashes.SHA256()).public_bytes(Encoding.PEM).decode()
        return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode(), certificate

    def write(self, folder: Path, name: str) -> tuple[Path, Path, Path]:
        """Write authority, certificate and key of a server; return their paths."""
        folder.mkdir(parents=True, exist_ok=True)
        key, certificate = self.certified(name)
        paths = folder / "ca.pem", folder / "server.pem", folder / "server.key"
        for path, text in zip(paths, (self.pem, certificate, key), strict=True):
            path.write_text(text)
        return paths

    def enrol(self, folder: Path, vehicle: str, port: int, evidence_key: str, days: float = 30.0) -> UplinkIdentity:
        """Write an enrolment as `obu enrol` does."""
        key, certificate = self.certified(vehicle, days)
        now_ns = round(datetime.now(UTC).timestamp()) * 1_000_000_000
        end_ns = now_ns + round(days * 86_400e9)
        centre = Centre(vehicle, "demo", "127.0.0.1", port, "https://127.0.0.1:1/renew", evidence_key, now_ns, end_ns)
        return write_identity(folder, centre, key + certificate, self.pem)


def _begun(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: float = 30.0
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=days))
    )
