"""The toll plaza: everything in metres north and east of the antenna."""

from typing_extensions import TypedDict

from shared.messages.toll import GateMode
from shared.page.answers import Object, Stamp, answer

Plane = tuple[float, float]  # metres north and east


@answer()
class LaneShown(TypedDict):
    """One lane."""

    lane: str
    direction: str
    mode: GateMode
    detector: bool
    """it counts the lane's vehicles"""
    width_m: float
    centre: list[Plane]
    approach: list[Plane]
    gate: list[Plane]
    exit: list[Plane]


@answer()
class PlazaShown(TypedDict):
    """The plaza itself."""

    name: str
    digest: str
    lanes: list[LaneShown]


@answer()
class AuthenticationShown(TypedDict):
    """How far the sender of CAM is known."""

    authentication: str
    verified: bool
    """whether signature and chain hold, and nothing is left unchecked"""
    languages: dict[str, str]
    """the same in languages other than English"""


@answer()
class TrackShown(AuthenticationShown):
    """One vehicle before the plaza."""

    track: int
    at: Plane
    heading_rad: float
    speed_m_s: float
    ellipse: tuple[float, float, float]
    """semi-axes [m] and azimuth of the major one [rad]"""
    lanes: dict[str, float]
    """probability of each lane"""
    lane: str | None
    delta: bool
    registered: bool
    passage: str | None
    age_s: float


@answer()
class Plaza(TypedDict):
    """The plaza, its vehicles and its charges."""

    plaza: PlazaShown | None
    delta: Object | None
    tracks: list[TrackShown]
    tracks_ns: Stamp | None
    cams: int
    cam_rejects: int
    cam_batches_hz: float
    trust: str | None
    gates: dict[str, Object]
    pulses: dict[str, Stamp]
    ledger: Object | None
