"""The CAM of charged passages, by keyed digests: what has been charged once is recognised when somebody sends it again.

Unsigned CAM repeat their times every 65.536 s, and their headers can be rewritten. A digest is kept for as long as the
evidence. It is keyed, by the signature of the unit's key on a constant, so that who has the file alone cannot ask it
for a CAM that he has recorded; after a rotation of the key, replays of earlier passages are not recognised.
"""

import hashlib
from collections.abc import Iterator

from shared.errors import RejectedFrame
from shared.evidence import KeyFile
from shared.evidence.signer import EvidenceError
from shared.messages.explanation import Explanation, explain
from shared.messages.explanation import passage as passage_of
from shared.messages.toll import PassageEvidence
from shared.v2x.evidence import replay_digest

from .codes import Code
from .store import Store

DIGEST_BYTES = 16
KEYED = b"digests of charged CAM"  # what is signed for the key


class Replays:
    """Keeps and searches digests; every method runs inside a transaction of the store."""

    def __init__(self, store: Store, key: KeyFile | None) -> None:
        self._store, self._key = store, key

    def found(self, passage_id: str, evidence: PassageEvidence) -> Explanation | None:
        """Say that a CAM of a passage is one of another passage that was charged; None: none is."""
        for digest in self._digests(evidence):
            row = self._store.row("SELECT passage_id FROM replay WHERE digest = ?", digest)
            if row is not None and row["passage_id"] != passage_id:
                return explain(Code.REPLAYED, passage=passage_of(row["passage_id"]))
        return None

    def keep(self, passage_id: str, evidence: PassageEvidence, now_ns: int) -> None:
        """Keep the digests of a passage."""
        for digest in self._digests(evidence):
            self._store.execute("INSERT OR IGNORE INTO replay VALUES (?, ?, ?)", digest, passage_id, now_ns)

    def expire(self, before_ns: int) -> None:
        """Delete what is older than the evidence that is kept."""
        self._store.execute("DELETE FROM replay WHERE stored_ns < ?", before_ns)

    def _digests(self, evidence: PassageEvidence) -> Iterator[bytes]:
        secret = self._secret()
        for frame in evidence.frames:
            try:
                digest = replay_digest(frame.data)
            except RejectedFrame:
                continue  # no CAM: nothing was charged for it, and `verify-toll` names it
            yield hashlib.blake2b(digest, key=secret, digest_size=DIGEST_BYTES).digest()

    def _secret(self) -> bytes:
        """Key of the digests; none without a key of the unit, or while it cannot be read."""
        try:
            return self._key.signer().sign(KEYED) if self._key else b""
        except EvidenceError:
            return b""
