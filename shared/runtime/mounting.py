"""Turns recorded inertial samples into the axes of the mounting that a vehicle's file states now."""

import numpy as np

from ..messages.base import Message, Vector3
from ..messages.imu import ImuSamples
from .config import VehicleFile


class RecordedAxes:
    """Turns samples from the axes in which they were recorded into those of the vehicle's file.

    A parser that reads the bytes of the sensor uses the mounting of the file itself; only recorded samples are turned.
    Nothing changes, to the bit, where the file states the mounting with which they were recorded.
    """

    def __init__(self, vehicle: VehicleFile) -> None:
        now, then = vehicle.facts.imu.body_from_sensor, vehicle.samples_mounting
        self._turn = None if then in (None, now) else np.array(now) @ np.array(then).T

    def apply(self, message: Message) -> Message:
        """Turn the vectors of inertial samples; other messages stay."""
        if self._turn is None or not isinstance(message, ImuSamples):
            return message
        field = message.magnetic_field_body
        return message.model_copy(
            update={
                "specific_force_body_m_s2": self._turned(message.specific_force_body_m_s2),
                "angular_rate_body_rad_s": self._turned(message.angular_rate_body_rad_s),
                "magnetic_field_body": None if field is None else self._turned((field,))[0],
            }
        )

    def _turned(self, vectors: tuple[Vector3, ...]) -> tuple[Vector3, ...]:
        assert self._turn is not None
        return tuple((x, y, z) for x, y, z in (np.array(vectors) @ self._turn.T).tolist())
