"""Enrols vehicles and renews their certificates: what a request must prove, and what the database remembers."""

import hashlib
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import psycopg
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec

from fleet.database.retention import RENEW_AFTER_END
from fleet.database.revoking import LOCK_VEHICLE
from shared.evidence.statement import KEY, PUBLIC_KEY, is_genuine
from shared.fleet.enrolling import STATEMENT, fingerprint_of, new_secret, renewal_text, request_digest
from shared.fleet.topics import RULE, VEHICLE

from .authority import Authority, IssuedCertificate, name_in

TOKEN_HOURS = 24
CLOCK = timedelta(days=2)  # by which a vehicle's clock may be wrong when it renews
MAX_RENEWALS = 20  # in a day and a vehicle: each adds rows to the keys and the audit
Row = tuple[object, ...]
INSERT_KEY = """
INSERT INTO certificate (key_id, vehicle, tenant_id, kind, public_key, serial, not_before, not_after)
VALUES (%s, %s, %s, %s, %s, %s, %s, %s) ON CONFLICT (key_id) DO NOTHING
"""


class RequestSigner(NamedTuple):
    """Whose certificate a request is signed with."""

    vehicle: str
    serial: str  # hexadecimal


class Refusal(Exception):
    """A request that is refused; the text says what to try next."""


def make_token(
    db: psycopg.Connection, authority: str, tenant: str, vehicle: str | None, by: str, hours: float = TOKEN_HOURS
) -> str:
    """Make a one-time token for a vehicle, or for any if None; the database keeps its hash alone.

    `authority` is the certificate of the centre's authority (PEM).

    Raises
    ------
    Refusal
        There is no such tenant, no such name can be, or the vehicle belongs to another tenant.
    """
    if vehicle is not None and not VEHICLE.fullmatch(vehicle):
        raise Refusal(f"{vehicle!r} is no name of a vehicle: {RULE}; choose another one")
    row = db.execute("SELECT tenant_id FROM tenant WHERE name = %s", (tenant,)).fetchone()
    if row is None:
        raise Refusal(f"there is no tenant {tenant!r}; `obu centre tenant list` names them")
    owner = db.execute(
        "SELECT tenant.name FROM vehicle JOIN tenant USING (tenant_id) WHERE vehicle = %s AND tenant_id <> %s",
        (vehicle, row[0]),
    ).fetchone()
    if owner is not None:  # its enrolment would be refused
        raise Refusal(f"the vehicle {vehicle} belongs to the tenant {owner[0]}; name that one, or another vehicle")
    secret = new_secret()
    expires = datetime.now(UTC) + timedelta(hours=hours)
    db.execute(
        "INSERT INTO enrolment (token_hash, tenant_id, vehicle, made_by, expires) VALUES (%s, %s, %s, %s, %s)",
        (hashlib.sha256(secret.encode()).digest(), row[0], vehicle, by, expires),
    )
    return f"{secret}.{fingerprint_of(authority)}"


