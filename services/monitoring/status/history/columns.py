"""The recent past: columns for the plots, and changes of the verdict with every monitor's statistic over threshold."""

from collections import deque
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from typing_extensions import TypedDict

from shared.page.answers import Stamp, answer

FINE_S, FINE_HZ = 60.0, 5.0
COARSE_HZ = 1.0
CHANGES_MAXIMUM = 500  # of the verdict
SECOND_NS, GAP_NS = 1_000_000_000, 3_000_000_000
GAP = "gap"  # state of a time in which this process did not run
NO_PROBABILITIES: Mapping[str, float] = MappingProxyType({})
FIELDS = (
    "latitude_deg",
    "longitude_deg",
    "height_ellipsoid_m",
    "speed_fused_m_s",
    "speed_gnss_m_s",
    "speed_odometer_m_s",
    "speed_truth_m_s",
    "heading_rad",
    "position_95_m",
    "satellites_used",
    "gnss_age_s",
    "position_error_m",
)


@answer({"time_ns": [1_795_380_196_007_361_076], "fields": {"speed_fused_m_s": [13.9], "position_error_m": [None]}})
class HistoryColumns(TypedDict):
    """Columns of one length; a value that was stale is null."""

    time_ns: list[Stamp]
    fields: dict[str, list[float | None]]


@answer()
class Change(TypedDict):
    """Begin of a state."""

    since_ns: Stamp
    state: str


@answer()
class TrustColumns(TypedDict):
    """Changes of the state; once a second each monitor's statistic over its threshold, and probabilities."""

    changes: list[Change]
    time_ns: list[Stamp]
    ratios: dict[str, list[float | None]]
    probabilities: dict[str, list[float | None]]
    """of each hypothesis"""


class History:
    """Two rings of samples; a value that was stale is None, so that a plot breaks its line."""

    def __init__(self, history_s: float) -> None:
        self._fine: deque[tuple[int, tuple[float | None, ...]]] = deque(maxlen=int(FINE_S * FINE_HZ))
        self._coarse: deque[tuple[int, tuple[float | None, ...]]] = deque(maxlen=max(int(history_s * COARSE_HZ), 1))

    def add(self, now_ns: int, values: Mapping[str, float | None]) -> None:
        """Note one sample; every call goes to the fine ring, one a second to the coarse one."""
        row = (now_ns, tuple(values.get(name) for name in FIELDS))
        self._fine.append(row)
        if not self._coarse or now_ns - self._coarse[-1][0] >= 0.95e9 / COARSE_HZ:
            self._coarse.append(row)

    def columns(self, now_ns: int, seconds: float, fields: Sequence[str] = FIELDS) -> HistoryColumns:
        """Give the last seconds as one list of stamps and one list of values a field; unknown fields are KeyError."""
        indices = {name: FIELDS.index(name) if name in FIELDS else None for name in fields}
        if unknown := [name for name, index in indices.items() if index is None]:
            raise KeyError(unknown[0])
        ring = self._fine if seconds <= FINE_S else self._coarse
        rows = [row for row in ring if row[0] >= now_ns - int(seconds * 1e9)]
        values = {name: [row[1][i] for row in rows] for name, i in indices.items() if i is not None}
        return {"time_ns": [row[0] for row in rows], "fields": values}


class TrustHistory:
    """Changes of the shown verdict; once a second statistics over thresholds and probabilities; all bounded."""

    def __init__(self, history_s: float) -> None:
        self.changes: deque[tuple[int, str]] = deque(maxlen=CHANGES_MAXIMUM)  # stamp and state, oldest first
        self._last_ns = 0
        self._rows: deque[tuple[int, Mapping[str, float], Mapping[str, float]]] = deque(
            maxlen=max(int(history_s * COARSE_HZ), 1)
        )  # stamp, ratio of each monitor, probability of each hypothesis

    def add(
        self,
        now_ns: int,
        state: str,
        ratios: Mapping[str, float | None],
        probabilities: Mapping[str, float] = NO_PROBABILITIES,
    ) -> bool:
        """Note the state, and at most once a second the ratios, of which None was not evaluated; says whether it did.

        A time without any note is a gap: nobody knows the state of then.
        """
        if self._last_ns and now_ns - self._last_ns > GAP_NS:
            self.changes.append((self._last_ns + SECOND_NS, GAP))
        self._last_ns = now_ns
        changed = not self.changes or self.changes[-1][1] != state
        if changed:
            self.changes.append((now_ns, state))
        second = not self._rows or now_ns - self._rows[-1][0] >= 0.95e9 / COARSE_HZ
        if second:
            known = {name: ratio for name, ratio in ratios.items() if ratio is not None}
            self._rows.append((now_ns, known, probabilities))
        return changed or second

    def columns(self, now_ns: int, seconds: float) -> TrustColumns:
        """Give the last seconds: changes, stamps, ratios and probabilities by name, None where not evaluated."""
        from_ns = now_ns - int(seconds * 1e9)
        rows = [row for row in self._rows if row[0] >= from_ns]
        return {
            "changes": [{"since_ns": ns, "state": state} for ns, state in self.changes],
            "time_ns": [ns for ns, _, _ in rows],
            "ratios": _columns([ratios for _, ratios, _ in rows]),
            "probabilities": _columns([probabilities for _, _, probabilities in rows]),
        }


def _columns(rows: Sequence[Mapping[str, float]]) -> dict[str, list[float | None]]:
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}
