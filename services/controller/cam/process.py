"""Decides when the vehicle sends its own CAM, and what it states."""

from collections import Counter
from collections.abc import Iterator

from pydantic import Field

from shared.faults import Faults
from shared.messages.base import Message, Vector3
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationSolution
from shared.messages.trust import TrustState
from shared.messages.v2x import OwnCam, StationType, VehicleRole
from shared.runtime.config import Section
from shared.v2x.generation import GenerationRules
from shared.v2x.its_time import its_time_ms

from .content import Motion, PathHistory, Vehicle, dynamics, own_cam


class Config(Section):
    """Settings of the vehicle's own CAM."""

    station_id: int = Field(default=1, ge=0, lt=1 << 32, description="pseudonym under which the vehicle sends")
    station_type: StationType = Field(default=StationType.PASSENGER_CAR, description="kind of vehicle")
    role: VehicleRole = Field(default=VehicleRole.DEFAULT, description="role of the vehicle")
    reference_point_body_m: Vector3 = Field(
        default=(1.8, 0.0, 0.6),
        description="from the IMU to the ground below the middle of the front: forward, right, down",
    )
    length_m: float | None = Field(
        default=None, gt=0.0, description="length of the vehicle; without it `unavailable` is sent"
    )
    width_m: float | None = Field(
        default=None, gt=0.0, description="width of the vehicle; without it `unavailable` is sent"
    )


class Process:
    """Applies the generation rules to the navigation solution."""

    def __init__(self, config: Config) -> None:
        self._vehicle = Vehicle(**{name: getattr(config, name) for name in Config.model_fields})
        self._rules = GenerationRules()
        self._motion, self._path = Motion(), PathHistory()
        self._trust: TrustState | None = None
        self.rejects: Counter[str] = Counter()
        self._faults = Faults(self.rejects)
        self._utc_offset_ns: int | None = None  # UTC - OBU time line

    def handle(self, message: Message) -> Iterator[OwnCam]:
        """Process a message; yield a CAM when one is due and the time is known."""
        match message:
            case GnssFix(utc_ns=int(utc_ns)):
                self._utc_offset_ns = utc_ns - message.sampled_ns
            case TrustState():
                self._trust = message
            case NavigationSolution() if self._utc_offset_ns is not None:
                self._motion.add(message)
                now = dynamics(message, self._vehicle)
                self._path.add(now.time_ns, now.position)
                generation = self._rules.check(now)
                if generation is not None:
                    with self._faults.decoding(message.sampled_ns):  # a state that no CAM can hold is a reject
                        yield own_cam(
                            message,
                            self._vehicle,
                            self._motion,
                            self._path,
                            self._trust,
                            its_time_ms=its_time_ms(message.sampled_ns + self._utc_offset_ns),
                            low_frequency=generation.low_frequency,
                        )
