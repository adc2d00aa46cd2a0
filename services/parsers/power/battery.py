"""Decodes readings of a supply, rejects what cannot be, and decides when the battery is nearly empty.

References
----------
Texas Instruments, INA219, SBOS448: tables 4 and 5. Shunt voltage in 10 µV, signed; bus voltage in 4 mV from bit 3 on.
"""

from collections import Counter
from dataclasses import dataclass

from shared.messages.power import PowerProtocol, PowerRaw

NS = 1_000_000_000
LARGEST_CURRENT_A = 20.0  # more than any supply of such a computer; a wrong shunt shows itself by it
# A battery does not change by more in a second under the load of such a computer: between idle and full load the
# voltage of two cells steps by about 0.3 V.
LARGEST_STEP_V = 1.0
STEPS = 5  # readings in a row that confirm a voltage after a step


@dataclass(frozen=True)
class Limits:
    """What is plausible, and what is low."""

    shunt_ohm: float
    empty_v: float
    full_v: float
    discharging_a: float
    low_ratio: float


@dataclass(frozen=True)
class Reading:
    """One plausible reading; a signal has neither voltage nor current."""

    on_battery: bool
    voltage_v: float | None = None
    current_a: float | None = None
    charge_ratio: float | None = None


class Decoder:
    """Decodes the readings of one supply; `rejects` counts what is implausible by kind."""

    def __init__(self, limits: Limits, rejects: Counter[str]) -> None:
        self._limits, self._rejects = limits, rejects
        self._voltage_v: float | None = None
        self._step_v: list[float] = []

    def decode(self, raw: PowerRaw) -> Reading | None:
        """Decode a reading; None for one that is rejected."""
        if raw.protocol is PowerProtocol.SIGNAL:
            text = raw.data.strip()
            if text not in (b"0", b"1"):
                self._rejects["power_signal"] += 1
                return None
            return Reading(on_battery=text == b"0")
        limits = self._limits
        shunt, bus = int.from_bytes(raw.data[:2], "big", signed=True), int.from_bytes(raw.data[2:], "big")
        voltage_v, current_a = (bus >> 3) * 0.004, shunt * 1e-5 / limits.shunt_ohm
        if fault := self._fault(raw.data, voltage_v, current_a):
            self._rejects[fault] += 1
            return None
        ratio = min(max((voltage_v - limits.empty_v) / (limits.full_v - limits.empty_v), 0.0), 1.0)
        return Reading(current_a < -limits.discharging_a, voltage_v, current_a, ratio)

    def _fault(self, data: bytes, voltage_v: float, current_a: float) -> str | None:
        limits = self._limits
        span_v = limits.full_v - limits.empty_v
        if len(data) != 4:
            return "power_length"
        if data[3] & 1:  # overflow of the device's own arithmetic
            return "power_overflow"
        if not limits.empty_v - span_v <= voltage_v <= limits.full_v + span_v or abs(current_a) > LARGEST_CURRENT_A:
            return "power_range"
        return None if self._follows(voltage_v) else "power_step"

    def _follows(self, voltage_v: float) -> bool:
        """Whether a voltage follows from the last one, or several in a row agree on it."""
        if self._voltage_v is None or abs(voltage_v - self._voltage_v) <= LARGEST_STEP_V:
            self._voltage_v, self._step_v = voltage_v, []
            return True
        agreeing = [one for one in self._step_v if abs(one - voltage_v) <= LARGEST_STEP_V]
        self._step_v = [*agreeing[-STEPS:], voltage_v]
        if len(self._step_v) <= STEPS:
            return False
        self._voltage_v, self._step_v = voltage_v, []
        return True


class LowBattery:
    """Decides whether the battery is nearly empty: for a while, without a break, and not right after the start.

    Parameters
    ----------
    hold_ns : int
        [ns] Time below the threshold, without any reading above it.
    signal_ns : int
        [ns] Time on battery after which that of a supply without a voltage counts as nearly empty.
    armed_ns : int
        [ns] Time after the first reading before which it never is: a supply that always says so would otherwise switch
        the unit off at each start, before anyone could correct the settings.
    """

    def __init__(self, hold_ns: int, signal_ns: int, armed_ns: int) -> None:
        self._hold_ns, self._signal_ns, self._armed_ns = hold_ns, signal_ns, armed_ns
        self._first_ns: int | None = None
        self._since_ns: int | None = None
        self._last_ns = 0

    def update(self, reading: Reading, now_ns: int, low_ratio: float) -> bool:
        """Take a plausible reading; whether the battery is nearly empty."""
        if self._first_ns is None:
            self._first_ns = now_ns
        below = reading.on_battery and (reading.charge_ratio is None or reading.charge_ratio <= low_ratio)
        if not below:
            self._since_ns = None
        elif self._since_ns is None or now_ns - self._last_ns > self._hold_ns:  # a gap is no proof
            self._since_ns = now_ns
        self._last_ns = now_ns
        if self._since_ns is None or now_ns - self._first_ns < self._armed_ns:
            return False
        return now_ns - self._since_ns >= (self._signal_ns if reading.charge_ratio is None else self._hold_ns)

    def below_s(self, now_ns: int) -> float | None:
        """Time below the threshold; None above it."""
        return None if self._since_ns is None else (now_ns - self._since_ns) / NS
