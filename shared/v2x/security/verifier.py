"""Decides whether the sender of a signed CAM is authenticated (TS 103 097, 7.1.1; IEEE 1609.2, 5.2 and 5.3).

Cheap checks come before signatures. A ticket is examined once; frames that name it by its digest alone are held until
its certificate comes. Everything that a sender can make grow is bounded, and what is beyond a bound is not verified.
"""

from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from ...messages.v2x import Authentication, Unverified
from . import regions, signatures
from .certificates import CAM_PSID, Certificate, take_certificate
from .envelope import SignedData, SignedPacket
from .reader import Reader
from .trust import Issuer, Refused, TrustStore

Frame = TypeVar("Frame")

NS_PER_S = 1_000_000_000
HELD_NS = NS_PER_S  # a station sends its certificate once a second (TS 103 097, 7.1.1)
MOST_HELD, MOST_HELD_OF_TICKET = 2_000, 12
MOST_TICKETS = 4_096  # valid ones
MOST_REFUSED = 32_768  # digests of tickets that are refused or of unknown issuers
# New tickets whose signature is checked, a second and at once; as many again of those that name a ticket by which
# frames wait: a station sends several with the digest between two with the certificate, and a flood would have to.
TICKETS_S = 100.0
WAITING = 3
MOST_PACKETS = 4_096  # verified ones that are recognised when they are received again
SIGNATURE_ENDS = (66, 98)  # bytes behind a certificate: a signature with x-only r, of 256 or 384 bits
SSP_VERSION = 1


@dataclass(frozen=True)
class Stated:
    """What the CAM in a signed packet states, as far as it matters here."""

    latitude_deg: float | None
    longitude_deg: float | None
    permissions: int  # that its containers need, as the bits of the SSP behind its version


@dataclass(frozen=True)
class Verdict:
    """What was found of the sender of a frame."""

    authentication: Authentication = Authentication.SIGNED_NOT_VERIFIED
    unverified: Unverified | None = None
    refused: Refused | None = None  # the frame is not used at all


AUTHENTICATED = Verdict(Authentication.AUTHENTICATED)
Ticket = tuple[Certificate, Issuer]


@dataclass(frozen=True)
class _Held(Generic[Frame]):
    frame: Frame
    packet: SignedPacket
    stated: Stated
    since_ns: int


