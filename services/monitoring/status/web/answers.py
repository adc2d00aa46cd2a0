"""What the API answers, as models: they are the schemas of /openapi.json, and tests hold every answer to them."""

from typing import Literal

from pydantic import ConfigDict, Field

from shared.messages.operation import Freshness, Outage, ProcessStatus
from shared.messages.trust import Hypothesis
from shared.page.answers import Answer, Object, Stamp

from ..views.banner import Trust

EXAMPLE_NS = 1_795_380_196_007_361_076
SENTENCE = (
    "The position can be used: protection levels 3.0 m horizontal and 4.0 m vertical, alert limits 10.0 m and 20.0 m; "
    "no monitor accuses GNSS."
)


class Position(Answer):
    """What the banner says."""

    state: Trust
    """state of the position: that of core.trust, or why none is known"""
    word: str
    """the state as the dashboard shows it"""
    sentence: str
    """reason, with values and limits"""
    since_ns: Stamp | None
    """begin of the state"""


class ProcessRow(Answer):
    """One process against its deadline."""

    status: ProcessStatus
    ok: bool
    heartbeat_age_s: float | None


class TopicRow(Answer):
    """One topic against its deadline."""

    freshness: Freshness
    age_s: float | None
    cause: str | None
    """root cause of its silence"""


class ProblemRow(Answer):
    """Something that is wrong now."""

    what: str
    """root cause: a process, a topic, or "broker" """
    text: str
    since_ns: Stamp | None
    affected: list[str]
    """topics that it silences"""


class Health(Answer):
    """Every topic and process against its deadline."""

    state: Literal["ok", "degraded", "failed"]
    """failed: the broker is lost; degraded: a problem, or no position that may be used"""
    now_ns: Stamp
    broker: bool
    position: Position
    problems: list[ProblemRow]
    processes: dict[str, ProcessRow]
    topics: dict[str, TopicRow]


class Alive(Answer):
    """Whether the unit works at all."""

    alive: bool


class LoginState(Answer):
    """Who asks."""

    name: str | None
    """of the token; "local" where no login is needed; null: not logged in"""
    role: Literal["view", "operate", "admin"] | None
    session: bool
    """whether there is a session, which can be ended"""
    csrf: str | None
    """value of the header X-OBU-CSRF that each change needs; null with a token in the header Authorization"""


class TokenRow(Answer):
    """One token, without its text."""

    name: str
    role: Literal["view", "operate", "admin"]
    created_s: float
    """since 1970"""
    expires_s: float | None
    """since 1970; null: never"""
    single_use: bool
    """of a link, which logs in once"""


class SessionRow(Answer):
    """One open login."""

    token: str
    """name of the token, which may have been used up"""
    role: Literal["view", "operate", "admin"]
    created_s: float
    expires_s: float


class TokenList(Answer):
    """Who may log in, and who has."""

    tokens: list[TokenRow]
    sessions: list[SessionRow]


class MadeToken(Answer):
    """A new token; null after a revocation."""

    token: str | None


class Solution(Answer):
    """The newest position with its uncertainty and the verdict on it; what is not known is null."""

    state: Trust
    """state of the position: that of core.trust, or why none is known"""
    sentence: str
    verdict_known: bool
    """whether there is a verdict of core.trust within its deadline"""
    live: bool
    """whether the solution is within its deadline of 2 s, and newer than the last start of core.fusion"""
    age_s: float | None
    sampled_ns: Stamp | None
    latitude_deg: float | None = Field(ge=-90, le=90)
    longitude_deg: float | None = Field(ge=-180, le=180)
    height_ellipsoid_m: float | None
    speed_m_s: float | None
    heading_deg: float | None
    """from true north, clockwise"""
    ellipse_95_semi_major_m: float | None
    ellipse_95_semi_minor_m: float | None
    ellipse_95_orientation_deg: float | None
    """of the major axis, from true north, clockwise"""
    height_sd_m: float | None
    speed_sd_m_s: float | None
    heading_sd_deg: float | None
    protection_level_horizontal_m: float | None
    protection_level_vertical_m: float | None
    alert_limit_horizontal_m: float | None
    alert_limit_vertical_m: float | None
    gnss_age_s: float | None
    """since the last GNSS fix that was used"""
    phase: str | None
    stationary: bool | None


class Properties(Answer):
    """Solution without the three coordinates."""

    model_config = ConfigDict(extra="allow")
    state: Trust
    sentence: str
    verdict_known: bool
    live: bool


