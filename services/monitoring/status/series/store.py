"""Which fields are kept, and their values; pure."""

from collections.abc import Iterable, Sequence

from typing_extensions import TypedDict

from shared.messages.base import Message
from shared.messages.gnss import Constellation
from shared.messages.navigation import AidingKind
from shared.page.answers import Stamp, answer
from shared.topics import BY_NAME

from ..flow import LATENCY_MAXIMUM_S, on_demand, stamp_ns
from . import computed, fields
from .fields import COMPUTED, LATENCY, Field
from .rings import BYTES_PER_FIELD, COARSE_CELLS, COARSE_NS, FINE_CELLS, FINE_NS, SECOND_NS, Ring

FIELDS_MAXIMUM = 160  # with 31 kB each at most 5 MB
BYTES_MAXIMUM = FIELDS_MAXIMUM * BYTES_PER_FIELD
KEEP_ASKED_NS = 3600 * SECOND_NS  # after the last question, a field gives way to another one
LOOKED_AT_NS = 60 * SECOND_NS  # after the last question, a field is taken from messages that come on demand
HOUR_NS = COARSE_NS * COARSE_CELLS
_CONSTELLATIONS = tuple(name for name in Constellation if name is not Constellation.UNKNOWN)
_LATENCIES = ("gnss/fix", "imu/sample", "vehicle/wheel_speed", "navigation/solution", "trust/state")
# What the page Charts draws: kept from the start, and never given up.
STANDARD = (
    *(f"{COMPUTED}:{name}" for name in (
        "speed_m_s", "speed_odometer_m_s", "speed_carrier_m_s", "speed_truth_m_s", "error_horizontal_m",
        "error_vertical_m", "horizontal_sd_m", "vertical_sd_m", "heading_sd_rad", "satellites_used",
        "satellites_in_view",
        *(f"cn0_{name}_db_hz" for name in _CONSTELLATIONS),
    )),
    *(f"gnss/fix:{name}" for name in (
        "ground_speed_m_s", "height_ellipsoid_m", "hdop", "vdop", "pdop", "correction_age_s",
    )),
    *(f"navigation/solution:{name}" for name in (
        "height_ellipsoid_m", "protection_level_horizontal_m", "protection_level_vertical_m", "gnss_age_s",
        *(f"{bias}.{axis}" for bias in (
            "accelerometer_bias_m_s2", "gyroscope_bias_rad_s", "gyroscope_bias_sd_rad_s",
        ) for axis in range(3)),
    )),
    "truth/state:height_ellipsoid_m",
    "trust/state:alert_limit_horizontal_m",
    "trust/state:alert_limit_vertical_m",
    *(f"navigation/aiding[{kind}]:test_ratio" for kind in AidingKind),
    *(f"{topic}:{LATENCY}" for topic in _LATENCIES),
)  # fmt: skip


@answer()
class Columns(TypedDict):
    """Values of fields, a column each on one grid."""

    period_s: float
    time_ns: list[Stamp]
    values: dict[str, list[float | None]]
    """by field; null where nothing was published"""


@answer()
class FieldLabel(TypedDict):
    """How a field is plotted."""

    unit: str
    axis: str


@answer({
    "period_s": 1.0, "time_ns": [1_795_380_196_007_361_076], "values": {"gnss/fix:hdop": [0.8]},
    "fields": {"gnss/fix:hdop": {"unit": "", "axis": ""}},
})  # fmt: skip
class LabelledColumns(Columns):
    """Numeric fields over time, a column each on one grid."""

    fields: dict[str, FieldLabel]
    """unit and axis of each field"""


class SeriesFull(Exception):
    """No further field can be kept."""


class FieldHistory:
    """One field and its last minute and hour."""

    def __init__(self, field: Field) -> None:
        self.field = field
        self.asked_ns = 0
        self.rings = (Ring(FINE_NS, FINE_CELLS), Ring(COARSE_NS, COARSE_CELLS))

    @property
    def has_gaps(self) -> bool:
        """Whether nothing was taken while nobody asked."""
        topic = BY_NAME.get(self.field.topic)
        return topic is not None and on_demand(topic) and self.field.path != (LATENCY,)

    def put(self, time_ns: int, value: float, *, fill: bool = False) -> None:
        """Note a value."""
        for ring in self.rings:
            ring.put(time_ns, value, fill=fill)


