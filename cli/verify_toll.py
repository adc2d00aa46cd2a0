"""`obu verify-toll`: derives charges again from their evidence, bit for bit."""

import hashlib
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError
from rich.console import Console

from services.core.toll.core import VERSION, derive
from services.core.toll.settings import Settings
from services.monitoring.ledger.pack import EARLIER_VERSIONS, chain_notes, frame_faults, pack_faults
from services.monitoring.ledger.proof import pack_fault, prove_ledger
from shared.bounded import SizeExceeded, read_bytes
from shared.errors import ConfigError, RejectedFrame, UserError
from shared.evidence import KeyRing, Outcome
from shared.evidence.outcome import OTHER_RELEASE, gravest
from shared.messages.toll import EvidencePack, PassageState, TollPassage, TollTransaction
from shared.toll.plaza import parse_plaza
from shared.unpacked import MIN_LIMIT_BYTES, BadPack, unpacked
from shared.v2x import its_time
from shared.v2x.evidence import cam_of
from shared.v2x.security.trust import TrustStore, load

from .evidence_key import KeyOption, accepted_keys
from .progress import progress_on

COMPARED = (
    "passage_id", "lane", "lanes", "crossing_ns", "crossing_sd_s", "station_ids", "opened_ns", "delta_ns", "tickets",
    "authenticated", "modes",
)  # fmt: skip
SQLITE = b"SQLite format 3\0"
SEAL_FIELD = b',"signature":'


@dataclass(frozen=True)
class Evidence:
    """A pack, where it is from, and the transaction that was made of it, if the ledger is there."""

    name: str
    pack: bytes
    transaction: TollTransaction | None = None
    damage: str = ""  # why the ledger's row cannot be read
    seal: str | None = None  # signed statement on its digest


def verify_toll(
    evidence: Annotated[list[Path], typer.Argument(help="Evidence packs (JSON), or ledgers (SQLite).")],
    passage: Annotated[
        str | None, typer.Option(metavar="ID", help="Only the passage with this ID, or the begin of it.")
    ] = None,
    export: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Also write each pack into this folder, as JSON.")
    ] = None,
    key: KeyOption = None,
    seal: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Signed entries that the operator has kept (`toll/seal`, `seal_file`)."),
    ] = None,
    trust: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Also judge the chain above each ticket by the certificates and lists of this folder.",
        ),
    ] = None,
) -> int:
    """Derive each charge again from its evidence, compare it bit for bit, and check chain and signatures.

    Lane, probabilities, crossing time, passage ID, tariff and digest are computed from the received frames, the delta
    positions, the plaza's file and the settings in the evidence pack; the contract follows from the registrations in
    it, the confirmation from the pulse in it, its lane from the pulses around it where the CAM leave it open. Of an
    authenticated charge the signature of every frame is verified; with `--trust` also its authority and root, and
    whether they are revoked, then or since. Of a ledger every booking is compared with the signed chain.
    Ends with 1 if a charge does not follow from its evidence, or --trust has no chain to judge, 3 unsigned, 5 edited,
    6 signed by an unknown key, 8 if only the release that made it can derive a charge again. The graver one counts: 5,
    6, 1, 3, 8.

    Examples:
    [bold]obu verify-toll .obu/toll/ledger.sqlite[/]
    [bold]obu verify-toll ledger.sqlite --passage 3f9a --export packs[/]
    [bold]obu verify-toll packs/3f9a.json --key plaza.pub[/]
    [bold]obu verify-toll packs/3f9a.json --trust .obu/trust[/]
    """
    ring = accepted_keys(key)
    seals = [text for path in seal or () for text in _bytes(path).decode(errors="replace").splitlines() if text.strip()]
    store = None if trust is None else _trusted(trust)
    now_s = its_time.its_time_ms(time.time_ns()) / 1000.0
    wrong = number = judged = of_earlier = 0
    outcomes: list[Outcome] = []
    with progress_on(Console(stderr=True)) as progress:
        packs = (each for path in evidence for each in _checked(path, ring, outcomes, seals))
        total = sum(map(count, evidence))
        for item, outcome, text in progress.track(packs, total=total, description="verifying"):
            pack = None if item.damage else parse(item)
            passage_id = pack.charged.passage_id if pack else item.name
            if passage and not passage_id.startswith(passage):
                continue
            number += 1
            outcomes.append(outcome)
            notes = [] if pack is None or store is None else list(chain_notes(pack, store, now_s))
            problems = [item.damage] if pack is None else differences_of(item, pack)
            problems += [note.text for note in notes if note.is_fault]
            is_wrong = bool(problems) or outcome in (Outcome.EDITED, Outcome.FOREIGN)
            wrong += is_wrong
            of_earlier += not is_wrong and pack is not None and is_of_earlier(pack)
            judged += bool(notes)
            _print(passage_id, pack, problems, text)
            for note in notes:
                if not note.is_fault:
                    print(f"  {note.text}")
            if export and pack is not None:
                export.mkdir(parents=True, exist_ok=True)
                (export / f"{passage_id}.json").write_bytes(with_seal(item))
    if not number and gravest(outcomes) is Outcome.VERIFIED:
        raise UserError(f"no evidence of {passage or 'a charge'} in {', '.join(map(str, evidence))}")
    print(f"{number - wrong - of_earlier} of {number} charges verified")
    if of_earlier:
        print(f"{of_earlier} of an earlier version: their lane and crossing by the release that made them")
    if store is not None and not judged:
        print("no charge is authenticated: --trust has judged no chain; leave it out, or name authenticated charges")
        wrong += 1
    outcome = gravest(outcomes)
    if wrong and outcome in (Outcome.VERIFIED, Outcome.UNSIGNED):
        return 1
    return OTHER_RELEASE if of_earlier and outcome is Outcome.VERIFIED else outcome