class Verifier(Generic[Frame]):
    """Verifies signed packets; `Frame` is what the caller wants back with a verdict."""

    def __init__(
        self,
        store: TrustStore,
        *,
        countries: tuple[int, ...] = (),
        grace_s: float = 0.0,
        is_simulated: bool = False,
    ) -> None:
        self._store, self._countries = store, frozenset(countries)
        self._grace_s, self._is_simulated = grace_s, is_simulated
        self._tickets: OrderedDict[bytes, Ticket] = OrderedDict()  # by digest, the last used at the end
        self._others: OrderedDict[bytes, Verdict] = OrderedDict()  # tickets without a trusted chain, or refused
        self._held: OrderedDict[bytes, list[_Held[Frame]]] = OrderedDict()  # by digest of the ticket
        self._known: OrderedDict[bytes, Certificate] = OrderedDict()  # of `_tickets`, by their bytes
        self._packets: OrderedDict[bytes, None] = OrderedDict()  # digests of verified packets
        self._tokens = {False: TICKETS_S, True: TICKETS_S}  # by whether frames wait for the ticket
        self._tokens_ns = 0
        self.held = 0  # frames that wait for a certificate
        self.counts: Counter[str] = Counter()  # of costly operations

    def take(self, reader: Reader) -> Certificate:
        """Read a certificate; one of a known ticket is recognised by its bytes."""
        rest = reader.data[reader.position :]
        for size in SIGNATURE_ENDS:
            if known := self._known.get(rest[:-size]):
                reader.expect(known.encoded)
                return known
        self.counts["certificates read"] += 1
        return take_certificate(reader)

    def submit(
        self, frame: Frame, packet: SignedPacket, stated: Stated, now_ns: int
    ) -> Iterator[tuple[Frame, Verdict]]:
        """Verify a packet, and those that its certificate releases; a packet that has to wait yields nothing.

        Parameters
        ----------
        frame : Frame
            What is yielded with the verdict.
        packet : SignedPacket
            Whose times were compared with the reception and the CAM.
        stated : Stated
            Of the CAM in it.
        now_ns : int
            [ns] Reception.
        """
        if not self._store.issuers:
            yield frame, Verdict(unverified=Unverified.NO_TRUST)
            return
        if packet.certificate is not None:
            self._examine(packet.certificate, packet.generation_time_s, now_ns)
            released = self._held.pop(packet.signer, [])
            self.held -= len(released)
            for held in released:
                yield held.frame, self._verdict(held.packet, held.stated)
        elif not self._is_known(packet.signer):
            if self._hold(_Held(frame, packet, stated, now_ns)):
                return
            yield frame, Verdict(unverified=Unverified.TOO_MANY)
            return
        yield frame, self._verdict(packet, stated)

    def expire(self, now_ns: int) -> Iterator[tuple[Frame, Verdict]]:
        """Release the frames that have waited for too long: they are not verified."""
        for digest, frames in list(self._held.items()):
            while frames and not 0 <= now_ns - frames[0].since_ns < HELD_NS:
                self.held -= 1
                yield frames.pop(0).frame, Verdict(unverified=Unverified.NO_CERTIFICATE)
            if not frames:
                del self._held[digest]

    def release(self) -> Iterator[tuple[Frame, Verdict]]:
        """Release every frame that waits: this verifier ends."""
        for frames in self._held.values():
            for held in frames:
                yield held.frame, Verdict(unverified=Unverified.NO_CERTIFICATE)
        self._held.clear()
        self.held = 0

    def _is_known(self, digest: bytes) -> bool:
        return digest in self._tickets or digest in self._others

    def _hold(self, held: _Held[Frame]) -> bool:
        waiting = self._held.get(held.packet.signer, [])
        if len(waiting) >= MOST_HELD_OF_TICKET or self.held >= MOST_HELD:
            return False
        self._held.setdefault(held.packet.signer, waiting).append(held)
        self.held += 1
        return True

    def _examine(self, certificate: Certificate, time_s: float, now_ns: int) -> None:
        """Find out once whether a ticket is of a trusted chain."""
        if self._is_known(certificate.digest):
            return
        issuer = self._store.issuers.get(certificate.issuer or b"")
        if issuer is None:
            self._set_aside(certificate.digest, Verdict(unverified=Unverified.UNKNOWN_ISSUER))
        elif refused := _mismatch(certificate, issuer):
            self._set_aside(certificate.digest, Verdict(refused=refused))
        elif refused := issuer.refusal(time_s) or _expired(certificate, time_s):
            return  # by each packet again: time goes on
        elif not self._may_check(now_ns, waiting=len(self._held.get(certificate.digest, ())) >= WAITING):
            return
        elif signatures.is_issued_by(certificate, issuer.certificate):
            self._tickets[certificate.digest] = certificate, issuer
            self._known[certificate.encoded] = certificate
            if len(self._tickets) > MOST_TICKETS:
                _, (oldest, _) = self._tickets.popitem(last=False)
                self._known.pop(oldest.encoded, None)
        else:
            self._set_aside(certificate.digest, Verdict(refused=Refused.SIGNATURE))

    def _set_aside(self, digest: bytes, verdict: Verdict) -> None:
        self._others[digest] = verdict
        if len(self._others) > MOST_REFUSED:
            self._others.popitem(last=False)

    def _may_check(self, now_ns: int, *, waiting: bool) -> bool:
        """Take a token for the signature of a new ticket."""
        earned = TICKETS_S * max(now_ns - self._tokens_ns, 0) / NS_PER_S
        self._tokens = {kind: min(tokens + earned, TICKETS_S) for kind, tokens in self._tokens.items()}
        self._tokens_ns = now_ns
        kind = waiting and self._tokens[True] >= 1.0
        if self._tokens[kind] < 1.0:
            return False
        self._tokens[kind] -= 1.0
        self.counts["tickets checked"] += 1
        return True

    def _verdict(self, packet: SignedPacket, stated: Stated) -> Verdict:
        """Verify a packet whose ticket was examined."""
        if packet.signer in self._others:
            return self._others[packet.signer]
        time_s = packet.generation_time_s
        if packet.signer not in self._tickets:
            return self._without_ticket(packet, time_s)
        certificate, issuer = self._tickets[packet.signer]
        self._tickets.move_to_end(packet.signer)
        refused = issuer.refusal(time_s) or _expired(certificate, time_s)
        if refused is None and not _is_permitted(certificate.ssp, stated.permissions):
            refused = Refused.PERMISSION
        if refused is None and not self._is_here((certificate, *issuer.chain), stated):
            refused = Refused.REGION
        if refused is None and not self._is_signed(certificate, packet.data):
            refused = Refused.SIGNATURE
        if refused is not None:
            return Verdict(refused=refused)
        doubt = issuer.doubt(time_s, self._grace_s, is_simulated=self._is_simulated)
        return Verdict(unverified=doubt) if doubt else AUTHENTICATED

    def _without_ticket(self, packet: SignedPacket, time_s: float) -> Verdict:
        """Verdict on a ticket that no result is kept of: it is not valid now, or too many are new."""
        certificate = packet.certificate
        issuer = self._store.issuers.get(certificate.issuer or b"") if certificate else None
        if certificate and issuer and (refused := issuer.refusal(time_s) or _expired(certificate, time_s)):
            return Verdict(refused=refused)
        return Verdict(unverified=Unverified.TOO_MANY)

    def _is_here(self, chain: tuple[Certificate, ...], stated: Stated) -> bool:
        return all(
            regions.holds(certificate.region, stated.latitude_deg, stated.longitude_deg, self._countries)
            for certificate in chain
        )

    def _is_signed(self, certificate: Certificate, data: SignedData) -> bool:
        """Whether the ticket's key has signed it; a packet that is received again is not verified again."""
        digest = data.digest + data.signature.r + data.signature.s
        if digest in self._packets:
            return True
        self.counts["packets checked"] += 1
        if not signatures.is_signed_by(certificate, data.tbs_data, data.signature):
            return False
        self._packets[digest] = None
        if len(self._packets) > MOST_PACKETS:
            self._packets.popitem(last=False)
        return True


def _mismatch(certificate: Certificate, issuer: Issuer) -> Refused | None:
    """Why a certificate cannot be a ticket of its issuer, without its signature (TS 103 097, 7.2.1)."""
    authority, root = issuer.chain
    if certificate.grants or certificate.permission(CAM_PSID) is None:
        return Refused.PERMISSION
    if not (authority.grants_all(certificate.permissions, 1) and root.grants_all(certificate.permissions, 2)):
        return Refused.PERMISSION
    if certificate.start_s < authority.start_s or certificate.end_s > authority.end_s:
        return Refused.EXPIRED
    return None


def _expired(certificate: Certificate, time_s: float) -> Refused | None:
    return None if certificate.start_s <= time_s <= certificate.end_s else Refused.EXPIRED


def _is_permitted(ssp: bytes | None, needed: int) -> bool:
    """Whether the SSP for CAM (EN 302 637-2, 6.2.2) has every bit that the containers need."""
    if ssp is None or len(ssp) < 3 or ssp[0] != SSP_VERSION:
        return False
    return needed & ~int.from_bytes(ssp[1:3]) == 0
