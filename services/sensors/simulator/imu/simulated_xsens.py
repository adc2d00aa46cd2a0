"""The simulated IMU: an Xsens MTi-630 that sends MTData2 at 100 Hz."""

from collections.abc import Iterator
from math import cos, radians, sin

import numpy as np
import numpy.typing as npt

from shared.maths.rotation import ned_from_body
from shared.messages.base import Message
from shared.messages.imu import ImuRaw
from shared.protocols import xbus

from ..devices import Delay, DeviceClock
from ..motion.trajectory import Motion
from ..vehicle import Readings, Stream

FloatArray = npt.NDArray[np.float64]

SOURCE = "imu0"
TICK_NS = 100_000  # resolution of the field SampleTimeFine
FLAT = np.diag([1.0, -1.0, -1.0])  # body (forward, right, down) from sensor with x forward, y left, z up
DECLINATION, INCLINATION = radians(4.0), radians(58.5)  # of the magnetic field in central Italy
FIELD_N = np.array([
    cos(INCLINATION) * cos(DECLINATION), cos(INCLINATION) * sin(DECLINATION), sin(INCLINATION)
])  # fmt: skip  # [-] normalised to the field at the place of calibration
MAGNETIC_SD, HARD_IRON_SD = 0.002, 0.02  # [-]
PRESSURE_SD_PA = 2.0
HEALTHY = 0b11  # self-test passed, filter valid


class Tracker:
    """Encodes inertial, magnetic and pressure measurements as Xbus bytes."""

    def __init__(
        self,
        seed: int,
        start_ns: int,
        clocks: np.random.Generator,
        mounting_rpy_deg: tuple[float, float, float],
    ) -> None:
        self.clock = DeviceClock(clocks, latest_start_ns=3600 * 10**9)
        self._start_ns = start_ns
        self._delay = Delay(0.003, 0.0004, 0.005, clocks)
        self._rng = np.random.default_rng((seed, Stream.ENVIRONMENT))
        self._hard_iron = HARD_IRON_SD * self._rng.standard_normal(3)
        self._weather_pa = 500.0 * self._rng.standard_normal()
        self._counter = int(self._rng.integers(1 << 16))
        roll, pitch, yaw = np.radians(mounting_rpy_deg).tolist()
        self.body_from_sensor: FloatArray = ned_from_body(roll, pitch, yaw) @ FLAT

    def sample(self, readings: Readings, step_ns: int) -> Iterator[tuple[int, Message]]:
        """Yield (arrival time, message) of each sample of a block."""
        motion = readings.motion
        forces = (readings.force_b @ self.body_from_sensor).tolist()
        rates = (readings.rate_b @ self.body_from_sensor).tolist()
        fields = (self._magnetic(motion) @ self.body_from_sensor).tolist()
        pressures = self._pressure(motion).tolist()
        for i, (force, rate, field, pressure) in enumerate(zip(forces, rates, fields, pressures, strict=True), 1):
            sampled_ns = (motion.first + i) * step_ns
            data = self._encode(sampled_ns, force, rate, field, pressure)
            received_ns = self._start_ns + self._delay.arrival_ns(sampled_ns)
            yield received_ns, ImuRaw(received_ns=received_ns, source=SOURCE, data=data)

    def _encode(
        self, sampled_ns: int, force: list[float], rate: list[float], field: list[float], pressure: float
    ) -> bytes:
        self._counter = (self._counter + 1) & 0xFFFF
        ticks = round(self.clock.reading_ns(sampled_ns) / TICK_NS) & 0xFFFFFFFF
        warm_up = sampled_ns * 1e-9 / (sampled_ns * 1e-9 + 300.0)
        values: tuple[tuple[int, tuple[float, ...]], ...] = (
            (xbus.TEMPERATURE, (24.0 + 9.0 * warm_up,)),
            (xbus.PACKET_COUNTER, (self._counter,)),
            (xbus.SAMPLE_TIME_FINE, (ticks,)),
            (xbus.BARO_PRESSURE, (pressure,)),
            (xbus.ACCELERATION, tuple(force)),
            (xbus.RATE_OF_TURN, tuple(rate)),
            (xbus.MAGNETIC_FIELD, tuple(field)),
            (xbus.STATUS_WORD, (HEALTHY,)),
        )
        return xbus.encode_mtdata2({key: xbus.encode_field(key, *numbers) for key, numbers in values})

    def _magnetic(self, motion: Motion) -> FloatArray:
        field_b: FloatArray = np.einsum("nij,i->nj", motion.ned_from_body[1:], FIELD_N)
        return field_b + self._hard_iron + MAGNETIC_SD * self._rng.standard_normal(field_b.shape)

    def _pressure(self, motion: Motion) -> FloatArray:
        """Pressure [Pa]: standard atmosphere (ICAO Doc 7488), a constant weather offset and noise."""
        height = motion.position[1:, 2]
        standard = 101_325.0 * (1.0 - 2.25577e-5 * height) ** 5.25588
        noise: FloatArray = PRESSURE_SD_PA * self._rng.standard_normal(len(height))
        return np.asarray(standard + self._weather_pa + noise, dtype=np.float64)
