"""The ITS station of a simulated vehicle that signs: its ticket, its signed packets, its registrations."""

from dataclasses import dataclass

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, utils

from shared.messages.toll import TollRegistration
from shared.toll.registration import countersign, sign_possession
from shared.toll.simulated import operator
from shared.v2x import its_time
from shared.v2x.security.issuing.signing import HASHES, Holder, sign_packet
from shared.v2x.security.issuing.simulated import ticket

CERTIFICATE_NS = 1_000_000_000  # period in which a station sends its certificate: TS 103 097, 7.1.1
US_PER_MS = 1_000


@dataclass
class Station:
    """A station with one ticket; another pseudonym is another station."""

    holder: Holder
    certificate_ns: int | None = None  # when the certificate was sent

    @classmethod
    def make(cls, seed: bytes, utc_ns: int) -> "Station":
        """Obtain a ticket that is valid at a time."""
        return cls(ticket(seed, its_time.its_time_ms(utc_ns) // 1000))

    def sign(self, packet: bytes, utc_ns: int) -> bytes:
        """Sign a packet: with the certificate once a second, otherwise with its digest."""
        is_due = self.certificate_ns is None or utc_ns - self.certificate_ns >= CERTIFICATE_NS
        if is_due:
            self.certificate_ns = utc_ns
        return sign_packet(packet, self.holder, its_time.its_time_ms(utc_ns) * US_PER_MS, with_certificate=is_due)

    def register(self, registration: TollRegistration) -> TollRegistration:
        """Prove possession of the ticket, and have the operator countersign it."""
        return countersign(sign_possession(registration, self.holder.certificate.encoded, self._sign), operator())

    def _sign(self, data: bytes) -> bytes:
        algorithm: hashes.HashAlgorithm = HASHES[self.holder.certificate.hash_name]
        signature = self.holder.key.sign(data, ec.ECDSA(algorithm, deterministic_signing=True))
        size = self.holder.key.curve.key_size // 8
        return b"".join(part.to_bytes(size) for part in utils.decode_dss_signature(signature))