def _trusted(folder: Path) -> TrustStore:
    """Read the certificates and lists of a folder; what cannot be used is named."""
    if not folder.is_dir():
        raise UserError(f"{folder} is no folder; name the one with the certificates and lists (trust_folder)")
    store = load(folder)
    for fault in store.faults:
        print(f"{folder.name}: {fault}")
    return store


def _print(passage_id: str, pack: EvidencePack | None, problems: list[str], signature: str) -> None:
    if pack is None:
        print("  ".join([passage_id, *problems, *([signature] if signature else [])]))
        return
    good = "lane verified, of a continued passage" if is_continued(pack) else "verified"
    if is_of_earlier(pack) and not problems:
        version = pack.crossed.evidence.version if pack.crossed.evidence else ""
        good = f"of version {version} of the algorithms: verify lane and crossing with the release that made it"
        signature = signature and f"{good}; {signature.removeprefix('verified, ')}"
    said = [*problems, signature] if signature and problems else problems or [signature or good]
    print(f"{passage_id}  lane {pack.lane}  {'; '.join(said)}")


def _checked(
    path: Path, ring: KeyRing, outcomes: list[Outcome], seals: Sequence[str]
) -> Iterator[tuple[Evidence, Outcome, str]]:
    """Read the packs of a file, with what their signatures say; what concerns a whole ledger goes to `outcomes`."""
    if not _is_ledger(path):
        (found,) = read(path)
        yield found, *_signature(found, ring)
        return
    try:
        proof = prove_ledger(path, ring, seals)
    except sqlite3.Error as error:
        raise UserError(f"{path} cannot be read as a ledger: {error}; name the file of monitoring.ledger") from error
    if proof.outcome is not Outcome.UNSIGNED:  # of which each charge says whether it is one
        outcomes.append(proof.outcome)
    print(f"{path.name}: {proof.text}")
    charges = set()
    for found in read(path):
        charges.add(found.name)
        if found.name in proof.changed:
            yield found, Outcome.EDITED, proof.changed[found.name]
        elif proof.outcome is Outcome.UNSIGNED and (not proof.has_entries or found.name in proof.unsigned):
            yield found, Outcome.UNSIGNED, "verified, unsigned"
        else:
            yield found, Outcome.VERIFIED, ""
    for passage_id in proof.changed.keys() - charges:
        outcomes.append(Outcome.EDITED)
        print(f"{passage_id}  {proof.changed[passage_id]}")


def _signature(found: Evidence, ring: KeyRing) -> tuple[Outcome, str]:
    """Check the signature of a pack that stands alone."""
    if found.seal is None:
        return Outcome.UNSIGNED, "verified, unsigned"
    return pack_fault(found.seal, None, hashlib.sha256(found.pack).hexdigest(), ring) or (Outcome.VERIFIED, "")


def with_seal(evidence: Evidence) -> bytes:
    """Give a pack as a file: its JSON, with the signature as a last field."""
    if evidence.seal is None:
        return evidence.pack
    return evidence.pack[:-1] + SEAL_FIELD + evidence.seal.encode() + b"}"


def read(path: Path) -> Iterator[Evidence]:
    """Read a pack, or each pack of a ledger."""
    if not _is_ledger(path):
        whole = _bytes(path)
        pack, field, seal = whole.rstrip().rpartition(SEAL_FIELD)
        signed = Evidence(path.name, pack + b"}", seal=seal[:-1].decode(errors="replace"))
        yield signed if field else Evidence(path.name, whole)
        return
    column = "seal" if "seal" in _columns(path) else "NULL"  # of an earlier version
    for row in _rows(path, f"passage_id, pack, content, {column}", "ORDER BY booked_ns"):
        yield _evidence(*row)


def _columns(path: Path) -> set[str]:
    """Name the columns of the table of evidence."""
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
        return {row[1] for row in database.execute("PRAGMA table_info(evidence)")}


def _bytes(path: Path) -> bytes:
    try:
        return read_bytes(path, MIN_LIMIT_BYTES)
    except SizeExceeded as error:
        raise UserError(f"{path} is no evidence pack: {error}; name a pack or a ledger") from error


