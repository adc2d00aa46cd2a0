"""Readings in SI units, and a unit that is never switched off by a supply that lies."""

import random

import pytest
from pydantic import ValidationError

from services.parsers.power.battery import is_short
from services.parsers.power.process import Config, Process
from shared.messages.base import Tick
from shared.messages.power import LowReason, PowerEvent, PowerProtocol, PowerRaw, PowerState
from tests.support.cases import each

S = 1_000_000_000


def ina219(voltage_v: float, current_a: float, shunt_ohm: float = 0.1) -> bytes:
    return round(current_a * shunt_ohm / 1e-5).to_bytes(2, "big", signed=True) + (
        round(voltage_v / 0.004) << 3
    ).to_bytes(2, "big")


class Run:
    """A parser that is given one reading a second."""

    def __init__(self, config: Config | None = None, protocol: PowerProtocol = PowerProtocol.INA219) -> None:
        self.process, self.protocol = Process(config or Config()), protocol
        self.at_s = 1000
        self.events: list[PowerEvent] = []

    def read(self, data: bytes, times: int = 1) -> PowerState:
        state = None
        for _ in range(times):
            self.at_s += 1
            raw = PowerRaw(received_ns=self.at_s * S, source="ups", data=data, protocol=self.protocol)
            self.events += [out for out in self.process.handle(raw) if isinstance(out, PowerEvent)]
            (state,) = self.process.handle(Tick(now_ns=self.at_s * S))
        assert isinstance(state, PowerState)
        return state


def test_registers_of_the_data_sheet_give_volts_and_amperes() -> None:
    """SBOS448, example of table 8: a bus voltage of 0x5D98 is 11.98 V, a shunt voltage of 0x07D0 is 20 mV: 10 A."""
    config = Config(empty_v=9.0, full_v=12.6, shunt_ohm=0.002)
    state = Run(config).read(bytes.fromhex("07D05D98"))
    assert state.voltage_v == pytest.approx(11.98, abs=0.004) and state.current_a == pytest.approx(10.0)
    assert state.on_battery is False and state.charge_ratio == pytest.approx((11.98 - 9.0) / 3.6, abs=0.002)


def test_the_loss_of_the_mains_is_an_event_with_its_time_and_the_share_left() -> None:
    run = Run()
    run.read(ina219(8.3, 0.2), 5)
    assert not run.read(ina219(7.8, -1.0), 3).on_battery
    state = run.read(ina219(7.8, -1.0))
    assert state.on_battery and not state.low and state.since_ns == 1006 * S
    assert state.reason == "on battery, about 75% left"
    run.read(ina219(8.0, 0.5), 4)
    assert [(event.on_battery, event.low) for event in run.events] == [(True, False), (False, False)]


def test_a_battery_that_runs_empty_is_low_after_ten_seconds_and_no_more_when_the_mains_are_back() -> None:
    run = Run()
    run.read(ina219(8.3, 0.2), 130)
    for voltage in (7.8, 7.2, 6.6):
        assert not run.read(ina219(voltage, -1.0), 20).low
    assert not run.read(ina219(6.2, -1.0), 10).low
    state = run.read(ina219(6.2, -1.0))
    assert state.low and state.low_s == 10.0 and "nearly empty" in state.reason
    assert run.read(ina219(6.4, 0.5), 10).low
    assert not run.read(ina219(6.4, 0.5)).low
    found = [(event.on_battery, event.low) for event in run.events]
    assert found == [(True, False), (True, True), (False, True), (False, False)]


def test_one_reading_above_the_threshold_restarts_the_time() -> None:
    run = Run()
    run.read(ina219(7.0, -1.0), 130)
    for _ in range(20):
        assert not run.read(ina219(6.2, -1.0), 9).low
        run.read(ina219(6.4, -1.0))


LIES = {
    "silence of the bus": (b"\xff\xff\xff\xff", "power_silent"),
    "zeros": (bytes(4), "power_range"),
    "far too low": (ina219(2.0, -1.0), "power_range"),
    "far too high": (ina219(20.0, -1.0), "power_range"),
    "impossible current": (b"\x80\x00" + ina219(7.0, 0.0)[2:], "power_range"),
    "too short": (b"\x01\x02", "power_length"),
    "empty": (b"", "power_length"),
    "of hostile size": (b"\x7f" * 1000, "power_length"),
    "of the size of a batch": (bytes(100_000), "power_length"),
}


