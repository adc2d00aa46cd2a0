"""The inertial sensors of a phone, by lines of Android's GnssLogger: kind, UTC [ms], time of the device [ns], x, y, z.

The receiver's parser passes these lines on, as bytes of the source `<receiver>/imu`. Accelerations are interpolated at
the times of the rates. The axes are those of the device: right, top, out of the screen.
"""

from bisect import bisect_left
from collections import deque

from shared.messages.base import Vector3
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.operation import MessageUse
from shared.protocols.framing.framer import Framer
from shared.protocols.registry import BY_NAME

from .decoder import MAX_ACCELERATION_M_S2, MAX_RATE_RAD_S, Batch, Decoder, SampleError, Stream, check, rotate

ACCELERATION, RATE, FIELD = ("UncalAccel", "Accel"), ("UncalGyro", "Gyro"), ("UncalMag", "Mag")
SILENCE_NS = 1_000_000_000  # of an uncalibrated sensor, after which the calibrated one is used
GAP_NS = 100_000_000  # between accelerations, over which none is interpolated
WAITING = 400  # rates and accelerations at most that wait for each other
MAX_TIME_NS = 1 << 60
EARTH_FIELD_UT = 50.0  # of a field of one
PA_HPA = 100.0
LOWEST_HPA, HIGHEST_HPA = 300.0, 1200.0
Sample = tuple[int, Vector3]


class PhoneImu(Decoder):
    """Pairs rates with accelerations; a calibrated sensor is used where there is no uncalibrated one.

    `rejects` counts those of the framing, `phone_sensor`, `repeated_sample`, `not_finite`, `out_of_range`, and
    `incomplete_sample` of a rate between accelerations that are too far apart.
    """

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self._framer = Framer((BY_NAME["GnssLogger"].framing,), stream.rejects)
        self._seen_ns: dict[str, int] = {}  # arrival of the newest line of each uncalibrated sensor
        self._forces: deque[Sample] = deque(maxlen=WAITING)
        self._rates: deque[Sample] = deque(maxlen=WAITING)
        self._last_ns = -1  # of the newest rate that was used
        self._field: Vector3 | None = None
        self._pressure_pa: float | None = None

    def take(self, raw: ImuRaw) -> ImuSamples | None:
        """Process the next lines."""
        batch = Batch()
        for frame in self._framer.feed(raw.data):
            with self.faults.decoding(raw.received_ns):
                self._line(frame.data.decode().strip().split(","), raw.received_ns, batch)
        if not batch.device_ns:
            return None
        slow = {"pressure_pa": self._pressure_pa, "magnetic_field_body": self._field}
        self._field = self._pressure_pa = None
        return self.samples(batch, raw.received_ns, **slow)

    def _line(self, parts: list[str], received_ns: int, batch: Batch) -> None:
        kind = parts[0]
        try:
            self._take(kind, parts, received_ns, batch)
        except SampleError as fault:
            self.count(kind, MessageUse.USED, fault)
        else:
            self.count(kind, MessageUse.USED)

    def _take(self, kind: str, parts: list[str], received_ns: int, batch: Batch) -> None:
        if kind == "Pressure":
            pressure = _numbers(parts, 1)[0]
            if not LOWEST_HPA <= pressure <= HIGHEST_HPA:
                raise SampleError("out_of_range")
            self._pressure_pa = pressure * PA_HPA
        elif self._is_used(kind, ACCELERATION, received_ns):
            self._later(self._forces, self._sample(parts, MAX_ACCELERATION_M_S2))
            self._pair(batch)
        elif self._is_used(kind, RATE, received_ns):
            self._later(self._rates, self._sample(parts, MAX_RATE_RAD_S))
            self._pair(batch)
        elif self._is_used(kind, FIELD, received_ns):
            x, y, z = _numbers(parts, 3)
            check((x, y, z), 1e4)
            field = rotate(self.stream.body_from_sensor, (x, y, z))
            self._field = field[0] / EARTH_FIELD_UT, field[1] / EARTH_FIELD_UT, field[2] / EARTH_FIELD_UT

    def _is_used(self, kind: str, pair: tuple[str, str], received_ns: int) -> bool:
        """Whether a sensor of a pair is in use: the second one where the first has been silent for a second."""
        if kind not in pair:
            return False
        if kind == pair[0]:
            self._seen_ns[kind] = received_ns
            return True
        seen_ns = self._seen_ns.get(pair[0])
        return seen_ns is None or not 0 <= received_ns - seen_ns < SILENCE_NS

    def _sample(self, parts: list[str], limit: float) -> Sample:
        x, y, z = _numbers(parts, 3)
        check((x, y, z), limit)
        try:
            time_ns = int(parts[2][:20])
        except ValueError as error:
            raise SampleError("phone_sensor") from error
        if not 0 < time_ns < MAX_TIME_NS:
            raise SampleError("out_of_range")
        return time_ns, (x, y, z)

    def _later(self, waiting: deque[Sample], sample: Sample) -> None:
        """Add a sample; a large step back is that of a device that has started again."""
        if waiting and sample[0] <= waiting[-1][0]:
            if waiting[-1][0] - sample[0] < GAP_NS:
                raise SampleError("repeated_sample")
            self._forces.clear()
            self._rates.clear()
            self._last_ns = -1
        waiting.append(sample)

    def _pair(self, batch: Batch) -> None:
        """Use each rate that lies between two accelerations."""
        while self._rates and self._forces and self._rates[0][0] <= self._forces[-1][0]:
            time_ns, rate = self._rates.popleft()
            after = bisect_left(self._forces, time_ns, key=lambda force: force[0])
            second_ns, second = self._forces[after]
            first_ns, first = self._forces[after - 1] if second_ns > time_ns and after else (second_ns, second)
            if (second_ns > time_ns and not after) or second_ns - first_ns > GAP_NS:
                raise SampleError("incomplete_sample")
            if time_ns <= self._last_ns:
                raise SampleError("repeated_sample")
            share = 0.0 if second_ns == first_ns else (time_ns - first_ns) / (second_ns - first_ns)
            force = tuple(a + share * (b - a) for a, b in zip(first, second, strict=True))
            self.add(batch, time_ns, force, rate)
            self._last_ns = time_ns
            while len(self._forces) > 1 and self._forces[1][0] <= time_ns:
                self._forces.popleft()


def _numbers(parts: list[str], count: int) -> list[float]:
    if len(parts) < 3 + count:
        raise SampleError("phone_sensor")
    try:
        return [float(text[:32]) for text in parts[3 : 3 + count]]
    except ValueError as error:
        raise SampleError("phone_sensor") from error
