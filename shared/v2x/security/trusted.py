"""The verifier of signed frames, with the trusted certificates of a folder that may change while the unit runs."""

import logging
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Generic, TypeVar

from ... import shipped
from . import trust
from .certificates import Certificate
from .envelope import SignedPacket
from .reader import Reader
from .verifier import Stated, Verdict, Verifier

log = logging.getLogger(__name__)
Frame = TypeVar("Frame")
LOOKED_NS = 10_000_000_000  # period in which changes of the folder are looked for


class Trusted(Generic[Frame]):
    """Verifies packets by what the folder held when it was last read."""

    def __init__(
        self,
        folder: Path | None,
        rejects: Counter[str],
        *,
        countries: tuple[int, ...] = (),
        grace_s: float = 0.0,
        is_simulated: bool = False,
    ) -> None:
        self._folder = shipped(folder) if folder else None
        self._rejects = rejects
        self._countries, self._grace_s, self._is_simulated = countries, grace_s, is_simulated
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
        store = trust.TrustStore()
        if self._folder is not None:
            self._fingerprint = trust.fingerprint(self._folder)
            store = trust.load(self._folder)
            log.info("trusted roots: %s", trust.names(root.certificate for root in store.roots.values()))
        for fault in store.faults:
            self._rejects["trust_file"] += 1
            log.warning("%s: %s", self._folder, fault)
        return Verifier(store, countries=self._countries, grace_s=self._grace_s, is_simulated=self._is_simulated)
