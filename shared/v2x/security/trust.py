"""What certificates are trusted, and until when, as the files of a folder say.

Chain of a ticket: authorization ticket <- authorization authority <- root. A root is trusted because a list of the
trust list manager has it, whose certificate lies in the folder; without a manager, because the root's lies there. There
is a manager as soon as his list is there, or a file that may be his certificate and cannot be read: damage takes trust
away, and gives none. Likewise an authority counts by its root's list where there is one, and otherwise by its file. The
files are recognised by their content, whatever their names. Those of the sub-folder `test` make test
roots.
"""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from ...bounded import SizeExceeded, read_bytes
from ...errors import RejectedFrame
from ...faults import FOREIGN
from ...messages.v2x import Unverified
from . import lists, signatures
from .certificates import CRL_PSID, CTL_PSID, Certificate, take_certificate
from .lists import TrustList, read_list
from .reader import Reader

TEST_FOLDER = "test"
MOST_FILES, MOST_BYTES = 200, 1_000_000
SIGNED_LIST = b"\x03\x81"
# First bytes of a list, and of a certificate that signs itself: preamble, version, type, tag of the issuer.
MAY_BE_OF_MANAGER = (SIGNED_LIST, b"\x80\x03\x00\x81", b"\x00\x03\x00\x81")
VERSION_1 = 0x01  # of the permissions for lists
# TS 102 941, annex B: what the holder's lists may have.
LISTS_ROOTS, LISTS_AUTHORITIES = 0x40, 0x10


class Refused(StrEnum):
    """Why a frame, a certificate or a file is refused; the reason of a reject."""

    EXPIRED = "expired"  # or not valid yet
    REVOKED = "revoked"
    PERMISSION = "wrong_permission"
    REGION = "wrong_region"
    SIGNATURE = "bad_signature"


@dataclass(frozen=True)
class Root:
    """A trusted root, and the lists that its state depends on."""

    certificate: Certificate
    is_test: bool
    listed_until_s: float | None = None  # end of the list of roots that has it; None: its file is trusted
    crl: TrustList | None = None
    earlier_crls: tuple[TrustList, ...] = ()  # the others of the folder: what they lack was revoked since

    def is_revoked_since(self, digest: bytes, time_s: float) -> bool:
        """Whether a certificate that the newest list revokes was not revoked at an ITS time [s].

        Each list repeats the entries of those before it, so that only one of later than that time, without the
        certificate, says so.
        """
        return any(crl.issued_s > time_s and digest not in crl.revoked for crl in self.earlier_crls)


@dataclass(frozen=True)
class Issuer:
    """An authority whose certificate its root has signed."""

    certificate: Certificate
    root: Root
    listed_until_s: float | None = None  # end of the root's list that has it; None: it is in a file of its own

    @property
    def chain(self) -> tuple[Certificate, Certificate]:
        """Certificates above a ticket."""
        return self.certificate, self.root.certificate

    def refusal(self, time_s: float) -> Refused | None:
        """Why nothing that it issued is accepted at an ITS time [s]."""
        crl = self.root.crl
        if crl and any(certificate.digest in crl.revoked for certificate in self.chain):
            return Refused.REVOKED
        if not all(certificate.start_s <= time_s <= certificate.end_s for certificate in self.chain):
            return Refused.EXPIRED
        return None

    def doubt(self, time_s: float, grace_s: float, *, is_simulated: bool) -> Unverified | None:
        """Why it cannot authenticate a sender at an ITS time [s], though nothing is refused.

        Parameters
        ----------
        time_s : float
            [s] ITS time.
        grace_s : float
            [s] For how long a list counts after its next one is due.
        is_simulated : bool
            Whether the unit runs beside simulated traffic: test roots are trusted there only.
        """
        if self.root.is_test and not is_simulated:
            return Unverified.TEST_ROOT
        if self.root.crl is None:
            return Unverified.NO_REVOCATIONS
        ends_s = (self.root.crl.until_s, self.root.listed_until_s, self.listed_until_s)
        if any(end_s is not None and time_s > end_s + grace_s for end_s in ends_s):
            return Unverified.LISTS_EXPIRED
        return None


