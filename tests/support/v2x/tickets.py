"""Authorization tickets of our own, registrations that they sign, and the operator that countersigns."""

import hashlib
from dataclasses import dataclass

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, utils

from shared.evidence.signer import FileSigner
from shared.messages.toll import TollRegistration
from shared.messages.v2x import Authentication
from shared.toll.registration import countersign, sign_possession, ticket_of
from shared.toll.simulated import operator as simulated_operator
from shared.v2x.security.reader import encoded

NS = 1_000_000_000
OPERATOR = simulated_operator()  # whose key is in the file of the example plaza
STRANGER = FileSigner(bytes(range(1, 33)))  # another key that signs as an operator
PLAZA_NAME = "example"


def certificate_of(key: ec.EllipticCurvePrivateKey, name: str) -> bytes:
    """An explicit certificate with a key of P-256; its issuer's signature is not that of anybody."""
    numbers = key.public_key().public_numbers()
    point = (f"compressed-y-{numbers.y & 1}", numbers.x.to_bytes(32, "big"))
    head = {"version": 3, "type": "explicit", "issuer": ("sha256AndDigest", bytes(8))}
    body = {
        "id": ("name", name),
        "cracaId": bytes(3),
        "crlSeries": 0,
        "validityPeriod": {"start": 600_000_000, "duration": ("hours", 24)},
        "appPermissions": [{"psid": 36}],
        "verifyKeyIndicator": ("verificationKey", ("ecdsaNistP256", point)),
    }
    signature = ("ecdsaNistP256Signature", {"rSig": ("x-only", bytes(32)), "sSig": bytes(32)})
    parts = (("CertificateHead", head), ("ToBeSignedCertificate", body), ("Signature", signature))
    return b"\x80" + b"".join(encoded(kind, value) for kind, value in parts)


@dataclass
class Ticket:
    """A ticket with its key, which follows from its name."""

    name: str

    def __post_init__(self) -> None:
        self.key = ec.derive_private_key(
            int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:31]), ec.SECP256R1()
        )
        self.certificate = certificate_of(self.key, self.name)
        self.digest = ticket_of(self.certificate)

    def sign(self, data: bytes) -> bytes:
        r, s = utils.decode_dss_signature(self.key.sign(data, ec.ECDSA(hashes.SHA256())))
        return r.to_bytes(32, "big") + s.to_bytes(32, "big")

    @property
    def extra(self) -> dict[str, object]:
        """What an authenticated CAM of it carries."""
        return {"authentication": Authentication.AUTHENTICATED, "signer": self.digest}

    def registration(
        self, contract: str, sampled_ns: int, *, station_id: int | None = None, valid_s: float = 120.0,
        tariff_class: str = "car", operator: FileSigner = OPERATOR, plaza: str = PLAZA_NAME,
    ) -> TollRegistration:  # fmt: skip
        """A registration with both signatures."""
        plain = TollRegistration(
            sampled_ns=sampled_ns, contract=contract, tariff_class=tariff_class, station_id=station_id, plaza=plaza,
            valid_until_ns=sampled_ns + round(valid_s * NS),
        )  # fmt: skip
        return countersign(sign_possession(plain, self.certificate, self.sign), operator)


def that_requires_tickets(plaza_file: str) -> str:
    """The plaza's file, for vehicles that are authenticated only."""
    return plaza_file.replace('"require_authenticated": false', '"require_authenticated": true')


def with_operator(plaza_file: str) -> str:
    """The plaza's file, for both: the example names its operator already."""
    return plaza_file
