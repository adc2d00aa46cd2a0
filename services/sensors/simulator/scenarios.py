"""Table of the simulated drives."""

from dataclasses import dataclass, field, replace
from math import radians

from shared.maths.earth import Geodetic

from .gnss.gnss_errors import ErrorKind, InjectedError, Vector
from .motion.roads import Course, RoadSegment, bend

L_AQUILA = Geodetic(radians(42.3700), radians(13.3500), 700.0)


@dataclass(frozen=True)
class Scenario:
    """Course, dynamics and GNSS conditions of a drive of `duration_s` by default; its laps repeat without end."""

    name: str
    purpose: str
    course: Course
    duration_s: float = 240.0
    start: Geodetic = L_AQUILA
    standstill_s: tuple[float, float] = (16.0, 20.0)  # duration of the initial standstill
    acceleration_m_s2: float = 1.2
    error: InjectedError = field(default_factory=InjectedError)
    carrier: str = "none"  # best ambiguity state under open sky: none, float, fixed
    constellations: tuple[str, ...] = ("gps", "galileo", "glonass", "beidou")
    mask_deg: float = 10.0  # elevation mask of the surroundings
    loss_db: float = 0.0  # signal attenuation
    hold_s: float = 0.0  # for which the receiver repeats its velocity in a tunnel, and then states zero; 0: no fix


def _round_the_lot() -> Course:
    """Two laps of a rounded rectangle of 70 m by 35 m on a slope of one degree, with a stop every 133 m."""
    speed, slow, stop = (4.5, 7.0), (4.0, 4.5), (5.0, 8.0)
    corner = bend(90.0, 6.0, slow)
    down, up = RoadSegment(20.0, speed, rise_deg=-2.0), RoadSegment(20.0, speed, rise_deg=2.0)
    first = (
        RoadSegment(55.0, speed),
        corner,
        down,
        corner,
        RoadSegment(33.0, speed, stop_s=stop),
        RoadSegment(22.0, speed),
    )
    second = (RoadSegment(55.0, speed), bend(90.0, 6.0, slow, stop), down, corner, RoadSegment(55.0, speed))
    last = bend(90.0, 6.0, slow, stop)
    return Course((*first, corner, up, corner, *second, corner, up, last), heading_deg=30.0, slope_deg=1.0)


def _through_town() -> Course:
    """Four city quarters with traffic lights, hills, two right turns and one left turn each."""
    speed, slow, light = (8.0, 13.5), (4.5, 6.5), (6.0, 30.0)
    right, left = bend(90.0, 10.0, slow), bend(-90.0, 14.0, slow)
    hill = tuple(RoadSegment(40.0, speed, rise_deg=rise) for rise in (2.5, -2.5, -2.5, 2.5))
    quarter = (
        RoadSegment(160.0, speed, stop_s=light, stop_probability=0.6), RoadSegment(60.0, speed), right,
        *hill, RoadSegment(90.0, speed, stop_s=light, stop_probability=0.5), left,
        RoadSegment(120.0, speed), right,
    )  # fmt: skip
    end = replace(right, stop_s=light)
    return Course((*quarter, *quarter, *quarter, *quarter[:-1], end), heading_deg=75.0)


def _motorway() -> Course:
    """Out and back on a motorway: wide bends, a climb and a descent, a toll station at the end."""
    speed = (30.0, 36.0)
    hill = tuple(RoadSegment(350.0, speed, rise_deg=rise) for rise in (1.7, -1.7, -1.7, 1.7))
    half = (
        RoadSegment(1500.0, speed), bend(20.0, 900.0, speed), bend(-40.0, 900.0, speed), bend(20.0, 900.0, speed),
        *hill, RoadSegment(900.0, speed), bend(180.0, 400.0, (24.0, 26.0)),
    )  # fmt: skip
    return Course((*half, *half[:-1], replace(half[-1], stop_s=(6.0, 12.0))), heading_deg=120.0)


def _under_the_hill() -> Course:
    """A country road with a short and a long tunnel in each direction."""
    speed = (19.0, 23.0)
    half = (
        RoadSegment(600.0, speed), bend(30.0, 300.0, speed), RoadSegment(350.0, speed, covered=True),
        bend(-30.0, 300.0, speed), RoadSegment(500.0, speed), RoadSegment(900.0, speed, covered=True),
        RoadSegment(300.0, speed), bend(180.0, 60.0, (10.0, 12.0)),
    )  # fmt: skip
    return Course((*half, *half[:-1], replace(half[-1], stop_s=(6.0, 12.0))), heading_deg=300.0)


LOT, TOWN, MOTORWAY, HILL = _round_the_lot(), _through_town(), _motorway(), _under_the_hill()

# RMSE [m, NED] of the degraded GNSS in the five drives of Zuriarrain Sosa et al., Appl. Sci. 2024, 14, 4401, table 2.
# The paper does not state the time correlation of these errors. A correlation time of 5 s is consistent with its
# results; agreement with the paper is therefore not independent evidence.
DEGRADED_RMSE: tuple[Vector, ...] = (
    (3.07, 1.99, 1.56),
    (3.02, 2.09, 1.50),
    (3.37, 1.70, 1.75),
    (3.38, 1.62, 1.83),
    (3.10, 1.70, 1.88),
)

SCENARIOS = (
    Scenario("parking_lot", "240 s around a car park, with stops, under an open sky", LOT),
    Scenario(
        "urban", "stop and go in a town, with traffic lights, hills, and partly blocked satellites", TOWN, 900.0,
        error=InjectedError(ErrorKind.GAUSS_MARKOV, (0.8, 0.6, 1.2)), carrier="float", mask_deg=25.0, loss_db=6.0,
    ),
    Scenario("highway", "a motorway with RTK corrections", MOTORWAY, 600.0, carrier="fixed"),
    Scenario("tunnel", "a country road with tunnels of 16 s and 43 s", HILL, 600.0),
    Scenario(
        "tunnel-hold", "the same, with a receiver that repeats its speed in a tunnel for 10 s, and then states zero",
        HILL, 600.0, hold_s=10.0,
    ),
    *(
        Scenario(
            f"degraded-{i}", f"the car park with the degraded GNSS of drive {i} of the paper", LOT,
            error=InjectedError(ErrorKind.GAUSS_MARKOV, rmse, exact=True),
            constellations=("gps", "galileo"), mask_deg=20.0,
        )
        for i, rmse in enumerate(DEGRADED_RMSE, 1)
    ),
)  # fmt: skip
BY_NAME = {row.name: row for row in SCENARIOS}
NAMES = (*BY_NAME, "degraded")


def scenario_of(name: str, seed: int = 0) -> Scenario:
    """Find a scenario; `degraded` selects one of its five by the seed. Raises ValueError for an unknown name."""
    if name == "degraded":
        name = f"degraded-{1 + seed % len(DEGRADED_RMSE)}"
    if name not in BY_NAME:
        raise ValueError(f"unknown scenario {name!r}; try one of {', '.join(NAMES)}")
    return BY_NAME[name]


def with_error(scenario: Scenario, error: InjectedError) -> Scenario:
    """Copy a scenario with another position error."""
    return replace(scenario, error=error)