@dataclass(frozen=True)
class TrustStore:
    """Authorities by the HashedId8 of their certificates, and what is wrong with the files."""

    issuers: dict[bytes, Issuer] = field(default_factory=dict)
    roots: dict[bytes, Root] = field(default_factory=dict)
    faults: tuple[str, ...] = ()  # a sentence for each file, or list, that is not used


@dataclass
class _Files:
    """Content of one folder."""

    certificates: list[tuple[str, Certificate]] = field(default_factory=list)
    lists: list[tuple[str, TrustList]] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    doubtful: list[str] = field(default_factory=list)  # names of files that may be of a trust list manager


def load(folder: Path) -> TrustStore:
    """Read the certificates and lists of a folder; what cannot be used is named in `faults`, and is not trusted."""
    live, test = _read(folder), _read(folder / TEST_FOLDER, may_be_absent=True)
    issuers: dict[bytes, Issuer] = {}
    roots: dict[bytes, Root] = {}
    for files, is_test in ((test, True), (live, False)):  # a root in both counts as a live one
        found = {root.certificate.digest: root for root in _roots(files, is_test=is_test)}
        roots |= found
        issuers |= {issuer.certificate.digest: issuer for issuer in _issuers(files, found)}
    return TrustStore(issuers, roots, tuple(live.faults + test.faults))


def fingerprint(folder: Path) -> bytes:
    """Digest of names, sizes and times of the files: another one after a change."""
    found = hashlib.sha256()
    for path in (*_paths(folder), *_paths(folder / TEST_FOLDER)):
        try:
            status = path.stat()
        except OSError:
            continue  # deleted meanwhile: the next look differs as well
        found.update(f"{path}\0{status.st_size}\0{status.st_mtime_ns}\0".encode())
    return found.digest()


def _paths(folder: Path) -> list[Path]:
    """Files of a folder; none of one that cannot be read, which `load` names."""
    try:
        return _files(folder)
    except OSError:
        return []


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_file())


def _read(folder: Path, *, may_be_absent: bool = False) -> _Files:
    files, paths = _Files(), list[Path]()
    try:
        paths = _files(folder)
    except OSError as error:
        if not (may_be_absent and isinstance(error, (FileNotFoundError, NotADirectoryError))):
            files.faults.append(f"{folder}: cannot be read: {error.strerror or error}")
    if len(paths) > MOST_FILES:
        files.faults.append(f"{folder}: {len(paths)} files, of which the first {MOST_FILES} by name are read")
        files.doubtful += [path.name for path in paths[MOST_FILES:]]
    for path in paths[:MOST_FILES]:
        data = b""
        try:
            data = read_bytes(path, MOST_BYTES)
            if data[:2] == SIGNED_LIST:
                files.lists.append((path.name, read_list(data)))
            else:
                files.certificates.append((path.name, _whole_certificate(data)))
        except (RejectedFrame, SizeExceeded, OSError, *FOREIGN) as error:
            files.faults.append(f"{path.name}: neither a certificate nor a trust list that can be used: {error}")
            if not data or data.startswith(MAY_BE_OF_MANAGER):
                files.doubtful.append(path.name)
    return files


def _whole_certificate(data: bytes) -> Certificate:
    reader = Reader(data)
    certificate = take_certificate(reader)
    if reader.position != len(data):
        raise RejectedFrame("security_encoding", f"{len(data) - reader.position} bytes behind it")
    return certificate


def _roots(files: _Files, *, is_test: bool) -> Iterator[Root]:
    """Trusted roots of a folder, with their newest lists of revoked certificates."""
    own = [(name, certificate) for name, certificate in files.certificates if certificate.issuer is None]
    for name, certificate in own:
        if not signatures.signs_itself(certificate):
            files.faults.append(f"{name}: its own signature does not fit it")
            files.doubtful.append(name)
    whole = [certificate for _, certificate in own if signatures.signs_itself(certificate)]
    managers = [certificate for certificate in whole if _may_list(certificate, LISTS_ROOTS)]
    found: dict[bytes, tuple[Certificate, float | None]] = {}
    of_manager = [name for name, trusted in files.lists if trusted.kind == lists.OF_MANAGER]
    if managers:
        newest = _newest(files, lists.OF_MANAGER, managers, CTL_PSID)
        for trusted in newest.values():
            for root in trusted.roots:
                if root.digest not in trusted.deleted and signatures.signs_itself(root):
                    found[root.digest] = root, float(trusted.until_s)
    elif doubtful := [*of_manager, *files.doubtful]:
        if any(certificate.grants for certificate in whole):
            files.faults.append(f"{doubtful[0]}: may be of a trust list manager, so that roots in files do not count")
    else:
        found = {certificate.digest: (certificate, None) for certificate in whole if certificate.grants}
    crls = _lists_of(files, lists.REVOKED, [root for root, _ in found.values()], CRL_PSID)
    for digest, (root, until_s) in found.items():
        of_root = crls.get(digest, [])
        yield Root(root, is_test, until_s, of_root[-1] if of_root else None, tuple(of_root[:-1]))


