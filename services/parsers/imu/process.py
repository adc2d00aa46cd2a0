"""Turns Xbus bytes into inertial samples in body axes."""

from collections import Counter
from collections.abc import Iterator

from pydantic import Field, field_validator

from shared.messages.base import Message
from shared.messages.imu import ImuRaw, ImuSamples
from shared.runtime.config import Section

from .xsens import Matrix3, Tracker

MAX_TRACKERS = 8
TOLERANCE = 1e-4  # four decimals are enough


class Config(Section):
    """Settings of the IMU parser.

    `body_from_sensor` turns a vector from the sensor's axes to the body's (forward, right, down): its columns
    are the sensor's x, y and z axes written in body axes. The default is an MTi that lies flat with x forward,
    y left and z up, as its case is marked.
    """

    body_from_sensor: Matrix3 = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    minimum_delay_s: float = Field(default=0.003, ge=0.0)  # from the sample to its arrival, at best

    @field_validator("body_from_sensor")
    @classmethod
    def _is_rotation(cls, rows: Matrix3) -> Matrix3:
        x, y, z = rows
        cross = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
        unit = all(abs(sum(part * part for part in row) - 1) < TOLERANCE for row in (x, y))
        upright = abs(sum(a * b for a, b in zip(x, y, strict=True))) < TOLERANCE
        if not (unit and upright and max(abs(a - b) for a, b in zip(cross, z, strict=True)) < TOLERANCE):
            raise ValueError(
                "this is no rotation: rows must be unit vectors at right angles, the third = first x second"
            )
        return rows


class Process:
    """One `Tracker` a source; knows no more of time than the stamps of its messages."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self._config = config
        self._trackers: dict[str, Tracker] = {}

    def handle(self, message: Message) -> Iterator[ImuSamples]:
        """Take bytes; nothing else concerns this process."""
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
