"""Series that no message has as a field: errors against the truth, standard deviations, speeds, mean C/N0; pure."""

from collections import defaultdict
from collections.abc import Iterator
from math import hypot
from statistics import fmean

from shared.messages.base import Message
from shared.messages.gnss import CarrierDisplacement, GnssSatellites
from shared.messages.navigation import NavigationSolution, TruthState
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

from ..views.geometry import horizontal_sd, offset_m, vertical_sd

COMPARABLE_NS = 1_000_000_000  # between the stamps of a solution and of the truth
SOURCES = (
    "navigation/solution", "truth/state", "gnss/satellites", "gnss/carrier_displacement", "vehicle/wheel_speed",
    "vehicle/speed",
)  # fmt: skip
_WHEELS = ("front_left_m_s", "front_right_m_s", "rear_left_m_s", "rear_right_m_s")


class DerivedSeries:
    """Derives values from a message and the newest truth."""

    def __init__(self) -> None:
        self._truth: TruthState | None = None

    def of(self, message: Message) -> Iterator[tuple[str, float]]:
        """Yield what follows from one message: name without topic, and value."""
        match message:
            case NavigationSolution():
                yield "speed_m_s", hypot(*message.velocity_ned_m_s[:2])
                yield "horizontal_sd_m", horizontal_sd(message.position_cov_ned_m2)
                yield "vertical_sd_m", vertical_sd(message.position_cov_ned_m2)
                yield "heading_sd_rad", vertical_sd(message.attitude_cov_ned_rad2)
                yield from self._errors(message)
            case CarrierDisplacement() if message.sampled_ns > message.since_ns:
                way_m = hypot(*message.displacement_ned_m[:2])
                yield "speed_carrier_m_s", way_m / ((message.sampled_ns - message.since_ns) * 1e-9)
            case TruthState():
                self._truth = message
                if message.velocity_ned_m_s is not None:
                    yield "speed_truth_m_s", hypot(*message.velocity_ned_m_s[:2])
            case GnssSatellites():
                yield from _satellites(message)
            case WheelSpeeds():
                speeds = [v for name in _WHEELS if (v := getattr(message, name, None)) is not None]
                if speeds:
                    yield "speed_odometer_m_s", fmean(speeds)
            case VehicleSpeed():
                yield "speed_odometer_m_s", message.speed_m_s
            case _:
                return

    def _errors(self, solution: NavigationSolution) -> Iterator[tuple[str, float]]:
        """Compare with the truth, which is moved by its velocity to the moment of the solution."""
        truth = self._truth
        if truth is None or abs(solution.sampled_ns - truth.sampled_ns) > COMPARABLE_NS:
            return
        if offset := offset_m(solution, truth):
            yield "error_horizontal_m", hypot(*offset)
        fall_m_s = truth.velocity_ned_m_s[2] if truth.velocity_ned_m_s else 0.0
        fall_m = fall_m_s * (solution.sampled_ns - truth.sampled_ns) * 1e-9
        yield "error_vertical_m", abs(solution.height_ellipsoid_m - truth.height_ellipsoid_m + fall_m)


def _satellites(message: GnssSatellites) -> Iterator[tuple[str, float]]:
    """Mean C/N0 of the satellites that are used, by constellation; how many there are."""
    ratios: dict[str, list[float]] = defaultdict(list)
    for satellite in message.satellites:
        if satellite.used and satellite.cn0_db_hz is not None:
            ratios[satellite.constellation].append(satellite.cn0_db_hz)
    for constellation, values in ratios.items():
        yield f"cn0_{constellation}_db_hz", fmean(values)
    yield "satellites_used", float(sum(satellite.used for satellite in message.satellites))
    yield "satellites_in_view", float(len(message.satellites))