@each("name", LIES)
def test_what_cannot_be_is_a_counted_reject_and_never_low(name: str) -> None:
    data, kind = LIES[name]
    run = Run(Config(start_s=0.0, shunt_ohm=0.01))
    run.read(ina219(8.0, 1.0, 0.01), 10)
    states = [run.read(data) for _ in range(60)]
    assert run.process.rejects == {kind: 60} and not any(state.low for state in states)
    assert states[-1].on_battery is None and states[-1].reason == "no plausible reading of the supply"


def test_a_step_to_empty_must_be_confirmed_by_readings_that_agree() -> None:
    run = Run()
    run.read(ina219(8.3, 0.2), 130)
    run.read(ina219(6.1, -1.0), 5)
    assert run.process.rejects == {"power_step": 5}
    chance = random.Random(1)
    assert not any(run.read(ina219(chance.choice((5.0, 6.1, 9.5)), -1.0)).low for _ in range(200))
    run.read(ina219(6.1, -1.0), 6)
    assert run.read(ina219(6.1, -1.0), 11).low  # it is true after all


def test_a_supply_that_always_says_low_switches_nothing_off_in_the_first_two_minutes() -> None:
    run = Run()
    assert not run.read(ina219(6.1, -1.0), 120).low and run.read(ina219(6.1, -1.0)).low


def test_a_gap_in_the_readings_is_no_proof() -> None:
    run = Run()
    run.read(ina219(6.1, -1.0), 130)
    run.at_s += 60
    assert not run.read(ina219(6.1, -1.0), 10).low and run.read(ina219(6.1, -1.0)).low


def test_a_signal_without_a_voltage_is_low_after_a_minute_on_battery() -> None:
    run = Run(protocol=PowerProtocol.SIGNAL)
    run.read(b"1\n", 130)
    assert not run.read(b"0\n", 60).low
    state = run.read(b"0\n")
    assert state.low and state.charge_ratio is None and state.voltage_v is None
    run.read(b"unknown", 3)
    assert run.process.rejects == {"power_signal": 3}


def test_the_overflow_bit_is_that_of_registers_that_are_not_read() -> None:
    """SBOS448, bus voltage register: OVF says that the current and power calculations are out of range."""
    data = ina219(7.0, -2.5)
    state = Run().read(data[:3] + bytes([data[3] | 1]), 5)
    assert (state.voltage_v, state.current_a) == pytest.approx((7.0, -2.5)) and state.on_battery


def test_the_direction_of_the_current_is_a_setting() -> None:
    run = Run(Config(discharging_sign="positive"))
    assert run.read(ina219(8.3, -0.3), 130).on_battery is False
    state = run.read(ina219(7.6, 1.0), 5)
    assert state.on_battery and state.current_a == pytest.approx(-1.0)
    assert run.read(ina219(6.9, 1.0), 5) and run.read(ina219(6.1, 1.0), 15).low


def test_the_level_of_a_signal_is_a_setting() -> None:
    run = Run(Config(mains_signal="0"), PowerProtocol.SIGNAL)
    state = run.read(b"0\n", 130)
    assert state.on_battery is False and not state.low
    assert run.read(b"1\n", 70).low


@pytest.mark.parametrize(
    ("readings", "protocol"),
    [
        ((ina219(8.35, 0.03), ina219(8.35, -0.06)), PowerProtocol.INA219),
        ((b"1\n", b"0\n"), PowerProtocol.SIGNAL),
        ((b"0\n", b"0\n", b"1\n"), PowerProtocol.SIGNAL),
    ],
)
def test_a_supply_that_swings_is_a_few_events(readings: tuple[bytes, ...], protocol: PowerProtocol) -> None:
    run = Run(protocol=protocol)
    for k in range(120):
        run.read(readings[k % len(readings)])
    assert len(run.events) <= 3


