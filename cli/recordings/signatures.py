"""The part of `obu verify` that checks signatures: of each recording, and from one to the next."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from shared.errors import BadRecording, UserError
from shared.evidence import KeyRing, Outcome
from shared.evidence.statement import printable
from shared.recording.proof import Proof, clock, prove

from ..evidence_key import accepted_keys
from .common import open_recording


@dataclass(frozen=True)
class SignatureReport:
    """What the signatures of one file prove."""

    file: str
    outcome: Outcome
    text: str
    facts: str | None = None  # whose recording it is, as far as that is signed
    gap: str | None = None  # what is missing between it and the file before

    @property
    def outcomes(self) -> list[Outcome]:
        """Of the file, and of its place after the one before."""
        return [self.outcome, *([Outcome.EDITED] if self.gap else [])]


def check_signatures(files: Sequence[Path], keys: Sequence[Path] | None) -> list[SignatureReport]:
    """Check recordings in the order of time."""
    ring = accepted_keys(keys)
    proofs = [_prove(path, ring) for path in files]
    return [
        SignatureReport(
            path.name, proof.outcome, proof.text, _facts(proof),
            _succession(proofs[number - 1], proof) if number else None,
        )
        for number, (path, proof) in enumerate(zip(files, proofs, strict=True))
    ]  # fmt: skip


def _prove(path: Path, ring: KeyRing) -> Proof:
    with open_recording(path) as recording:
        try:
            return prove(recording, ring)
        except BadRecording as error:
            raise UserError(f"{error}; give a file written by `obu record` or the unit's recorder") from error


def _facts(proof: Proof) -> str | None:
    """Say whose recording it is, as far as that is signed."""
    seal = proof.proven or proof.first
    if seal is None or proof.outcome is Outcome.EDITED:
        return None
    parts = [
        f"vehicle {printable(seal.vehicle) or 'without a name'}",
        f"origin {printable(seal.origin)}",
        f"begun {clock(seal.started_ns)}",
        f"key {seal.key}",
    ]
    return ", ".join(parts)


def _succession(before: Proof, proof: Proof) -> str | None:
    """Name a recording that is missing between two of one recorder; None if none is, or nothing is known of it."""
    first = proof.first
    if first is None or before.proven is None or not first.previous or not before.digest:
        return None
    if before.proven.last and first.previous != before.digest and before.first is not None:
        return "a recording is missing between this one and the one before it"
    return None
