"""The recent past as columns: a fine ring for the plots and a coarse one for the last quarter of an hour."""

from collections import deque
from collections.abc import Mapping, Sequence

FINE_S, FINE_HZ = 60.0, 5.0
COARSE_HZ = 1.0
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

    def columns(self, now_ns: int, seconds: float, fields: Sequence[str] = FIELDS) -> dict[str, object]:
        """Give the last seconds as one list of stamps and one list of values a field; unknown fields are KeyError."""
        indices = {name: FIELDS.index(name) if name in FIELDS else None for name in fields}
        if unknown := [name for name, index in indices.items() if index is None]:
            raise KeyError(unknown[0])
        ring = self._fine if seconds <= FINE_S else self._coarse
        rows = [row for row in ring if row[0] >= now_ns - int(seconds * 1e9)]
        values = {name: [row[1][i] for row in rows] for name, i in indices.items() if i is not None}
        return {"time_ns": [row[0] for row in rows], "fields": values}
