"""Decodes Xbus bytes to inertial samples in body axes."""

from collections import Counter
from collections.abc import Iterator

from pydantic import Field

from shared.errors import ConfigError
from shared.messages.base import Message
from shared.messages.imu import ImuRaw, ImuSamples
from shared.runtime.config import VehicleSettings, vehicle_in
from shared.runtime.old_keys import MOUNTING, in_section

from .xsens import Tracker

MAX_TRACKERS = 8


class Config(VehicleSettings):
    """Settings of the IMU parser; the mounting is `[vehicle.imu] body_from_sensor`."""

    minimum_delay_s: float = Field(
        default=0.003, ge=0.0, description="minimum delay from an inertial sample to its arrival"
    )

    def model_post_init(self, context: object) -> None:
        """Raise `ConfigError` for a mounting that no mount makes."""
        (a, b, c), (d, e, f), (g, h, i) = self.vehicle.imu.body_from_sensor
        if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0:  # determinant
            file = vehicle_in(context)
            raise ConfigError(
                f"{file.path if file else 'settings'}: {in_section(MOUNTING)} mirrors the axes, which no mount does: "
                "the third row must be the cross product of the first and the second"
            )


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
                body_from_sensor=self._config.vehicle.imu.body_from_sensor,
                minimum_delay_s=self._config.minimum_delay_s,
                rejects=self.rejects,
            )
        return self._trackers[source]
