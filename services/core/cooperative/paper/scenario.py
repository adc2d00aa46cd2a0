"""The scenario of the reference numbers: road, drive, neighbours, satellites, and faults.

The paper does not publish its geometry; road, neighbours and the split of satellites are assumptions that were chosen
so that the published table can come about.
"""

from math import cos, radians, sin

import numpy as np

from ..measurements import FloatArray
from ..v2x.road import Road
from ..v2x.virtual import design_row

EPOCHS = 90  # at 1 Hz
SATELLITES = ("B1", "F4", "F3", "C3")  # slots of the nominal GPS constellation
REAL_DEG = ((57.464, 44.111), (53.456, 243.951), (39.793, 295.880), (32.547, 197.926))  # elevation, azimuth
VIRTUAL_DEG = ((65.217, 161.308), (19.421, 117.549), (13.784, 60.488), (13.613, 305.235))  # C2, A2, D3, A4
RAMP, STEP = 0, 3  # rows of the satellites with a fault
RAMP_FROM, STEP_FROM, STEP_TO, STEP_M = 31, 51, 80, 50.0
# Epochs before the faults, with the ramp alone, with both, and with the ramp alone again.
PHASES = {"1-30 s": slice(0, 30), "31-50 s": slice(30, 50), "51-80 s": slice(50, 80), "81-90 s": slice(80, 90)}
PSEUDORANGE_SD = 3.0  # [m]
RATE_SD = 6.5  # [m/s] of a range-rate, for a ratio of 1
NEIGHBOUR_SD = 1.0  # [m] of a neighbour's published position

FIRST_STRAIGHT, ARC_END, RADIUS, AZIMUTH = 350.0, 550.0, 300.0, radians(60.0)
SPEED_AT_S = (0.0, 9.0, 35.0, 42.0, 50.0, 58.0, 78.0, 90.0)
SPEED_M_S = (5.0, 13.9, 13.9, 8.0, 8.0, 13.0, 13.0, 3.0)
LANE = 3.5  # [m]
ONCOMING_AT_M = (657.0, 1321.0)  # arc lengths at t = 0: not published, fitted to the reference numbers
PARKED_AT_M = 250.0


def real_rows() -> FloatArray:
    """H_r, shape (4, 4)."""
    return np.array([design_row(radians(elevation), radians(azimuth)) for elevation, azimuth in REAL_DEG])


def virtual_rows() -> FloatArray:
    """H_v, shape (4, 4)."""
    return np.array([design_row(radians(elevation), radians(azimuth)) for elevation, azimuth in VIRTUAL_DEG])


def faults() -> FloatArray:
    """Error of each real satellite's pseudorange [m], shape (90, 4): a ramp of 1 m/s and a step."""
    k = np.arange(1, EPOCHS + 1)
    found = np.zeros((EPOCHS, len(SATELLITES)))
    found[:, RAMP] = np.where(k >= RAMP_FROM, k - RAMP_FROM + 1.0, 0.0)
    found[:, STEP] = np.where((k >= STEP_FROM) & (k <= STEP_TO), STEP_M, 0.0)
    return found


def along_road(s: float, offset: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Point [m, NED] at arc length s [m] of the centre line and offset [m] to the right, and its derivative by s."""
    turn = min(max(s - FIRST_STRAIGHT, 0.0), ARC_END - FIRST_STRAIGHT) / RADIUS  # to the left
    before, behind = min(s, FIRST_STRAIGHT), max(s - ARC_END, 0.0)
    heading = AZIMUTH - turn
    along = np.array([cos(heading), sin(heading), 0.0])
    start = np.array([cos(AZIMUTH), sin(AZIMUTH), 0.0])
    left = np.array([sin(AZIMUTH), -cos(AZIMUTH), 0.0])
    right = np.array([-along[1], along[0], 0.0])
    arc = RADIUS * (sin(turn) * start + (1.0 - cos(turn)) * left)
    longer = 1.0 + offset / RADIUS if FIRST_STRAIGHT < s < ARC_END else 1.0
    return before * start + arc + behind * along + offset * right, longer * along


def road() -> Road:
    """The centre line; chords of the arc are off by 4 cm at most."""
    stations = [-1000.0, *np.linspace(FIRST_STRAIGHT, ARC_END, 21).tolist(), 3000.0]
    return Road(np.array([along_road(s)[0] for s in stations]))


def speed(t: float) -> float:
    """Speed of the vehicle [m/s] at a time [s]."""
    return float(np.interp(t, SPEED_AT_S, SPEED_M_S))


def distance(t: float) -> float:
    """Arc length [m] that the vehicle has driven; the speed is linear between its nodes."""
    nodes = np.array([*[node for node in SPEED_AT_S if node < t], t])
    speeds = np.interp(nodes, SPEED_AT_S, SPEED_M_S)
    return float(((speeds[1:] + speeds[:-1]) / 2.0 * np.diff(nodes)).sum())


def vehicle(t: float) -> tuple[FloatArray, FloatArray]:
    """Position [m, NED] and velocity [m/s, NED] of the vehicle."""
    position, along = along_road(distance(t))
    return position, speed(t) * along


def neighbours(t: float) -> tuple[FloatArray, FloatArray]:
    """Positions [m, NED] and velocities [m/s, NED] of the six neighbours, shapes (6, 3).

    Two in the lane, ahead and behind, that sway by ±4 m; one in the adjacent lane; two oncoming; one parked.
    """
    s, v = distance(t), speed(t)
    rate = 2.0 * np.pi / 30.0
    sway, sway_rate = 4.0 * sin(rate * t), 4.0 * rate * cos(rate * t)
    cars = (
        (s + 28.0 + sway, 0.0, v + sway_rate),
        (s - 22.0 - sway, 0.0, v - sway_rate),
        (s + 15.0, LANE, v),
        (ONCOMING_AT_M[0] - 11.0 * t, -LANE, -11.0),
        (ONCOMING_AT_M[1] - 11.0 * t, -LANE, -11.0),
        (PARKED_AT_M, 60.0, 0.0),
    )
    found = [(*along_road(station, offset), rate) for station, offset, rate in cars]
    positions = np.array([position for position, _, _ in found])
    velocities = np.array([rate * along for _, along, rate in found])
    return positions, velocities