class Point(Answer):
    """Longitude, latitude [deg] and height above the ellipsoid [m] in WGS 84."""

    type: Literal["Point"]
    coordinates: tuple[float, float, float]


class Feature(Answer):
    """GeoJSON (RFC 7946); without any solution the geometry is null."""

    type: Literal["Feature"]
    geometry: Point | None
    properties: Properties


class History(Answer):
    """Columns of one length; a value that was stale is null."""

    time_ns: list[Stamp]
    fields: dict[str, list[float | None]]


class Change(Answer):
    """Begin of a state."""

    since_ns: Stamp
    state: str


class TrustHistory(Answer):
    """Changes of the state; once a second each monitor's statistic over its threshold, and probabilities."""

    changes: list[Change]
    time_ns: list[Stamp]
    ratios: dict[str, list[float | None]]
    probabilities: dict[str, list[float | None]]
    """of each hypothesis"""


class TrustReport(Answer):
    """The verdict with its reasons and every monitor."""

    state: Trust
    sentence: str
    verdict: Object | None
    """`trust/state` without its monitors"""
    monitors: dict[str, Object]
    hypotheses: dict[str, Object]
    """what may be wrong: beliefs of core.trust, and the solutions behind them"""
    events: list[Object]
    """changes of the verdict, newest first"""
    history: TrustHistory


class AlternativeTrack(Answer):
    """Positions under one hypothesis, unbroken."""

    hypothesis: Hypothesis
    label: str
    """as the map shows it"""
    source: str
    """process that publishes them"""
    left_out: list[str]
    """sources or satellites that they are without"""
    until_ns: Stamp
    places: list[tuple[float, float]]
    """longitude and latitude [deg], oldest first"""


class HypothesesReport(Answer):
    """What may be wrong, and the positions that follow."""

    now_ns: Stamp
    hypotheses: dict[str, Object]
    satellites: list[Object]
    """solutions without one satellite or one constellation, the largest separation first"""
    tracks: list[AlternativeTrack]
    """of the last two minutes"""


class Outages(Answer):
    """Outages by root cause."""

    open: list[Outage]
    closed: list[Outage]


class Topic(Answer):
    """One topic: its newest message, rate, jitter, size and age."""

    topic: str
    type: str
    purpose: str
    producer: str | None
    freshness: Freshness
    age_s: float | None
    updated_ns: Stamp | None
    rate_hz: float
    latency_p50_s: float | None
    latency_p99_s: float | None
    jitter_s: float | None
    bytes: int | None
    sequence: int | None
    retained: bool
    qos: int
    unreadable: str | None
    """why the newest message cannot be decoded"""
    message: Object | None


class Everything(Answer):
    """All that the dashboard shows, and the newest message of every topic."""

    model_config = ConfigDict(extra="allow")
    now_ns: Stamp
    vehicle: str
    banner: Object
    timeline: list[Change]
    solution: Object | None
    topics: dict[str, Topic]
    processes: dict[str, Object]
    problems: list[ProblemRow]
    outages: list[Outage]


class Viewers(Answer):
    """Clients that watch now, and how many may."""

    connected: int
    """dashboards, and other readers of /ws"""
    events: int
    """readers of /api/events"""
    maximum: int
    """of each kind"""


class Simulation(Answer):
    """Attacks of a simulated vehicle."""

    attacks: list[Object]
    simulation: Object | None


class Replay(Answer):
    """Position, extent, speed and events of a replay; null where none runs."""

    replay: Object | None


class Done(Answer):
    """The action was carried out, or its job was started."""


class Taken(Answer):
    """A command was published; the position follows in the state."""


class Recordings(Answer):
    """The recordings, newest first, what may be done with them, and the job that runs."""

    recordings: list[Object]
    free_bytes: int | None
    allowed: list[str]
    job: Object | None


class Accepted(Answer):
    """A command was published; `simulation/state` answers with this ID."""

    request_id: str


class TrackColumns(Answer):
    """Columns of one length, one row a position; null where a source was silent."""

    time_ns: list[Stamp]
    state: list[Trust]
    """the verdict shown"""
    aided: list[Literal[0, 1]]
    """1: GNSS was part of the solution within the last 3 s"""
    height_ellipsoid_m: list[float | None]
    radius_95_m: list[float | None]
    """semi-major axis of the 95 % error ellipse"""
    level_m: list[float | None]
    """horizontal protection level"""
    fused_latitude_deg: list[float | None]
    fused_longitude_deg: list[float | None]
    gnss_latitude_deg: list[float | None]
    """of the receiver only"""
    gnss_longitude_deg: list[float | None]
    truth_latitude_deg: list[float | None]
    """of the simulator"""
    truth_longitude_deg: list[float | None]


