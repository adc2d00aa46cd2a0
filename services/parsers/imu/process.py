"""Decodes Xbus bytes to inertial samples in body axes."""

from collections import Counter
from collections.abc import Iterator

from pydantic import Field, field_validator

from shared.messages.base import Message
from shared.messages.imu import ImuRaw, ImuSamples
from shared.runtime.config import Section

from .xsens import Matrix3, Tracker

MAX_TRACKERS = 8
TOLERANCE = 1e-4  # allows matrices written with four decimals


class Config(Section):
    """Settings of the IMU parser.

    The columns of `body_from_sensor` are the sensor's x, y and z axes in body axes (forward, right, down). The
    default is an MTi mounted horizontally with x forward, y left and z up, as marked on its case.
    """

    body_from_sensor: Matrix3 = Field(
        default=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
        description="rotation matrix from sensor axes to body axes (forward, right, down), row by row",
    )
    minimum_delay_s: float = Field(
        default=0.003, ge=0.0, description="minimum delay from an inertial sample to its arrival"
    )

    @field_validator("body_from_sensor")
    @classmethod
    def _is_rotation(cls, rows: Matrix3) -> Matrix3:
        x, y, z = rows
        cross = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
        unit = all(abs(sum(part * part for part in row) - 1) < TOLERANCE for row in (x, y))
        upright = abs(sum(a * b for a, b in zip(x, y, strict=True))) < TOLERANCE
        if not (unit and upright and max(abs(a - b) for a, b in zip(cross, z, strict=True)) < TOLERANCE):
            raise ValueError("not a rotation matrix: rows must be orthogonal unit vectors, the third = first x second")
        return rows


class Process:
    """One `Tracker` per source; time is taken from the stamps of the messages only."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self._config = config
        self._trackers: dict[str, Tracker] = {}

    def handle(self, message: Message) -> Iterator[ImuSamples]:
        """Process raw IMU bytes; other messages are ignored."""
        if isinstance(message, ImuRaw) and (tracker := self._tracker(message.source)):
            samples = tracker.take(message)
            if samples is not None:
                yield samples

    def _tracker(self, source: str) -> Tracker | None:
        if source not in self._trackers:
            if len(self._trackers) >= MAX_TRACKERS:
                self.rejects["too_many_sources"] += 1
                return None
            self._trackers[source] = Tracker(
                source,
                body_from_sensor=self._config.body_from_sensor,
                minimum_delay_s=self._config.minimum_delay_s,
                rejects=self.rejects,
            )
        return self._trackers[source]
