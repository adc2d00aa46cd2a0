"""Health of the unit, its topics, processes and outages."""

from typing import Literal

from typing_extensions import TypedDict

from shared.messages.operation import Freshness, ProcessStatus
from shared.page.answers import Object, Stamp, answer

from ..banner import Trust

EXAMPLE_NS = 1_795_380_196_007_361_076
SENTENCE = (
    "The position can be used: protection levels 3.0 m horizontal and 4.0 m vertical, alert limits 10.0 m and 20.0 m; "
    "no monitor accuses GNSS."
)


@answer()
class Position(TypedDict):
    """What the banner says."""

    state: Trust
    """state of the position: that of core.trust, or why none is known"""
    word: str
    """the state as the dashboard shows it"""
    sentence: str
    """reason, with values and limits"""
    since_ns: Stamp | None
    """begin of the state"""


@answer()
class ProcessRow(TypedDict):
    """One process against its deadline."""

    status: ProcessStatus
    ok: bool
    heartbeat_age_s: float | None


@answer()
class TopicRow(TypedDict):
    """One topic against its deadline."""

    freshness: Freshness
    age_s: float | None
    cause: str | None
    """root cause of its silence"""


@answer()
class ProblemRow(TypedDict):
    """Something that is wrong now."""

    what: str
    """root cause: a process, a topic, or "broker" """
    text: str
    text_code: Object | None
    """which `text` says: a code with its values"""
    since_ns: Stamp | None
    affected: list[str]
    """topics that it silences"""
    languages: dict[str, str]
    """`text` in languages other than English"""


@answer({
    "state": "degraded",
    "now_ns": EXAMPLE_NS,
    "broker": True,
    "position": {"state": "safe", "word": "SAFE", "sentence": SENTENCE, "since_ns": EXAMPLE_NS - 7 * 10**9},
    "problems": [{"what": "sensors.can", "text": "sensors.can is lost", "since_ns": EXAMPLE_NS - 4 * 10**9,
                  "text_code": {"code": "health.lost", "values": {},
                                "subject": {"kind": "process", "name": "sensors.can"}},
                  "affected": ["can/raw"], "languages": {"de": "sensors.can ist ausgefallen"}}],
    "processes": {"core.fusion": {"status": "ready", "ok": True, "heartbeat_age_s": 0.21}},
    "topics": {"can/raw": {"freshness": "stale", "age_s": 4.1, "cause": "sensors.can"}},
})  # fmt: skip
class Health(TypedDict):
    """Every topic and process against its deadline."""

    state: Literal["ok", "degraded", "failed"]
    """failed: the broker is lost; degraded: a problem, or no position that may be used"""
    now_ns: Stamp
    broker: bool
    position: Position
    problems: list[ProblemRow]
    processes: dict[str, ProcessRow]
    topics: dict[str, TopicRow]


@answer()
class Liveness(TypedDict):
    """Whether the unit works at all."""

    alive: bool


@answer()
class OutageRow(TypedDict):
    """One root cause and what it silenced."""

    what: str
    """a process, a topic, or "broker" """
    since_ns: Stamp
    until_ns: Stamp | None
    """null: not over yet"""
    cause: str
    cause_code: Object | None
    """which `cause` says: a code with its values"""
    affected: list[str]
    """topics that it silenced"""
    languages: dict[str, str]
    """`cause` in languages other than English"""


@answer({
    "open": [],
    "closed": [
        {
            "what": "core.fusion", "since_ns": EXAMPLE_NS - 9 * 10**9, "until_ns": EXAMPLE_NS - 6 * 10**9,
            "cause": "core.fusion was lost: it crashed, was killed or lost its connection",
            "cause_code": {"code": "health.lost", "values": {}, "subject": {"kind": "process", "name": "core.fusion"}},
            "languages": {},
            "affected": ["navigation/solution", "navigation/state"],
        }
    ],
})  # fmt: skip
class Outages(TypedDict):
    """Outages by root cause."""

    open: list[OutageRow]
    closed: list[OutageRow]


@answer()
class Traffic(TypedDict):
    """How a topic flows."""

    updated_ns: Stamp | None
    rate_hz: float
    latency_p50_s: float | None
    latency_p99_s: float | None


@answer()
class Topic(Traffic):
    """One topic: its newest message, rate, jitter, size and age."""

    topic: str
    type: str
    purpose: str
    producer: str | None
    freshness: Freshness
    age_s: float | None
    jitter_s: float | None
    bytes: int | None
    sequence: int | None
    retained: bool
    qos: int
    unreadable: str | None
    """why the newest message cannot be decoded"""
    message: Object | None


@answer({"connected": 2, "events": 0, "maximum": 100})
class Viewers(TypedDict):
    """Clients that watch now, and how many may."""

    connected: int
    """dashboards, and other readers of /ws"""
    events: int
    """readers of /api/events"""
    maximum: int
    """of each kind"""