class TrackRows(Answer):
    """The track of this drive, thinned to a bounded number of rows."""

    generation: int
    """changes when rows were removed"""
    complete: bool
    """all rows, not only those after `after_ns`"""
    spacing_m: float
    """distance between rows"""
    length_m: float
    """distance driven, without the spans in which there was no position"""
    started_ns: Stamp | None
    now_ns: Stamp
    columns: TrackColumns


class Series(Answer):
    """Numeric fields over time, a column each on one grid."""

    period_s: float
    time_ns: list[Stamp]
    values: dict[str, list[float | None]]
    """by field; null where nothing was published"""
    fields: dict[str, Object]
    """unit and axis of each field"""


class Fields(Answer):
    """Numeric fields of the newest message of a topic."""

    topic: str
    fields: list[Object]
    """name, path, value, unit and axis of each"""


class Receivers(Answer):
    """The GNSS receivers."""

    now_ns: Stamp
    receivers: list[Object]
    """fix, satellites with the reason why one is not used, signals, settings, bands over time"""


EXAMPLES: dict[type[Answer], Object] = {
    Health: {
        "state": "ok",
        "now_ns": EXAMPLE_NS,
        "broker": True,
        "position": {"state": "safe", "word": "SAFE", "sentence": SENTENCE, "since_ns": EXAMPLE_NS - 7 * 10**9},
        "problems": [],
        "processes": {"core.fusion": {"status": "ready", "ok": True, "heartbeat_age_s": 0.21}},
        "topics": {"gnss/fix": {"freshness": "fresh", "age_s": 0.4, "cause": None}},
    },
    Solution: (
        position := {
            "state": "safe", "sentence": SENTENCE, "verdict_known": True, "live": True, "age_s": 0.03,
            "sampled_ns": EXAMPLE_NS, "latitude_deg": 48.135124, "longitude_deg": 11.582044,
            "height_ellipsoid_m": 519.2, "speed_m_s": 13.9, "heading_deg": 92.4, "ellipse_95_semi_major_m": 1.1,
            "ellipse_95_semi_minor_m": 0.8, "ellipse_95_orientation_deg": 41.0, "height_sd_m": 0.7,
            "speed_sd_m_s": 0.05, "heading_sd_deg": 0.3, "protection_level_horizontal_m": 3.0,
            "protection_level_vertical_m": 4.0, "alert_limit_horizontal_m": 10.0, "alert_limit_vertical_m": 20.0,
            "gnss_age_s": 0.4, "phase": "navigating", "stationary": False,
        }
    ),
    Feature: {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [11.582044, 48.135124, 519.2]},
        "properties": {k: v for k, v in position.items() if k[:5] not in ("latit", "longi") and "ellipsoid" not in k},
    },
    Series: {
        "period_s": 1.0, "time_ns": [EXAMPLE_NS], "values": {"gnss/fix:hdop": [0.8]},
        "fields": {"gnss/fix:hdop": {"unit": "", "axis": ""}},
    },
    Fields: {
        "topic": "gnss/fix",
        "fields": [{"name": "gnss/fix:hdop", "path": "hdop", "value": 0.8, "unit": "", "axis": ""}],
    },
    Receivers: {"now_ns": EXAMPLE_NS, "receivers": []},
    History: {"time_ns": [EXAMPLE_NS], "fields": {"speed_fused_m_s": [13.9], "position_error_m": [None]}},
    Outages: {
        "open": [],
        "closed": [
            {
                "what": "core.fusion", "since_ns": EXAMPLE_NS - 9 * 10**9, "until_ns": EXAMPLE_NS - 6 * 10**9,
                "cause": "core.fusion was lost: it crashed, was killed or lost its connection",
                "affected": ["navigation/solution", "navigation/state"],
            }
        ],
    },
    Viewers: {"connected": 2, "events": 0, "maximum": 100},
    Accepted: {"request_id": "5f0c9a7be2d1"},
}  # fmt: skip
for model, example in EXAMPLES.items():
    model.example = example