class Series:
    """Takes messages as they come and keeps the fields that are wanted; a bounded number of them."""

    def __init__(self, standard: Iterable[str] = STANDARD) -> None:
        self.fillings = 0  # times that the past of fields was read
        self.refused = 0  # questions for a field that could not be kept
        self.wanted: list[str] = []  # fields that were asked for since their past was last read from a recording
        self._kept: dict[str, FieldHistory] = {}
        self._by_topic: dict[str, list[FieldHistory]] = {}
        self._computed = computed.DerivedSeries()
        self._standard = tuple(standard)
        for name in self._standard:
            self._add(fields.parse(name))

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def bytes(self) -> int:
        """Memory of all values."""
        return len(self._kept) * BYTES_PER_FIELD

    def want(self, names: Sequence[str], now_ns: int) -> None:
        """Keep these fields from now on.

        Raises ValueError for a name that cannot be one, and SeriesFull if there is no room.
        """
        for field in [fields.parse(name) for name in names]:
            if field.name not in self._kept:
                self._make_room(now_ns)
                self._add(field)
            kept = self._kept[field.name]
            if kept.asked_ns and now_ns - kept.asked_ns >= LOOKED_AT_NS and kept.has_gaps:
                self.wanted.append(field.name)
            kept.asked_ns = now_ns

    def looked_at(self, now_ns: int) -> set[str]:
        """Name the topics of the fields that somebody asked for lately."""
        since_ns = max(now_ns - LOOKED_AT_NS, 0)
        return {kept.field.topic for kept in self._kept.values() if kept.asked_ns > since_ns}

    def take_latency(self, topic: str, latency_s: float, received_ns: int) -> None:
        """Note the latency of a topic that is not followed."""
        for kept in self._by_topic.get(topic, ()):
            if kept.field.path == (LATENCY,):
                kept.put(received_ns, latency_s)

    def take(self, topic: str, message: Message, received_ns: int, *, fill: bool = False) -> None:
        """Note the values of one message; `fill` puts them only where none is."""
        stamp = stamp_ns(message)
        latency_s = None if stamp is None else (received_ns - stamp) * 1e-9
        known = latency_s is not None and abs(latency_s) < LATENCY_MAXIMUM_S
        time_ns = stamp if known and stamp is not None else received_ns
        for kept in self._by_topic.get(topic, ()):
            field = kept.field
            if field.selector is not None and field.selector != fields.selector_of(message):
                continue
            latency = field.path == (LATENCY,)
            value = (latency_s if known else None) if latency else fields.value_at(message, field.path)
            if value is not None:
                kept.put(time_ns, value, fill=fill)
        for name, value in self._computed.of(message):
            if kept_one := self._kept.get(f"{COMPUTED}:{name}"):
                kept_one.put(time_ns, value, fill=fill)

    def columns(self, names: Sequence[str], from_ns: int, to_ns: int, *, fine: bool) -> Columns:
        """Give the values of kept fields in a span of time, a column each on the same grid; KeyError for another."""
        period_ns = FINE_NS if fine else COARSE_NS
        first, last = from_ns // period_ns, to_ns // period_ns
        return {
            "period_s": period_ns * 1e-9,
            "time_ns": [period * period_ns for period in range(first, last + 1)],
            "values": {name: self._kept[name].rings[0 if fine else 1].values(first, last) for name in names},
        }

    def fill(self, name: str, values: Sequence[float | None], to_ns: int) -> None:
        """Put values, one a second up to a time, where none is; a field that is not kept any more is ignored."""
        if (kept := self._kept.get(name)) is None:
            return
        last = to_ns // SECOND_NS
        for period, value in enumerate(values, last - len(values) + 1):
            if value is not None:
                kept.rings[1].put(period * SECOND_NS, value, fill=True)

    def take_wanted(self) -> list[str]:
        """Fields whose past is to be read, since the last call."""
        wanted, self.wanted = self.wanted, []
        return [name for name in wanted if name in self._kept]

    def _make_room(self, now_ns: int) -> None:
        """Give up the field that nobody has asked for the longest; those of the page Charts stay."""
        if len(self._kept) < FIELDS_MAXIMUM:
            return
        candidates = [kept for name, kept in self._kept.items() if name not in self._standard]
        oldest = min(candidates, key=lambda kept: kept.asked_ns, default=None)
        if oldest is None or now_ns - oldest.asked_ns < KEEP_ASKED_NS:
            self.refused += 1
            raise SeriesFull(
                f"{FIELDS_MAXIMUM} fields are kept already, and each was asked for within the last hour; "
                "close charts that are not needed, and try again later"
            )
        del self._kept[oldest.field.name]
        self._by_topic[oldest.field.topic].remove(oldest)

    def _add(self, field: Field) -> None:
        kept = self._kept[field.name] = FieldHistory(field)
        if field.topic != COMPUTED:
            self._by_topic.setdefault(field.topic, []).append(kept)
        self.wanted.append(field.name)


def labelled(names: Sequence[str], series: Columns) -> LabelledColumns:
    """Add unit and axis of each field to its values, and round these to what a plot shows."""
    columns = series["values"]
    return {**series, "fields": {name: _described(fields.parse(name)) for name in names},
            "values": {name: [_rounded(v) for v in columns[name]] for name in names}}  # fmt: skip


def _described(field: Field) -> FieldLabel:
    return {"unit": fields.unit_of(field), "axis": fields.axis_of(field)}


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.10g}")