def _issuers(files: _Files, roots: dict[bytes, Root]) -> Iterator[Issuer]:
    """Authorities that trusted roots have signed: of the roots' lists, and of files."""
    may_list = [root.certificate for root in roots.values() if _may_list(root.certificate, LISTS_AUTHORITIES)]
    listed = _newest(files, lists.OF_ROOT, may_list, CTL_PSID)
    named: list[tuple[str, Certificate, float | None]] = [
        (certificate.name, certificate, float(trusted.until_s))
        for trusted in listed.values()
        for certificate in trusted.authorities
        if certificate.digest not in trusted.deleted
    ]
    by_list = {certificate.digest for _, certificate, _ in named}
    named += [(name, certificate, None) for name, certificate in files.certificates if certificate.issuer is not None]
    for name, certificate, until_s in named:
        root = roots.get(certificate.issuer or b"")
        if root is None:
            files.faults.append(f"{name}: its root is not trusted")
        elif until_s is None and root.certificate.digest in listed:
            if certificate.digest not in by_list:
                files.faults.append(f"{name}: the list of its root does not have it")
        elif not signatures.is_issued_by(certificate, root.certificate):
            files.faults.append(f"{name}: the signature of its root does not fit it")
        elif not root.certificate.grants_all(certificate.permissions, 1):
            files.faults.append(f"{name}: its root may not grant its permissions")
        else:
            yield Issuer(certificate, root, until_s)


def _may_list(certificate: Certificate, what: int) -> bool:
    ssp = certificate.permission(CTL_PSID)
    return ssp is not None and len(ssp) == 2 and ssp[0] == VERSION_1 and bool(ssp[1] & what)


def _newest(
    files: _Files, kind: bytes, signers: Sequence[Certificate], psid: int
) -> dict[bytes, TrustList]:  # fmt: skip
    """Newest list of a kind of each signer, by its HashedId8; lists of other signers are faults."""
    return {digest: found[-1] for digest, found in _lists_of(files, kind, signers, psid).items()}


def _lists_of(
    files: _Files, kind: bytes, signers: Sequence[Certificate], psid: int
) -> dict[bytes, list[TrustList]]:  # fmt: skip
    """All lists of a kind of each signer, the newest last."""
    by_digest = {certificate.digest: certificate for certificate in signers}
    found: dict[bytes, list[TrustList]] = {}
    for name, trusted in files.lists:
        if trusted.kind != kind:
            continue
        if fault := _fault(trusted, by_digest.get(trusted.data.signer), psid):
            files.faults.append(f"{name}: {fault}")
            continue
        found.setdefault(trusted.data.signer, []).append(trusted)
    return {digest: sorted(of_signer, key=_order) for digest, of_signer in found.items()}


def _order(trusted: TrustList) -> tuple[int, int]:
    return trusted.issued_s, trusted.until_s


def _fault(trusted: TrustList, signer: Certificate | None, psid: int) -> str | None:
    if trusted.data.header["psid"] != psid:
        return "it is signed for another service"
    if signer is None:
        return "its signer is not trusted"
    if signer.permission(psid) is None:
        return "its signer may not sign it"
    if not trusted.is_full:
        return "it is a change to another list; only full ones are used"
    if not signatures.is_signed_by(signer, trusted.data.tbs_data, trusted.data.signature):
        return "its signature does not fit it"
    return None


def names(certificates: Iterable[Certificate]) -> str:
    """Names of certificates, for the log."""
    return ", ".join(sorted(certificate.name or certificate.digest.hex() for certificate in certificates)) or "none"