@pytest.mark.parametrize("mains_s", [1, 2, 3])
def test_moments_of_mains_do_not_hide_an_empty_battery(mains_s: int) -> None:
    """Of nine seconds some are mains, which charge nothing; the voltage is higher in them."""
    run = Run()
    run.read(ina219(8.3, 0.3), 130)
    lows = []
    for volts in (7.6, 6.9, *[6.1] * 20):
        run.read(ina219(volts, -1.0), 9 - mains_s)
        lows.append(run.read(ina219(volts + 0.4, 0.5), mains_s).low)
    assert not any(lows[:2]) and lows[15:] == [True] * 7
    assert not run.read(ina219(6.6, 0.8), 11).low


def test_moments_of_battery_on_mains_are_no_empty_battery() -> None:
    run = Run(protocol=PowerProtocol.SIGNAL)
    states = [run.read(b"0\n" if k % 9 in (0, 1) else b"1\n") for k in range(600)]
    assert not any(state.low for state in states)


def test_a_battery_without_a_span_is_a_wrong_configuration() -> None:
    with pytest.raises(ValidationError, match="full_v must be above empty_v"):
        Config(empty_v=8.0, full_v=8.0)


def test_consumption_and_autonomy_are_those_of_the_battery_that_empties() -> None:
    """0.5 A at 8 V down to 7 V; the charge falls linearly, to 10 % after a stated time."""
    run = Run()
    state = run.read(ina219(8.4, 0.2), 130)
    assert state.consumption_w is None and state.autonomy_s is None
    for second in range(1200):
        state = run.read(ina219(8.4 - 2.4 * second / 6000.0, -0.5))
    assert state.consumption_w == pytest.approx(0.5 * (8.4 - 2.4 * 1199 / 6000.0), abs=0.01)
    assert state.autonomy_s == pytest.approx(0.9 * 6000.0 - 1199.0, rel=0.03)
    assert run.read(ina219(8.0, 0.2), 5).autonomy_s is None


def test_a_battery_that_lasts_less_than_is_wanted_counts_as_nearly_empty() -> None:
    lows = {}
    for wanted_s in (0.0, 3600.0):
        run = Run(Config(low_autonomy_s=wanted_s))
        run.read(ina219(8.4, 0.2), 130)
        for second in range(3000):
            state = run.read(ina219(8.4 - 2.4 * second / 6000.0, -0.5))
            if state.low:
                break
        lows[wanted_s] = second
    assert lows[0.0] == 2999, "half of the charge is left"
    assert 5400 - 3600 < lows[3600.0] < 5400 - 3600 + 60


def test_a_battery_that_lasts_less_than_is_wanted_has_its_own_reason_and_noise_does_not_change_it() -> None:
    """Noise of 1 % of the charge moves the time left by minutes around the limit."""
    rng = random.Random(1)
    run = Run(Config(low_autonomy_s=3600.0))
    run.read(ina219(8.4, 0.2), 130)
    for second in range(3000):
        state = run.read(ina219(8.4 - 2.4 * second / 6000.0 + rng.gauss(0.0, 0.024), -0.5))
    assert state.low and "nearly empty" not in state.reason and "less than the 3600 s" in state.reason
    assert state.low_reason is LowReason.AUTONOMY
    assert [event.low_reason for event in run.events if event.low] == [LowReason.AUTONOMY]
    changes = [event.low for event in run.events if event.on_battery]
    assert changes == [False, True], "low once"
    for _ in range(3000):
        second += 1
        state = run.read(ina219(8.4 - 2.4 * second / 6000.0, -0.5))
    assert "nearly empty" in state.reason and state.low_reason is LowReason.CHARGE
    state = run.read(ina219(8.2, 0.5), 20)
    assert not state.low and state.low_reason is None


@pytest.mark.parametrize(
    ("left_s", "was_low", "short"),
    [(99.0, False, True), (101.0, False, False), (119.0, True, True), (121.0, True, False), (None, True, False)],
)
def test_the_limit_of_the_time_left_has_hysteresis(left_s: float | None, *, was_low: bool, short: bool) -> None:
    assert is_short(left_s, 100.0, was_low=was_low) is short
