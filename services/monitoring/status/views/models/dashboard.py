"""The state that the dashboard follows over `/ws`: stamps instead of ages. `/api/state` answers with the same."""

from typing import Literal, NotRequired

from typing_extensions import TypedDict

from shared.messages.operation import OriginKind, ProcessStatus
from shared.page.answers import Object, Stamp, answer

from ...history.columns import Change
from ..banner import Kind, Trust
from .simulation import SimulationShown
from .toll import Plaza
from .trust import TrustShown
from .unit import OutageRow, ProblemRow, Topic, Traffic


@answer()
class TopicContract(TypedDict):
    """What is constant of a topic."""

    type: str
    purpose: str
    producers: tuple[str, ...]
    consumers: tuple[str, ...]
    rate_hz: float | None
    late_after_s: float | None
    stale_after_s: float | None
    qos: int
    retain: bool


@answer()
class ProcessContract(TypedDict):
    """What is constant of a process."""

    layer: int
    purpose: str
    observes_all: bool


@answer()
class Contract(TypedDict):
    """The constant part of the page System."""

    layers: tuple[str, ...]
    processes: dict[str, ProcessContract]
    topics: dict[str, TopicContract]


@answer()
class LineShown(TypedDict):
    """What the banner says, in one language."""

    sentence: str
    action: str


@answer()
class CheckShown(TypedDict):
    """One line of the list behind the verdict."""

    name: str
    label: str
    state: Trust
    text: str
    ratio: float | None
    """statistic over limit"""
    link: str
    """page of the dashboard"""
    kind: Kind


@answer()
class Banner(TypedDict):
    """The verdict, since when, and the checks behind it."""

    state: Trust
    word: str
    sentence: str
    action: str
    languages: dict[str, LineShown]
    reasons: list[str]
    since_ns: Stamp | None
    row: int | None
    checks: list[CheckShown]


@answer()
class OriginShown(TypedDict):
    """Where the data come from."""

    kind: OriginKind
    name: str
    seed: int | None
    speed: float


@answer()
class BrokerLink(TypedDict):
    """Whether the broker works."""

    ok: bool
    text: str


@answer()
class Link(TypedDict):
    """How much of a link of the chain works."""

    ok: bool | None
    """null: not known"""
    up: int
    of: int
    worst: str | None


@answer()
class Chain(TypedDict):
    """The links behind the server."""

    broker: BrokerLink
    services: Link
    sensors: Link


@answer()
class EllipseShown(TypedDict):
    """95 % error ellipse."""

    semi_major_m: float
    semi_minor_m: float
    orientation_rad: float
    """of the major axis, from true north, clockwise"""


@answer()
class SolutionShown(TypedDict):
    """The newest solution."""

    updated_ns: Stamp | None
    sampled_ns: Stamp
    phase: str
    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    height_msl_m: float
    """above mean sea level"""
    geoid: Literal["receiver", "grid"]
    geoid_sd_m: float | None
    height_sd_m: float
    speed_m_s: float
    speed_sd_m_s: float
    heading_rad: float
    heading_sd_rad: float
    stationary: bool
    gnss_age_s: float | None
    protection_level_horizontal_m: float | None
    protection_level_vertical_m: float | None
    integrity_risk: float | None
    ellipse: EllipseShown


@answer()
class SatelliteCount(TypedDict):
    """How many satellites are received and used."""

    in_view: int
    used: int
    updated_ns: Stamp | None


@answer()
class OdometerShown(TypedDict):
    """Speed of the wheels."""

    speed_m_s: float
    topic: str
    updated_ns: Stamp | None


@answer()
class TruthShown(TypedDict):
    """Truth of a simulation, and the error of the solution."""

    updated_ns: Stamp | None
    latitude_deg: float
    longitude_deg: float
    speed_m_s: float | None
    error_north_m: float | None
    error_east_m: float | None


@answer()
class ProcessShown(TypedDict):
    """One process: state, load, and latency of what it sends most often."""

    status: ProcessStatus
    heartbeat_ns: Stamp | None
    since_ns: Stamp | None
    restarts: int
    in_hz: float | None
    out_hz: float | None
    latency_of: str | None
    latency_p50_s: float | None
    latency_p99_s: float | None
    cpu_share: float | None
    memory_bytes: int | None
    dropped: int
    rejects: dict[str, int]
    reject_names: dict[str, str]
    """what each kind of reject means"""
    kinds: list[Object]
    reconnections: int
    last_error: str | None


@answer()
class BusLoad(TypedDict):
    """Load of the bus, and of all processes."""

    messages_hz: float
    delay_p95_s: float | None
    cpu_share: float
    memory_bytes: int


@answer()
class TopicShown(Traffic):
    """How a topic flows."""

    earlier: NotRequired[bool]
    """the newest message is from before a restart of its producer"""


@answer()
class State(TypedDict):
    """All that the dashboard shows but its topics."""

    now_ns: Stamp
    vehicle: str
    toll: Plaza | None
    """of a road-side unit"""
    started_ns: Stamp
    origin: OriginShown | None
    banner: Banner
    trust: TrustShown
    timeline: list[Change]
    chain: Chain
    solution: SolutionShown | None
    fix: Object | None
    satellites: SatelliteCount | None
    odometer: OdometerShown | None
    truth: TruthShown | None
    simulation: SimulationShown | None
    navigation: Object | None
    set_up: Object | None
    mode: Object | None
    crossing: Object | None
    tachograph: Object | None
    recording: Object | None
    uplink: Object | None
    processes: dict[str, ProcessShown]
    problems: list[ProblemRow]
    outages: list[OutageRow]
    bus: BusLoad


@answer()
class Dashboard(State):
    """All that the dashboard shows."""

    topics: dict[str, TopicShown]


@answer()
class DashboardState(State):
    """All that the dashboard shows, and the newest message of every topic."""

    topics: dict[str, Topic]
