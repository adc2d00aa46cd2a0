"""Enters simulated vehicles into a centre: keys and certificates as an enrolment makes them, without its tokens."""

import hashlib
import secrets
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import NamedTuple

import psycopg
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from fleet.admission.authority import Authority
from fleet.database.refusals import refusals
from shared.errors import UserError
from shared.evidence.signer import SECRET_BYTES, FileSigner

COPY_VEHICLE = "COPY vehicle (vehicle, tenant_id, note) FROM STDIN"
COPY_KEY = (
    "COPY certificate (key_id, vehicle, tenant_id, kind, public_key, serial, not_before, not_after) FROM STDIN "
    "(FORMAT BINARY)"
)
KEY_TYPES = ("text", "text", "int4", "text", "bytea", "text", "timestamptz", "timestamptz")
NOTE = "simulated"


class EnrolledVehicle(NamedTuple):
    """A vehicle with keys that the centre knows."""

    name: str
    secret: bytes  # of the evidence key
    tls: str  # key and certificate, PEM


class _Key(NamedTuple):
    key_id: str
    kind: str
    public_key: bytes
    serial: str | None
    begin: datetime
    end: datetime | None


def enter(dsn: str, authority: Authority, names: Sequence[str], tenant: str = "demo") -> Iterator[EnrolledVehicle]:
    """Make keys for each vehicle and enter it; raises `UserError`."""
    with refusals(), psycopg.connect(dsn, connect_timeout=5) as db:
        row = db.execute("SELECT tenant_id FROM tenant WHERE name = %s", (tenant,)).fetchone()
        if row is None:
            raise UserError(f"the centre has no tenant {tenant!r}; is it started with `obu centre up`?")
        made = {name: _made(authority, name) for name in names}  # takes long: of a centre that answers alone
        with db.cursor().copy(COPY_VEHICLE) as copy:
            for name in names:
                copy.write_row((name, row[0], NOTE))
        with db.cursor().copy(COPY_KEY) as copy:
            copy.set_types(KEY_TYPES)
            for name, (_, keys) in made.items():
                for key in keys:
                    copy.write_row((
                        key.key_id, name, row[0], key.kind, key.public_key, key.serial, key.begin, key.end,
                    ))  # fmt: skip
    return (entered for entered, _ in made.values())


def _made(authority: Authority, name: str) -> tuple[EnrolledVehicle, tuple[_Key, _Key]]:
    secret = secrets.token_bytes(SECRET_BYTES)
    signer = FileSigner(secret)
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    request = x509.CertificateSigningRequestBuilder().subject_name(subject).sign(key, hashes.SHA256())
    certified = authority.certify(request.public_bytes(Encoding.PEM).decode(), name)
    tls_id = hashlib.sha256(certified.public_key).hexdigest()[:16]
    text = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()
    return EnrolledVehicle(name, secret, text + certified.pem), (
        _Key(tls_id, "tls", certified.public_key, certified.serial, certified.begin, certified.end),
        _Key(signer.key_id, "evidence", signer.public_key, None, certified.begin, None),
    )
