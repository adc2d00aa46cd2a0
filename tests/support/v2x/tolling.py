"""Statements on a passage as `core.toll` makes them, and what else a ledger receives."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

from services.monitoring.ledger.ledger import Ledger, Settings
from services.monitoring.ledger.store import Store
from shared.evidence import KeyFile
from shared.messages.toll import (
    EvidenceFrame,
    LaneProbability,
    PassageEvidence,
    PassageState,
    PlazaDetector,
    TollPassage,
    TollReceipt,
    TollRegistration,
    TollTransaction,
)
from shared.toll.plaza import Plaza, parse_plaza, plaza_path

NS = 1_000_000_000
START_NS = 1_790_000_400 * NS  # 400 s behind a full hour
EXAMPLE = Path("deploy/plazas/example.geojson")
WITH_DETECTORS = plaza_path(EXAMPLE).read_text()
WITHOUT_DETECTORS = WITH_DETECTORS.replace('"detector": true', '"detector": false')
COUNTED, PLAZA = (parse_plaza(text.encode()) for text in (WITH_DETECTORS, WITHOUT_DETECTORS))
STATION = 3_405_691_582


@dataclass
class Vehicle:
    """One vehicle on its passage; each name has a station ID and a contract of its own."""

    name: str = "a"
    station_ids: tuple[int, ...] = ()
    lane: str | None = "n2"
    opened_ns: int = START_NS
    crossing_ns: int = START_NS + 15 * NS
    frames: tuple[bytes, ...] = (b"first frame", b"second frame")
    states: list[PassageState] = field(default_factory=list)
    plaza: Plaza = PLAZA

    def __post_init__(self) -> None:
        self.station_ids = self.station_ids or (STATION if self.name == "a" else int(self.passage_id[:7], 16),)

    @property
    def passage_id(self) -> str:
        return hashlib.sha256(self.name.encode()).hexdigest()

    def registration(self, contract: str = "", tariff_class: str = "car", **changes: int) -> TollRegistration:
        contract = contract or ("contract-1" if self.name.split()[0] == "a" else f"contract of {self.name}")
        values = {"sampled_ns": self.opened_ns, "valid_until_ns": self.opened_ns + 300 * NS,
                  "station_id": self.station_ids[-1], **changes}  # fmt: skip
        return TollRegistration.model_validate({"contract": contract, "tariff_class": tariff_class, **values})

    def says(self, state: PassageState, sampled_ns: int | None = None, **changes: object) -> TollPassage:
        """Make a statement; the crossing and its evidence are there from CROSSED on."""
        crossed = state not in (PassageState.OPEN, PassageState.VOID)
        evidence = PassageEvidence(
            version="1", settings="{}", track_since_ns=self.opened_ns, deltas=(), lanes=(),
            frames=tuple(
                EvidenceFrame(sampled_ns=self.opened_ns, received_ns=self.opened_ns, data=data) for data in self.frames
            ),
        )  # fmt: skip
        statement = TollPassage(
            sampled_ns=sampled_ns or (self.crossing_ns if crossed else self.opened_ns),
            passage_id=self.passage_id,
            plaza=self.plaza.name,
            plaza_digest=self.plaza.digest,
            state=state,
            station_ids=self.station_ids,
            opened_ns=self.opened_ns,
            crossing_ns=self.crossing_ns if crossed else None,
            crossing_sd_s=0.1 if crossed else None,
            lane=self.lane,
            lanes=(LaneProbability(lane=self.lane or "n2", probability=0.995 if self.lane else 0.7),),
            latitude_deg=49.44,
            longitude_deg=1.1,
            heading_rad=0.5,
            speed_m_s=14.0,
            position_sd_m=0.6,
            evidence=evidence if state in (PassageState.CROSSED, PassageState.CHARGED) else None,
        )
        return statement.model_copy(update=changes)

    def pulse(self, number: int = 0, lane: str | None = None, earlier_ns: tuple[int, ...] = ()) -> PlazaDetector:
        return PlazaDetector(
            sampled_ns=self.crossing_ns, plaza=PLAZA.name, lane=lane or self.lane or "n2", since_ns=START_NS - NS,
            pulse=number, earlier_ns=earlier_ns,
        )  # fmt: skip


def ledger_at(
    path: Path, now_ns: int = START_NS, *, counted: bool = False, key: KeyFile | None = None, plaza_file: str = "",
    **settings: float,
) -> tuple[Ledger, Store]:  # fmt: skip
    """Open a ledger of the example plaza, with detectors or without, or of another file."""
    store = Store(path)
    text, plaza = (WITH_DETECTORS, COUNTED) if counted else (WITHOUT_DETECTORS, PLAZA)
    if plaza_file:
        text, plaza = plaza_file, parse_plaza(plaza_file.encode())
    return Ledger(store, plaza, text, Settings.model_validate(settings), now_ns, key=key), store


def answer(transaction: TollTransaction, now_ns: int, *, accepted: bool = True) -> TollReceipt:
    """Answer as the operator does."""
    return TollReceipt(
        received_ns=now_ns, transaction_id=transaction.transaction_id, passage_id=transaction.passage_id,
        operator="operator", accepted=accepted,
    )  # fmt: skip