class Enrolment:
    """Answers requests of vehicles; each in a transaction of its own."""

    def __init__(
        self,
        connect: Callable[[], psycopg.Connection],
        authority: Authority,
        address: Mapping[str, object],
    ) -> None:
        """`address` is what a vehicle is told of the centre: host, mqtt_port, renew_url."""
        self._connect, self._authority, self._address = connect, authority, dict(address)

    def enrol(self, token: str, vehicle: str, request: str, evidence: Mapping[str, str]) -> dict[str, object]:
        """Enrol a vehicle; raises `Refusal`, `BadRequest`, and errors of psycopg."""
        hashed = hashlib.sha256(token.encode()).digest()
        _check_statement(evidence, vehicle, request)
        with self._connect() as db:
            db.execute(LOCK_VEHICLE, {"vehicle": vehicle})
            row = db.execute(
                "UPDATE enrolment SET used = now(), used_by = %s WHERE token_hash = %s AND used IS NULL "
                "AND expires > clock_timestamp() AND (vehicle IS NULL OR vehicle = %s) RETURNING tenant_id, vehicle",
                (vehicle, hashed, vehicle),
            ).fetchone()
            if row is None:
                raise Refusal(self._why(db, hashed, vehicle))
            tenant_id = int(row[0])
            if _is_taken(db, vehicle, None if row[1] is None else tenant_id):
                raise Refusal(
                    f"the name {vehicle} is taken; give this unit another one with `obu enrol --name`, or ask for a "
                    "token that is made for this name"
                )
            db.execute(
                "INSERT INTO vehicle (vehicle, tenant_id) VALUES (%s, %s) ON CONFLICT DO NOTHING", (vehicle, tenant_id)
            )
            answer = self._certify(db, tenant_id, vehicle, request, evidence)
            _note(db, tenant_id, "enrolled", vehicle, evidence[KEY])
        return answer

    def token_id(self, token: str) -> str | None:
        """Name a token that can be used; None: there is none. Raises errors of psycopg."""
        hashed = hashlib.sha256(token.encode()).digest()
        with self._connect() as db:
            query = "SELECT token_id FROM enrolment WHERE token_hash = %s AND used IS NULL AND expires > now()"
            row = db.execute(query, (hashed,)).fetchone()
        return None if row is None else str(row[0])

    def proven(self, certificate: str, request: str, made_ms: int, signature: bytes) -> RequestSigner:
        """The vehicle that a request for renewal proves to be of; raises `Refusal`. The database is not asked."""
        old = self._authority.issued(certificate)
        vehicle = None if old is None else name_in(old)
        if old is None or vehicle is None:
            raise Refusal("the certificate is not of this centre; enrol again with a token")
        now = datetime.now(UTC)
        if now > old.not_valid_after_utc + RENEW_AFTER_END:
            raise Refusal("the certificate has ended more than 180 days ago; enrol again with a token")
        if abs(now.timestamp() * 1000 - made_ms) > CLOCK.total_seconds() * 1000:
            raise Refusal("the clock of this unit is wrong by more than two days; set it, and renew again")
        key = old.public_key()
        try:
            assert isinstance(key, ec.EllipticCurvePublicKey)
            key.verify(signature, renewal_text(request, made_ms), ec.ECDSA(hashes.SHA256()))
        except (InvalidSignature, AssertionError) as error:
            raise Refusal("the request is not signed with the key of the certificate") from error
        return RequestSigner(vehicle, f"{old.serial_number:x}")

    def renew(
        self, certificate: str, request: str, made_ms: int, signature: bytes, evidence: Mapping[str, str]
    ) -> dict[str, object]:
        """Certify another key of an enrolled vehicle; raises `Refusal`, `BadRequest`, and errors of psycopg."""
        vehicle, serial = self.proven(certificate, request, made_ms, signature)
        _check_statement(evidence, vehicle, request)
        with self._connect() as db:
            db.execute(LOCK_VEHICLE, {"vehicle": vehicle})
            row = db.execute(
                "SELECT tenant_id, revoked FROM certificate WHERE vehicle = %s AND kind = 'tls' AND serial = %s",
                (vehicle, serial),
            ).fetchone()
            if row is None or row[1] is not None:
                raise Refusal("the certificate is revoked; ask the operator of the centre")
            if _renewed(db, vehicle, datetime.now(UTC)) >= MAX_RENEWALS:
                raise Refusal(f"this vehicle has renewed {MAX_RENEWALS} times in a day; try again tomorrow")
            answer = self._certify(db, int(row[0]), vehicle, request, evidence)
            _note(db, int(row[0]), "renewed", vehicle, evidence[KEY])
        return answer

    def _certify(
        self, db: psycopg.Connection, tenant_id: int, vehicle: str, request: str, evidence: Mapping[str, str]
    ) -> dict[str, object]:
        made = self._authority.certify(request, vehicle)
        self._register(db, tenant_id, vehicle, made, evidence)
        tenant = db.execute("SELECT name FROM tenant WHERE tenant_id = %s", (tenant_id,)).fetchone()
        return {
            "vehicle": vehicle, "tenant": "" if tenant is None else tenant[0], "certificate": made.pem,
            "authority": self._authority.pem, **self._address,
        }  # fmt: skip

    @staticmethod
    def _register(
        db: psycopg.Connection, tenant_id: int, vehicle: str, made: IssuedCertificate, evidence: Mapping[str, str]
    ) -> None:
        tls_id = hashlib.sha256(made.public_key).hexdigest()[:16]
        row: Row = (tls_id, vehicle, tenant_id, "tls", made.public_key, made.serial, made.begin, made.end)
        if not db.execute(INSERT_KEY, row).rowcount:  # its renewals would not be counted, and nobody admits its serial
            raise Refusal("the TLS key of this request was registered before; make another, and ask again")
        public = bytes.fromhex(evidence[PUBLIC_KEY])
        db.execute(INSERT_KEY, (evidence[KEY], vehicle, tenant_id, "evidence", public, None, made.begin, None))
        kept = db.execute("SELECT vehicle, revoked FROM certificate WHERE key_id = %s", (evidence[KEY],)).fetchone()
        if kept is None or kept[0] != vehicle or kept[1] is not None:
            raise Refusal(
                "the evidence key belongs to another vehicle or is revoked; make another with `obu evidence-key rotate`"
            )

    @staticmethod
    def _why(db: psycopg.Connection, hashed: bytes, vehicle: str) -> str:
        row = db.execute("SELECT vehicle, used, expires FROM enrolment WHERE token_hash = %s", (hashed,)).fetchone()
        if row is None:
            return "the centre does not know this token; ask for another one"
        if row[1] is not None:
            return "this token is used already; ask for another one"
        if row[2] <= datetime.now(UTC):
            return "this token has expired; ask for another one"
        return f"this token is for the vehicle {row[0]}, not for {vehicle}; name the unit so with `obu enrol --name`"


