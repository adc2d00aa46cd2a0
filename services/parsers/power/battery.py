"""Decodes readings of a supply, rejects what cannot be, and decides when the battery is nearly empty.

References
----------
Texas Instruments, INA219, SBOS448: tables 4 and 5. Shunt voltage in 10 µV, signed; bus voltage in 4 mV from bit 3 on.
"""

from collections import Counter
from dataclasses import dataclass

from shared.messages.power import PowerProtocol, PowerRaw

NS = 1_000_000_000
MAX_CURRENT_A = 20.0  # more than any supply of such a computer; a wrong shunt shows itself by it
# A battery does not change by more in a second under the load of such a computer: between idle and full load the
# voltage of two cells steps by about 0.3 V.
MAX_STEP_V = 1.0
SILENT_BUS = b"\xff\xff\xff\xff"  # no device answers: the lines stay high
SETTLING_NS = 60 * NS  # after the mains are lost, in which the voltage falls by the load alone
LEAST_USED = 0.02  # [-] of the charge, below which its fall is mostly noise of the voltage
LONGER = 1.2  # [-] share of the wanted time that a battery lasts by which it is not short of it any more
STEPS = 5  # readings in a row that confirm a voltage after a step


@dataclass(frozen=True)
class Limits:
    """What is plausible, and what is low."""

    shunt_ohm: float
    empty_v: float
    full_v: float
    discharging_a: float
    discharging_is_positive: bool = False  # sign of the current of the device while the battery discharges
    low_is_mains: bool = False  # a signal that is 0 with mains


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
            return Reading(on_battery=(text == b"0") is not self._limits.low_is_mains)
        limits = self._limits
        if len(raw.data) != len(SILENT_BUS):
            self._rejects["power_length"] += 1
            return None
        # The overflow bit is that of the device's own current and power, which are not read.
        shunt, bus = int.from_bytes(raw.data[:2], "big", signed=True), int.from_bytes(raw.data[2:], "big")
        voltage_v, current_a = (bus >> 3) * 0.004, shunt * 1e-5 / limits.shunt_ohm
        if limits.discharging_is_positive:
            current_a = -current_a
        if fault := self._fault(raw.data, voltage_v, current_a):
            self._rejects[fault] += 1
            return None
        ratio = min(max((voltage_v - limits.empty_v) / (limits.full_v - limits.empty_v), 0.0), 1.0)
        return Reading(current_a < -limits.discharging_a, voltage_v, current_a, ratio)

    def _fault(self, data: bytes, voltage_v: float, current_a: float) -> str | None:
        limits = self._limits
        span_v = limits.full_v - limits.empty_v
        if data == SILENT_BUS:
            return "power_silent"
        if not limits.empty_v - span_v <= voltage_v <= limits.full_v + span_v or abs(current_a) > MAX_CURRENT_A:
            return "power_range"
        return None if self._follows(voltage_v) else "power_step"

    def _follows(self, voltage_v: float) -> bool:
        """Whether a voltage follows from the last one, or several in a row agree on it."""
        if self._voltage_v is None or abs(voltage_v - self._voltage_v) <= MAX_STEP_V:
            self._voltage_v, self._step_v = voltage_v, []
            return True
        agreeing = [value for value in self._step_v if abs(value - voltage_v) <= MAX_STEP_V]
        self._step_v = [*agreeing[-STEPS:], voltage_v]
        if len(self._step_v) <= STEPS:
            return False
        self._voltage_v, self._step_v = voltage_v, []
        return True


class SteadySupply:
    """Whether the unit runs on its battery, by readings that agree for a while.

    At full charge a current swings around zero, and a contact bounces: the state changes when all readings of
    `hold_ns` contradict it.
    """

    def __init__(self, hold_ns: int) -> None:
        self._hold_ns = hold_ns
        self._contradicted_ns: int | None = None
        self.on_battery: bool | None = None  # None: before the first reading
        self.since_ns = 0

    def update(self, on_battery: bool, now_ns: int) -> bool:
        """Take a plausible reading; whether the state has changed."""
        if on_battery is self.on_battery:
            self._contradicted_ns = None
            return False
        if self._contradicted_ns is None:
            self._contradicted_ns = now_ns
        if self.on_battery is not None and now_ns - self._contradicted_ns < self._hold_ns:
            return False
        self.on_battery, self.since_ns, self._contradicted_ns = on_battery, self._contradicted_ns, None
        return True


