"""What inertial measurement units say."""

from typing import Annotated, ClassVar

from pydantic import model_validator

from .base import Message, Name, Nanoseconds, Quantity, RawBytes, Vector3, unit

FieldShare = Annotated[Quantity, unit("calibration field")]


class ImuRaw(RawBytes):
    """Bytes that an inertial measurement unit sent (Xbus)."""

    is_stream: ClassVar[bool] = True


class ImuSamples(Message):
    """One or more consecutive inertial samples in body axes (forward, right, down)."""

    received_ns: Nanoseconds
    source: Name
    sampled_ns: tuple[Nanoseconds, ...]
    specific_force_body_m_s2: tuple[Vector3, ...]
    angular_rate_body_rad_s: tuple[Vector3, ...]
    saturated: bool = False
    temperature_k: Quantity | None = None
    pressure_pa: Quantity | None = None
    magnetic_field_body: tuple[FieldShare, FieldShare, FieldShare] | None = None  # of the last sample

    @model_validator(mode="after")
    def _equal_lengths(self) -> "ImuSamples":
        n = len(self.sampled_ns)
        if not n or len(self.specific_force_body_m_s2) != n or len(self.angular_rate_body_rad_s) != n:
            raise ValueError("stamps, forces and rates differ in number, or there is none")
        return self
