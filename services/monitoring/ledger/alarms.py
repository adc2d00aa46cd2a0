"""Stations without a vehicle: a few are faults, many are an attack, and an authenticated one is misbehaviour."""

from collections import deque
from typing import TypedDict

from shared.messages.explanation import explain
from shared.messages.explanation import passage as passage_of
from shared.messages.toll import AlarmKind, TollAlarm, TollPassage
from shared.toll.plaza import Plaza

from .codes import Code
from .store import Store

NS = 1_000_000_000
WINDOW_NS = 60 * NS
MANY_GHOSTS = 3  # in a lane within the window


class AlarmPlace(TypedDict):
    """Fields of an alarm that say where it is."""

    plaza: str
    lane: str | None
    latitude_deg: float
    longitude_deg: float


class Alarms:
    """Counts ghosts and stores what is to be published; runs inside a transaction of the store."""

    def __init__(self, store: Store, plaza: Plaza) -> None:
        self._store, self._plaza = store, plaza
        self._ghosts: dict[str, deque[int]] = {lane.name: deque(maxlen=1000) for lane in plaza.lanes}
        self._raised_ns: dict[str, int] = {}

    def ghost(self, passage_id: str, lane: str | None, crossing_ns: int, ticket: str | None, now_ns: int) -> None:
        """Note a station that no detector has counted at the place of another vehicle."""
        if ticket is not None:
            self._raise(
                TollAlarm(
                    **self._place(lane), sampled_ns=now_ns, kind=AlarmKind.MISBEHAVIOUR, since_ns=crossing_ns,
                    until_ns=crossing_ns, ticket=ticket, passage_id=passage_id,
                    reason_code=explain(Code.MISBEHAVIOUR, passage=passage_of(passage_id)),
                )
            )  # fmt: skip
        times = self._ghosts.get(lane or "")
        if lane is None or times is None:
            return
        times.append(crossing_ns)
        recent = [time_ns for time_ns in times if crossing_ns - time_ns <= WINDOW_NS]
        if len(recent) >= MANY_GHOSTS and now_ns - self._raised_ns.get(lane, 0) >= WINDOW_NS:
            self._raised_ns[lane] = now_ns
            self._raise(
                TollAlarm(
                    **self._place(lane), sampled_ns=now_ns, kind=AlarmKind.GHOSTS, since_ns=min(recent),
                    until_ns=max(recent), ghosts=len(recent),
                    reason_code=explain(Code.GHOSTS, ghost_count=len(recent)),
                )
            )  # fmt: skip

    def due(self) -> list[tuple[int, TollAlarm]]:
        """List what is not published yet, by row."""
        rows = self._store.rows("SELECT rowid, content FROM alarm WHERE NOT sent ORDER BY rowid LIMIT 100")
        return [(row["rowid"], TollAlarm.model_validate_json(row["content"])) for row in rows]

    def sent(self, row: int) -> None:
        """Note that an alarm is published; a kill before that repeats it."""
        self._store.execute("UPDATE alarm SET sent = 1 WHERE rowid = ?", row)

    def expire(self, before_ns: int) -> None:
        """Delete what was published and is old."""
        self._store.execute("DELETE FROM alarm WHERE sent AND since_ns < ?", before_ns)

    def newest(self) -> TollAlarm | None:
        """The newest one that is stored."""
        row = self._store.row("SELECT content FROM alarm ORDER BY rowid DESC LIMIT 1")
        return TollAlarm.model_validate_json(row["content"]) if row else None

    def count(self, since_ns: int) -> int:
        """Number of alarms since a time."""
        row = self._store.row("SELECT COUNT(*) AS n FROM alarm WHERE since_ns >= ?", since_ns)
        return int(row["n"]) if row else 0

    def _place(self, lane: str | None) -> AlarmPlace:
        """Where an alarm is: the middle of the gate line of its lane."""
        gates = [each.gate.mean(axis=0) for each in self._plaza.lanes if lane in (None, each.name)]
        place = self._plaza.position(*(gates[0].tolist() if gates else (0.0, 0.0)))
        return {
            "plaza": self._plaza.name, "lane": lane, "latitude_deg": place.latitude_deg,
            "longitude_deg": place.longitude_deg,
        }  # fmt: skip

    def _raise(self, alarm: TollAlarm) -> None:
        self._store.execute(
            "INSERT INTO alarm (since_ns, content) VALUES (?, ?)",
            alarm.since_ns, alarm.model_dump_json(exclude_none=True),
        )  # fmt: skip


def tickets_of(passage: TollPassage) -> list[str]:
    """Tickets of an authenticated passage."""
    return list(passage.tickets) if passage.authenticated else []