def _is_taken(db: psycopg.Connection, vehicle: str, tenant_id: int | None) -> bool:
    """Whether a vehicle, or an unused token of a name, keeps others from this name.

    `tenant_id` is that of a token made for the name, whose vehicle may enrol again; None: a token for any new name.
    """
    row = db.execute(
        "SELECT FROM vehicle WHERE vehicle = %(vehicle)s AND tenant_id IS DISTINCT FROM %(tenant)s UNION ALL "
        "SELECT FROM enrolment WHERE vehicle = %(vehicle)s AND used IS NULL AND expires > now() "
        "AND %(tenant)s::integer IS NULL LIMIT 1",
        {"vehicle": vehicle, "tenant": tenant_id},
    ).fetchone()
    return row is not None


def _renewed(db: psycopg.Connection, vehicle: str, now: datetime) -> int:
    row = db.execute(
        "SELECT count(*) FROM certificate WHERE vehicle = %s AND kind = 'tls' AND registered > %s",
        (vehicle, now - timedelta(days=1)),
    ).fetchone()
    return 0 if row is None else int(row[0])


def _check_statement(evidence: Mapping[str, str], vehicle: str, request: str) -> None:
    """Raise `Refusal` unless the evidence key has signed this very request."""
    if not VEHICLE.fullmatch(vehicle):
        raise Refusal(f"this is no name of a vehicle: {RULE}; name the unit otherwise with `obu enrol --name`")
    stated = evidence.get("vehicle"), evidence.get("request_sha256")
    if stated != (vehicle, request_digest(request)) or not is_genuine(STATEMENT, evidence):
        raise Refusal("the evidence key has not signed this request")


def _note(db: psycopg.Connection, tenant_id: int, action: str, vehicle: str, key: str) -> None:
    db.execute(
        "INSERT INTO audit (tenant_id, who, action, vehicle, detail) "
        "VALUES (%s, %s, %s, %s, jsonb_build_object('evidence_key', %s::text))",
        (tenant_id, vehicle, action, vehicle, key),
    )
