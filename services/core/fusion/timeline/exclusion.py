"""What an engine leaves out, as core.trust has decided."""

from dataclasses import dataclass

from ..aids.base import Measurement, Sensor


@dataclass(frozen=True)
class Exclusions:
    """Exclusions at one instant; replaced by events and never changed in place."""

    gnss_since_ns: int | None = None
    odometer: bool = False
    satellites: tuple[str, ...] = ()  # satellites without which the newest position was computed
    fixes: int = 0  # number of excluded positions
    test_ratio: float | None = None  # of the newest excluded position
    readmitted_after_s: float | None = None  # duration of an exclusion, until the first position is used again

    def reason(self, measurement: Measurement) -> str | None:
        """Reason why a measurement is excluded, or None."""
        return self.reason_of(measurement.sensor)

    def reason_of(self, sensor: Sensor) -> str | None:
        """Reason why measurements of a sensor are excluded, or None."""
        if self.gnss_since_ns is not None and sensor is Sensor.GNSS:
            return "GNSS is excluded by core.trust"
        if self.odometer and sensor is Sensor.ODOMETER:
            return "odometer is excluded by core.trust"
        return None
