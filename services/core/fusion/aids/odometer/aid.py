"""Wheel speeds as an aid."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import hypot, tanh
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.compiled import compilable
from shared.messages.navigation import AidingKind
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter
from ...inertial.propagation import MAX_SPEED_M_S
from ...inertial.row import Row
from ...inertial.standstill import norm
from ...settings import Settings
from ...states import LAYOUT
from ..base import Kind, MotionSink, NonInertial, Observation, Sensor
from ..rear_axle import UNKNOWN_ARM_SD, rear_axle_of

FloatArray = npt.NDArray[np.float64]

SCALE = LAYOUT.index("odometer_scale")  # [-]
PERIOD_NS = 95_000_000  # shortest time between two wheel speeds that are used
HALF_TRACK_M = 0.8  # by which a speed may be that of one side
STAMP_SD = 0.02  # [s] of the speed's stamp, because the age of a control unit's value is unknown
DEAD_ZONE_SD = 0.3  # [m/s] of a speed of zero: sensors are silent at a walking pace
SWAY_SD = 0.1  # [m/s] of a body on its springs, sideways and vertically, while the wheels stand


@dataclass(frozen=True)
class WheelSpeed(Kind):
    """Speed [m/s] with its step: of the wheels or some other speed of the vehicle, `exact` if of both rear wheels."""

    sensor, quantity, period_ns = Sensor.ODOMETER, "speed", PERIOD_NS

    time_ns: int
    received_ns: int
    source: str
    speed: float
    resolution: float
    of_wheels: bool
    exact: bool
    settings: Settings
    doubt: str | None = None  # why a speed of zero may be no standstill

    def implausible(self) -> str | None:
        """Limit of speeds."""
        fast = not (abs(self.speed) < MAX_SPEED_M_S and abs(self.resolution) < MAX_SPEED_M_S)
        return "implausible speed" if fast else None

    def show(self, sink: MotionSink) -> None:
        """Speed."""
        sink.see_speed(self.speed)

    def tell(self, model: NonInertial) -> None:
        """Speed."""
        model.use_speed(self)

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Speed alone."""
        yield self.observe

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation against (1 + k) times the forward velocity of the rear axle, k being the error of its scale.

        Most speeds have no sign. The filter's own says which way it was, with a probability: with f the predicted
        speed and S the innovation's variance, the mean of the two is s tanh(s f / S), their variance
        s² (1 - tanh²). One below zero has a sign.
        """
        z, H, R, unsure = speed_observation(
            rear_axle_of(navigation, self.settings), navigation.row, self.reading, model_of(self.settings)
        )
        return Observation(AidingKind.ODOMETER, z, H, R, self.doubt if unsure else None)

    @property
    def reading(self) -> tuple[float, float, bool]:
        """Speed [m/s], its resolution [m/s], and whether it is of both rear wheels."""
        return self.speed, self.resolution, self.exact


class OdometerModel(NamedTuple):
    """Noise of speeds."""

    speed_sd: float  # [m/s]
    arm_sd: float  # [m] of the rear axle's position


def model_of(settings: Settings) -> OdometerModel:
    """Model of a vehicle."""
    arm_sd = UNKNOWN_ARM_SD if settings.vehicle.rear_axle_body_m is None else 0.0
    return OdometerModel(settings.odometer.speed_sd_m_s, arm_sd)


@compilable
def speed_observation(
    axle: tuple[FloatArray, FloatArray], row: Row, reading: tuple[float, float, bool], model: OdometerModel
) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    """Innovation z, matrix H and covariance R of a speed, and whether the filter does not know better: see the class.

    Wheels that stand move the axle in no direction: forward to within the dead zone, sideways and down at once. A zero
    in doubt is not used while the filter does not know better; where it does, the gate decides.
    """
    (ahead, axle_H), (measured, resolution, exact) = axle, reading
    scale, forward = 1.0 + float(row.parameters[SCALE - em.DRIVING]), float(ahead[0])
    H = scale * axle_H[:1]
    H[0, SCALE] = -forward
    predicted, speed, rate = scale * forward, measured, row.state.rate_b[2]
    noise = hypot(model.speed_sd, resolution / 12.0**0.5)
    of_filter = H[0, : len(row.P)]
    predicted_variance = float(of_filter @ row.P @ of_filter)
    if measured == 0.0:
        noise = hypot(noise, DEAD_ZONE_SD)
    side = 0.0 if exact and model.arm_sd == 0.0 else HALF_TRACK_M * rate
    old = STAMP_SD * norm(row.state.acceleration_n)
    variance = noise**2 + side**2 + old**2
    if measured == 0.0:
        sway2 = SWAY_SD**2 + (model.arm_sd * rate) ** 2
        rows, R = np.empty((3, em.SIZE)), np.zeros((3, 3))
        rows[0], rows[1:] = H[0], axle_H[1:]
        R[0, 0], R[1, 1], R[2, 2] = variance, sway2, sway2
        unsure = predicted_variance > DEAD_ZONE_SD**2
        return np.array([-predicted, -float(ahead[1]), -float(ahead[2])]), rows, R, unsure
    if speed > 0.0:
        direction = tanh(speed * predicted / (predicted_variance + variance))
        variance += speed**2 * (1.0 - direction**2)
        speed *= direction
    return np.array([speed - predicted]), H, np.array([[variance]]), False


def of_speed(message: VehicleSpeed, settings: Settings) -> Iterator[WheelSpeed]:
    """Speed of the vehicle, of which nobody says where it is measured."""
    if settings.odometer.enabled:
        scale, stamp = settings.odometer.scale, (message.sampled_ns, message.received_ns, message.source)
        resolution = scale * (message.resolution_m_s or 0.0)
        yield WheelSpeed(*stamp, scale * message.speed_m_s, resolution, of_wheels=False, exact=False, settings=settings)


def of_wheels(message: WheelSpeeds, settings: Settings) -> Iterator[WheelSpeed]:
    """Mean speed of the rear wheels, or of the front wheels if there is no rear wheel."""
    rear = [wheel for wheel in (message.rear_left_m_s, message.rear_right_m_s) if wheel is not None]
    wheels = rear or [wheel for wheel in (message.front_left_m_s, message.front_right_m_s) if wheel is not None]
    if wheels and settings.odometer.enabled:
        speed, stamp = sum(wheels) / len(wheels), (message.sampled_ns, message.received_ns, message.source)
        exact = len(rear) == 2
        yield WheelSpeed(*stamp, settings.odometer.scale * speed, 0.0, of_wheels=True, exact=exact, settings=settings)


KINDS = {VehicleSpeed: (of_speed,), WheelSpeeds: (of_wheels,)}
