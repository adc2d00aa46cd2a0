"""What neighbours publish, and when their range-rate can be used."""

from dataclasses import dataclass
from math import isfinite

from shared.maths.rotation import Vector

from .range_rate import CARRIER_FREQUENCY, MAX_OFFSET

MAX_DISTANCE = 2000.0  # [m] more than the range of ITS-G5
MAX_SPEED = 100.0  # [m/s]


@dataclass(frozen=True)
class NeighbourReport:
    """State that a neighbour published, and the carrier frequency offset of the message that carried it."""

    name: str
    position_e: Vector  # [m, ECEF]
    velocity_e: Vector  # [m/s, ECEF]
    position_sd_m: float
    velocity_sd_m_s: float
    cfo_hz: float | None = None
    oscillator_offset: float | None = None  # [-] fractional frequency offset of its transmitter
    cfo_sd_hz: float = 20.0


def unusable(report: NeighbourReport, distance: float, speed: float) -> str | None:
    """Why a neighbour's range-rate is not used; None where it is."""
    if report.cfo_hz is None or not isfinite(report.cfo_hz):
        return "neighbour_without_cfo"
    if report.oscillator_offset is None or not abs(report.oscillator_offset) <= MAX_OFFSET:
        return "neighbour_without_oscillator_offset"
    if abs(report.cfo_hz) > 2.0 * MAX_OFFSET * CARRIER_FREQUENCY:
        return "implausible_cfo"
    if not distance <= MAX_DISTANCE or not speed <= MAX_SPEED:
        return "implausible_neighbour"
    sds = (report.position_sd_m, report.velocity_sd_m_s, report.cfo_sd_hz)
    return None if all(isfinite(sd) and sd > 0.0 for sd in sds) else "neighbour_without_accuracy"