def _evidence(passage_id: str, compressed: object, content: object, seal: str | None) -> Evidence:
    """Read a row; one that is damaged is reported as such, and the others are verified."""
    what = "evidence"
    try:
        pack = unpacked(compressed, "zlib", MIN_LIMIT_BYTES)  # type: ignore[arg-type]  # SQLite stores any type anywhere
        EvidencePack.model_validate_json(pack)
        what = "transaction"
        transaction = TollTransaction.model_validate_json(content)  # type: ignore[arg-type]
        return Evidence(passage_id, pack, transaction, seal=seal)
    except (BadPack, TypeError, ValidationError) as error:
        first = str(error).splitlines()[0]
        return Evidence(passage_id, b"", damage=f"its {what} is damaged: {first}; restore the ledger from its backup")


def count(path: Path) -> int:
    """Count the packs of a file."""
    return int(_rows(path, "COUNT(*)")[0][0]) if _is_ledger(path) else 1


def _is_ledger(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(SQLITE)) == SQLITE
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; name an evidence pack or a ledger") from error


def _rows(path: Path, columns: str, order: str = "") -> list[tuple[Any, ...]]:
    """Columns of every charge of a ledger."""
    query = f"SELECT {columns} FROM evidence JOIN booking USING (passage_id) WHERE kind = 'charge' {order}"
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
            for pragma in ("trusted_schema=OFF", "query_only=ON"):
                database.execute(f"PRAGMA {pragma}")
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MIN_LIMIT_BYTES)
            tables = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchmany(1000)
            if not {("evidence",), ("booking",)} <= set(tables):  # a view may have rows without end
                raise sqlite3.DatabaseError("it lacks the tables evidence and booking")
            return database.execute(query).fetchall()
    except sqlite3.Error as error:
        raise UserError(f"{path} cannot be read as a ledger: {error}; name the file of monitoring.ledger") from error


def parse(evidence: Evidence) -> EvidencePack:
    """Read the content of a pack."""
    try:
        return EvidencePack.model_validate_json(evidence.pack)
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(
            f"{evidence.name} is no evidence pack: {'.'.join(map(str, first['loc']))}: {first['msg']}"
        ) from error


def differences_of(evidence: Evidence, pack: EvidencePack) -> list[str]:
    """Compare what follows from the evidence with what was charged; nothing where all agree."""
    found = []
    if (booked := evidence.transaction) is not None:
        if hashlib.sha256(evidence.pack).hexdigest() != booked.evidence_digest:
            found.append("the pack is not the one of the transaction")
        charged = (pack.lane, pack.contract, pack.tariff_class, pack.amount_cents, pack.charged.crossing_ns)
        if charged != (booked.lane, booked.contract, booked.tariff_class, booked.amount_cents, booked.crossing_ns):
            found.append("the transaction differs from its pack")
    try:
        return found + list(_derivation(pack))
    except (ConfigError, RejectedFrame, ValueError, ArithmeticError) as error:
        return [*found, f"cannot be derived: {error}"]


def _derivation(pack: EvidencePack) -> Iterator[str]:
    plaza = parse_plaza(pack.plaza_file.encode())
    if plaza.digest != pack.crossed.plaza_digest:
        yield "the plaza's file is not the one of the passage"
    if plaza.tariff.version != pack.tariff_version or plaza.tariff.classes.get(pack.tariff_class) != pack.amount_cents:
        yield "the amount is not that of the tariff"
    yield from pack_faults(pack, plaza)
    yield from frame_faults(pack)
    evidence = pack.crossed.evidence
    if evidence is None:
        yield "the crossing has no evidence"
        return
    if is_of_earlier(pack):
        return
    if evidence.version != VERSION:
        yield f"derived by version {evidence.version} of the algorithms, this is {VERSION}"
    settings = Settings.model_validate_json(evidence.settings)
    derived = derive(plaza, settings, [cam_of(frame) for frame in evidence.frames], evidence.deltas)
    again = next((said for said in derived if said.state is PassageState.CROSSED), None)
    continued = is_continued(pack)
    if again is None:
        yield (
            "cannot be derived: the crossing lies before the track that continued the passage"
            if continued
            else ("no crossing follows from the evidence")
        )
        return
    yield from _compared(again, pack.crossed, COMPARED if not continued else ("lane",))
    if pack.charged.lane != pack.crossed.lane or pack.charged.crossing_ns != pack.crossed.crossing_ns:
        yield "the final statement differs from that of the crossing"


def is_of_earlier(pack: EvidencePack) -> bool:
    """Whether earlier algorithms made the evidence: these ones derive another crossing, which says nothing of it."""
    evidence = pack.crossed.evidence
    return evidence is not None and evidence.version in EARLIER_VERSIONS


def is_continued(pack: EvidencePack) -> bool:
    """Whether another track than the one that opened the passage decided it: after a gap, or a restart of core.toll.

    Its frames alone are evidence, so that its lane is derived again, and not what rests on the earlier track.
    """
    evidence = pack.crossed.evidence
    return evidence is not None and evidence.track_since_ns != pack.crossed.opened_ns


def _compared(again: TollPassage, said: TollPassage, names: Sequence[str]) -> Iterator[str]:
    for name in names:
        derived, stated = getattr(again, name), getattr(said, name)
        if derived != stated:
            yield f"{name} is {stated}, derived {derived}"
