"""Encodes the frames of the simulated vehicle's CAN bus as lines of a candump log.

Wheel speeds follow deploy/vehicles/simulated.dbc; OBD-II follows SAE J1979 over ISO 15765-4.
"""

import struct
from math import floor, hypot

WHEEL_SPEEDS_ID = 0x0F1
REQUEST_ID, RESPONSE_ID = 0x7DF, 0x7E8
KM_H = 1.0 / 3.6  # [m/s]
WHEEL_RESOLUTION = 0.01 * KM_H  # [m/s]
TRACK_M, WHEELBASE_M = 1.52, 2.62
_WHEELS = struct.Struct("<4H")
_REQUEST = bytes((2, 0x01, 0x0D, 0x55, 0x55, 0x55, 0x55, 0x55))

Wheels = tuple[float, float, float, float]


def line(time_ns: int, identifier: int, data: bytes) -> bytes:
    """One line of `candump -L`; its time stamp is truncated to microseconds."""
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return f"({seconds}.{rest // 1000:06d}) can0 {identifier:03X}#{data.hex().upper()}\n".encode()


def speed_request() -> bytes:
    """Encode a request of the vehicle speed: mode 01, PID 0D."""
    return _REQUEST


def speed_response(speed: float) -> bytes:
    """Encode a response with a speed [m/s], rounded half up to whole km/h."""
    return bytes((3, 0x41, 0x0D, min(255, floor(speed / KM_H + 0.5)), 0xAA, 0xAA, 0xAA, 0xAA))


def wheel_frame(wheels: Wheels) -> bytes:
    """Encode the wheel speeds [m/s] front left, front right, rear left, rear right."""
    return _WHEELS.pack(*(min(0xFFFF, max(0, round(speed / WHEEL_RESOLUTION))) for speed in wheels))


def wheel_speeds(speed: float, yaw_rate: float) -> Wheels:
    """Speeds of the four wheels of a vehicle whose rear axle has no sideslip.

    Parameters
    ----------
    speed : float
        [m/s] Speed of the centre of the rear axle.
    yaw_rate : float
        [rad/s] Positive clockwise, seen from above.

    Returns
    -------
    tuple of float
        [m/s] Front left, front right, rear left, rear right.
    """
    left, right = speed + 0.5 * TRACK_M * yaw_rate, speed - 0.5 * TRACK_M * yaw_rate
    across = WHEELBASE_M * yaw_rate
    return hypot(left, across), hypot(right, across), left, right
