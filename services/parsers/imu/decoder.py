"""What decoders of inertial measurement units have in common: samples in body axes, and their stamps."""

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from shared.faults import Faults
from shared.kinds import Kinds
from shared.maths.clock_mapping import ClockMapping
from shared.messages.base import Vector3
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.operation import MessageUse
from shared.runtime.config import Matrix3

MAX_ACCELERATION_M_S2 = 1000.0  # plausibility limit; accelerometer ranges are at most 16 to 50 g
MAX_RATE_RAD_S = 100.0  # plausibility limit; gyroscope ranges are at most 2000 to 4000 deg/s


class SampleError(ValueError):
    """A measurement that is rejected; the text is the kind of reject."""


@dataclass
class Stream:
    """What a decoder is told of its device, and where it counts."""

    source: str
    body_from_sensor: Matrix3
    minimum_delay_s: float
    rejects: Counter[str]
    kinds: Kinds


@dataclass(slots=True)
class Batch:
    """The samples of one chunk of bytes."""

    device_ns: list[int] = field(default_factory=list)  # time of the device's clock, or of the OBU without one
    forces: list[Vector3] = field(default_factory=list)
    rates: list[Vector3] = field(default_factory=list)
    saturated: bool = False


class Decoder(ABC):
    """Decodes the bytes of one device to samples in body axes, stamped in the OBU time line."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.faults = Faults(stream.rejects)
        self.clock = ClockMapping(stream.minimum_delay_s)

    @abstractmethod
    def take(self, raw: ImuRaw) -> ImuSamples | None:
        """Process the next bytes; return one message with all completed samples, or None."""

    def count(self, kind: str, use: MessageUse, fault: SampleError | None = None) -> None:
        """Count a message of the device, and its reject."""
        self.stream.kinds.count(kind, use)
        if fault is not None:
            self.stream.rejects[str(fault)] += 1
            self.stream.kinds.reject(kind, str(fault))

    def add(self, batch: Batch, device_ns: int, force: Sequence[float], rate: Sequence[float]) -> None:
        """Add a sample in sensor axes [m/s², rad/s]; raises SampleError for one that cannot be."""
        check(force, MAX_ACCELERATION_M_S2)
        check(rate, MAX_RATE_RAD_S)
        batch.device_ns.append(device_ns)
        batch.forces.append(rotate(self.stream.body_from_sensor, force))
        batch.rates.append(rotate(self.stream.body_from_sensor, rate))

    def stamps(self, batch: Batch, received_ns: int) -> tuple[int, ...]:
        """Times of validity [ns, OBU time line] of the samples of a batch."""
        return self.clock.stamp_all(batch.device_ns, received_ns)

    def samples(self, batch: Batch, received_ns: int, **slow: float | Vector3 | None) -> ImuSamples:
        """Make the message of a batch; `slow` are its fields beside samples."""
        return ImuSamples(
            received_ns=received_ns,
            source=self.stream.source,
            sampled_ns=self.stamps(batch, received_ns),
            specific_force_body_m_s2=tuple(batch.forces),
            angular_rate_body_rad_s=tuple(batch.rates),
            saturated=batch.saturated,
            **slow,  # type: ignore[arg-type]  # its validator checks them
        )


def check(vector: Sequence[float], limit: float) -> None:
    """Raise SampleError for a vector with a component that is not finite or exceeds the limit."""
    if not all(map(math.isfinite, vector)):
        raise SampleError("not_finite")
    if max(map(abs, vector)) > limit:
        raise SampleError("out_of_range")


def rotate(matrix: Matrix3, vector: Sequence[float]) -> Vector3:
    """Product of a matrix and a vector, in plain floats (faster than an array of three numbers)."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    x, y, z = vector
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
