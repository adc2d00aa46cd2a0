"""The simulated CAN bus: wheel speeds at 50 Hz, and OBD-II speed requests with the responses of the engine ECU."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from shared.messages.base import Message
from shared.messages.vehicle import CanRaw

from ..attacks.signals import Odometer
from ..devices import DeviceClock
from ..motion.trajectory import Motion
from ..vehicle import Stream
from .can_frames import (
    REQUEST_ID,
    RESPONSE_ID,
    WHEEL_SPEEDS_ID,
    Wheels,
    line,
    speed_request,
    speed_response,
    wheel_frame,
    wheel_speeds,
)

FloatArray = npt.NDArray[np.float64]

SOURCE = "can0"
MS = 1_000_000
WHEEL_PERIOD_NS = 20 * MS
REQUEST_EVERY = 35  # wheel frames: 0.7 s
BATCH_NS = 100 * MS
WHEEL_DELAY_NS = (5 * MS, 20 * MS)  # from the wheel sensor through its ECU to the bus
FILTER_NS = 100 * MS  # delay of the filtered OBD-II speed
RESPONSE_NS = (8 * MS, 40 * MS)  # from request to response
NOISE_SD = 0.02  # [m/s]
TYRE_SD, WHEEL_SD = 0.005, 0.001  # [-] scale error of all wheels, and of each


class CanBus:
    """Simulates the frames on the CAN bus from the true motion, as lines of a candump log in batches of 100 ms."""

    def __init__(
        self, seed: int, start_ns: int, clocks: np.random.Generator, odometer_at: Callable[[int], Odometer]
    ) -> None:
        self._clock = DeviceClock(clocks, latest_start_ns=1)
        self._rng = np.random.default_rng((seed, Stream.WHEELS, 1))
        scale = np.random.default_rng((seed, Stream.WHEELS)).standard_normal()
        self._scales = 1.0 + TYRE_SD * scale + WHEEL_SD * self._rng.standard_normal(4)
        self._start_ns, self._odometer_at = start_ns, odometer_at
        self._frames = 0
        self._lines: list[tuple[int, int, bytes]] = []  # time on the bus [ns], identifier, data
        self._last_ns = 0
        self._wheels_held: Wheels | None = None  # last wheel speeds
        self._response_held: bytes | None = None  # last OBD-II response
        self._stopped = False  # at standstill since an attack that reports zero from then on
        self._batch_ns = start_ns + BATCH_NS

    def transmit(self, motion: Motion, begin_ns: int, end_ns: int) -> Iterator[tuple[int, Message]]:
        """Yield (arrival time, message) of the batches that end within a block of the motion."""
        period_ns = self._clock.period_ns(WHEEL_PERIOD_NS)
        nodes = np.linspace(begin_ns - self._start_ns, end_ns - self._start_ns, len(motion.speed))
        last = (end_ns - self._start_ns) // period_ns
        times = np.arange(self._frames + 1, last + 1) * period_ns
        speeds = np.interp(times, nodes, motion.speed).tolist()
        turns = np.interp(times, nodes[1:], motion.rate_b[:, 2]).tolist()
        for time_ns, speed, turn in zip((self._start_ns + times).tolist(), speeds, turns, strict=True):
            self._frames += 1
            odometer = self._odometer_at(time_ns)
            self._stopped = odometer.zero_from_stop and (self._stopped or speed <= 0.0)
            if self._stopped:
                odometer = replace(odometer, factor=0.0)
            self._wheels(time_ns, speed, turn, odometer)
            if self._frames % REQUEST_EVERY == 0:
                self._request_speed(time_ns, speed, odometer)
        # A sample of this block is on the bus 5 ms later at the earliest.
        while self._batch_ns <= end_ns + WHEEL_DELAY_NS[0]:
            yield self._batch_ns, self._batch()

    def _wheels(self, time_ns: int, speed: float, turn: float, odometer: Odometer) -> None:
        self._last_ns = max(self._last_ns, time_ns + int(self._rng.integers(*WHEEL_DELAY_NS)))
        first, second, third, fourth = (odometer.factor * wheel for wheel in self._measured(speed, turn))
        if not odometer.held or self._wheels_held is None:
            self._wheels_held = (first, second, third, fourth)
        self._lines.append((self._last_ns, WHEEL_SPEEDS_ID, wheel_frame(self._wheels_held)))

    def _measured(self, speed: float, turn: float) -> Wheels:
        noise = self._rng.standard_normal(4) * (NOISE_SD if speed > 0.0 else 0.0)
        values = np.array(wheel_speeds(speed, turn if speed > 0.0 else 0.0)) * self._scales + noise
        first, second, third, fourth = values.tolist()
        return first, second, third, fourth

    def _request_speed(self, time_ns: int, speed: float, odometer: Odometer) -> None:
        """Add a speed request and its response, which holds the speed of `time_ns`, to the bus."""
        response_ns = time_ns + FILTER_NS + int(self._rng.integers(10 * MS))
        request_ns = response_ns - int(self._rng.integers(*RESPONSE_NS))
        if not odometer.held or self._response_held is None:
            self._response_held = speed_response(odometer.factor * speed * float(self._scales.mean()))
        self._lines.append((request_ns, REQUEST_ID, speed_request()))
        self._lines.append((response_ns, RESPONSE_ID, self._response_held))

    def _batch(self) -> CanRaw:
        self._lines.sort(key=lambda row: row[0])
        ready = [row for row in self._lines if row[0] <= self._batch_ns]
        self._lines = self._lines[len(ready) :]
        data = b"".join(line(*row) for row in ready)
        batch = CanRaw(received_ns=self._batch_ns, source=SOURCE, data=data)
        self._batch_ns += BATCH_NS
        return batch
