"""The verifier of signed frames, with the trusted certificates of a folder that may change while the unit runs."""

import logging
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Generic, TypeVar

from shared import shipped
from shared.v2x.security import trust
from shared.v2x.security.certificates import Certificate
from shared.v2x.security.envelope import SignedPacket
from shared.v2x.security.reader import Reader
from shared.v2x.security.verifier import Stated, Verdict, Verifier

from .settings import Settings

log = logging.getLogger(__name__)
Frame = TypeVar("Frame")
LOOKED_NS = 10_000_000_000  # period in which changes of the folder are looked for
S_PER_H = 3600.0


class Trusted(Generic[Frame]):
    """Verifies packets by what the folder held when it was last read."""

    def __init__(self, config: Settings, rejects: Counter[str]) -> None:
        self._config, self._rejects = config, rejects
        folder = config.security.trust_folder
        self._folder: Path | None = shipped(folder) if folder else None
        self._looked_ns = 0
        self._fingerprint = b""
        self._verifier = self._read()

    def take(self, reader: Reader) -> Certificate:
        """Read a certificate of a packet."""
        return self._verifier.take(reader)

    def submit(
        self, frame: Frame, packet: SignedPacket, stated: Stated, now_ns: int
    ) -> Iterator[tuple[Frame, Verdict]]:
        """Verify a packet as `Verifier.submit`."""
        return self._verifier.submit(frame, packet, stated, now_ns)

    def expire(self, now_ns: int) -> Iterator[tuple[Frame, Verdict]]:
        """Release what has waited as `Verifier.expire`."""
        return self._verifier.expire(now_ns)

    def reload(self, now_ns: int) -> Iterator[tuple[Frame, Verdict]]:
        """Read the folder again if it has changed; frames that wait are released."""
        if self._folder is None or 0 <= now_ns - self._looked_ns < LOOKED_NS:
            return
        self._looked_ns = now_ns
        if trust.fingerprint(self._folder) != self._fingerprint:
            before, self._verifier = self._verifier, self._read()
            yield from before.release()

    def _read(self) -> Verifier[Frame]:
        security = self._config.security
        store = trust.TrustStore()
        if self._folder is not None:
            self._fingerprint = trust.fingerprint(self._folder)
            store = trust.load(self._folder)
            log.info("trusted roots: %s", trust.names(root.certificate for root in store.roots.values()))
        for fault in store.faults:
            self._rejects["trust_file"] += 1
            log.warning("%s: %s", self._folder, fault)
        return Verifier(
            store,
            countries=security.countries,
            grace_s=security.list_grace_h * S_PER_H,
            is_simulated=self._config.simulated,
        )