class Autonomy:
    """How long the battery lasts, by how its charge has fallen since the mains were lost.

    Charge is estimated from the voltage, which falls at once by the load: the first minute on battery is left out.
    """

    def __init__(self) -> None:
        self._lost_ns: int | None = None
        self._begun: tuple[int, float] | None = None  # time and charge, a minute after the mains were lost

    def left_s(self, reading: Reading, now_ns: int, low_ratio: float) -> float | None:
        """Time until the charge is low [s]; None on mains, without a charge, or before it has fallen by 2 %."""
        charge = reading.charge_ratio
        if not reading.on_battery or charge is None:
            self._lost_ns = self._begun = None
            return None
        self._lost_ns = now_ns if self._lost_ns is None else self._lost_ns
        if self._begun is None and now_ns - self._lost_ns >= SETTLING_NS:
            self._begun = now_ns, charge
        if self._begun is None:
            return None
        begun_ns, begun = self._begun
        used = begun - charge
        if used < LEAST_USED:
            return None
        return max(charge - low_ratio, 0.0) / used * (now_ns - begun_ns) / NS


def is_short(left_s: float | None, wanted_s: float, *, was_low: bool) -> bool:
    """Whether a battery lasts less than is wanted; once it counts as low, until it lasts clearly longer.

    The time left is by a charge that is estimated from a voltage with noise.
    """
    return left_s is not None and left_s < (LONGER * wanted_s if was_low else wanted_s)


class LowBattery:
    """Decides whether the battery is nearly empty: for a while, and not right after the start.

    Seconds of mains take off as many seconds, so that mains which come back for moments, in which nothing is charged,
    do not hide an empty battery.

    Parameters
    ----------
    hold_ns : int
        [ns] Time on battery below the threshold, without any reading on battery above it; time on mains that ends it.
    signal_ns : int
        [ns] Time on battery after which that of a supply without a voltage counts as nearly empty.
    armed_ns : int
        [ns] Time after the first reading before which it never is: a supply that always says so would otherwise switch
        the unit off at each start, before anyone could correct the settings.
    """

    def __init__(self, hold_ns: int, signal_ns: int, armed_ns: int) -> None:
        self._hold_ns, self._signal_ns, self._armed_ns = hold_ns, signal_ns, armed_ns
        self._first_ns: int | None = None
        self._mains_ns: int | None = None  # since when the mains are there; None on battery
        self._below_ns: int | None = None  # time below the threshold, less that on mains; None above it
        self._last_ns = 0
        self._is_low = False

    def update(self, reading: Reading, now_ns: int, low_ratio: float, *, short: bool = False) -> bool:
        """Take a plausible reading; whether the battery is nearly empty, or `short` of the time that is wanted."""
        if self._first_ns is None:
            self._first_ns = now_ns
        elapsed_ns, self._last_ns = now_ns - self._last_ns, now_ns
        if elapsed_ns > self._hold_ns:  # a gap is no proof
            self._mains_ns, self._below_ns, self._is_low = None, None, False
        if reading.on_battery:
            above = not short and reading.charge_ratio is not None and reading.charge_ratio > low_ratio
            on_battery_before = self._mains_ns is None
            self._mains_ns = None
            if above:
                self._below_ns = None
            elif self._below_ns is None:
                self._below_ns = 0
            elif on_battery_before:
                self._below_ns += elapsed_ns
        else:
            self._mains_ns = now_ns if self._mains_ns is None else self._mains_ns
            if now_ns - self._mains_ns >= self._hold_ns:
                self._below_ns = None
            elif self._below_ns is not None:
                self._below_ns = max(self._below_ns - elapsed_ns, 0)
        needed_ns = self._signal_ns if reading.charge_ratio is None else self._hold_ns
        armed = now_ns - self._first_ns >= self._armed_ns
        self._is_low = self._below_ns is not None and armed and (self._is_low or self._below_ns >= needed_ns)
        return self._is_low

    def below_s(self) -> float | None:
        """Time below the threshold; None above it."""
        return None if self._below_ns is None else self._below_ns / NS
