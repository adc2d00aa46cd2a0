"""Trust lists of TS 102 941: certificates that are trusted (CTL), and digests of those that are revoked (CRL).

Their layout in signed data, in OER: version of the protocol 1 byte, tag of the kind 1, the list. A CTL is a preamble of
1 byte, `TrustListHead`, the number of entries and the entries, each behind its tags.
"""

from dataclasses import dataclass

from ...errors import RejectedFrame
from .certificates import Certificate, take_certificate
from .envelope import SignedData, read_signed
from .reader import ENCODING, Reader

PROTOCOL = b"\x01"
REVOKED, OF_MANAGER, OF_ROOT = b"\x84", b"\x85", b"\x86"  # kind: CRL, list of the trust list manager, list of a root
NO_EXTENSION, SUCCESSOR = b"\x00", b"\x80"  # preambles
ADD, DELETE = b"\x80", b"\x81"
ROOT, ENROLMENT, AUTHORIZATION, DISTRIBUTION, MANAGER = b"\x80", b"\x81", b"\x82", b"\x83", b"\x84"
CERTIFICATE = b"\x80"  # that is deleted; otherwise the address of a distribution centre
MOST_ENTRIES = 2_000


@dataclass(frozen=True)
class TrustList:
    """A signed list; its signature is not verified."""

    data: SignedData
    kind: bytes
    is_full: bool
    sequence: int
    issued_s: int  # [s] ITS time; of a list of certificates, which states none, that of its signature
    until_s: int  # [s] ITS time at which the next one is due
    roots: tuple[Certificate, ...] = ()
    authorities: tuple[Certificate, ...] = ()  # that issue authorization tickets
    deleted: frozenset[bytes] = frozenset()  # HashedId8: of certificates that were listed
    revoked: frozenset[bytes] = frozenset()  # HashedId8


def read_list(encoded: bytes) -> TrustList:
    """Read a signed list; raises `RejectedFrame` with a reason of `read_signed`, or `security_content`."""
    data = read_signed(encoded)
    reader = Reader(data.content)
    reader.expect(PROTOCOL)
    if reader.accept(REVOKED):
        found, _ = reader.take("RevocationList")
        return TrustList(data, REVOKED, is_full=True, sequence=0, issued_s=found["thisUpdate"],
                         until_s=found["nextUpdate"], revoked=frozenset(found["entries"]))  # fmt: skip
    kind = OF_MANAGER if reader.accept(OF_MANAGER) else OF_ROOT
    if kind == OF_ROOT and not reader.accept(OF_ROOT):
        raise RejectedFrame("security_content", "no trust list")
    reader.expect(NO_EXTENSION)
    head, _ = reader.take("TrustListHead")
    entries = _Entries()
    count, _ = reader.take("Quantity")
    if count > MOST_ENTRIES:
        raise RejectedFrame(ENCODING, f"{count} entries")
    for _ in range(count):
        entries.take(reader)
    return TrustList(
        data, kind, is_full=head["isFullCtl"], sequence=head["ctlSequence"],
        issued_s=data.header.get("generationTime", 0) // 1_000_000, until_s=head["nextUpdate"],
        roots=tuple(entries.roots), authorities=tuple(entries.authorities), deleted=frozenset(entries.deleted),
    )  # fmt: skip


class _Entries:
    """Entries of a CTL, of which roots, authorities and what is deleted are kept."""

    def __init__(self) -> None:
        self.roots: list[Certificate] = []
        self.authorities: list[Certificate] = []
        self.deleted: list[bytes] = []

    def take(self, reader: Reader) -> None:
        if reader.accept(DELETE):
            if reader.accept(CERTIFICATE):
                self.deleted.append(reader.take("HashedId8")[0])
            else:
                reader.expect(b"\x81")
                reader.take("Url")
            return
        reader.expect(ADD)
        if reader.accept(ROOT):
            self.roots.append(_with_successor(reader))
        elif reader.accept(AUTHORIZATION):
            self.authorities.append(take_certificate(reader))
            reader.take("Url")
        elif reader.accept(MANAGER):
            _with_successor(reader)
            reader.take("Url")
        elif reader.accept(ENROLMENT):
            has_second = reader.accept(SUCCESSOR)
            if not has_second:
                reader.expect(NO_EXTENSION)
            take_certificate(reader)
            for _ in range(1 + has_second):
                reader.take("Url")
        else:
            reader.expect(DISTRIBUTION)
            reader.take("Url")
            reader.take("DigestList")


def _with_successor(reader: Reader) -> Certificate:
    """Read a certificate, and the link certificate to it that may follow."""
    is_linked = reader.accept(SUCCESSOR)
    if not is_linked:
        reader.expect(NO_EXTENSION)
    certificate = take_certificate(reader)
    if is_linked:
        take_certificate(reader)
    return certificate
