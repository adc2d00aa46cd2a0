"""Turns readings of the supply into volts, amperes and share of charge, and says when the battery is nearly empty."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, Self

from pydantic import Field, model_validator

from shared.messages.base import Message, Tick
from shared.messages.power import LowReason, PowerEvent, PowerRaw, PowerState
from shared.runtime.config import Section

from .battery import NS, Autonomy, Decoder, Limits, LowBattery, Reading, SteadySupply, is_short

MAX_CONSUMPTION_W = 1000.0  # beyond it a shunt is wrong
SILENCE_TIMEOUT_NS = 5 * NS  # readings come every second


class Config(Section):
    """Settings of the parser of power; those of voltages are for a UPS with two lithium cells."""

    shunt_ohm: float = Field(default=0.1, gt=0.0, le=10.0, description="resistance of the shunt of the INA219")
    empty_v: float = Field(default=6.0, gt=0.0, le=60.0, description="voltage of the empty battery")
    full_v: float = Field(default=8.4, gt=0.0, le=60.0, description="voltage of the full battery")
    discharging_a: float = Field(
        default=0.05, ge=0.0, le=10.0, description="current out of the battery above which the unit runs on it"
    )
    discharging_sign: Literal["negative", "positive"] = Field(
        default="negative", description="sign of the current of the INA219 while the battery discharges"
    )
    mains_signal: Literal["1", "0"] = Field(default="1", description="what a signal states with mains")
    change_hold_s: float = Field(
        default=3.0,
        ge=0.0,
        le=60.0,
        description="time that mains, or their loss, must last until it counts: a current swings around zero at full "
        "charge, and a contact bounces",
    )
    low_charge_ratio: float = Field(
        default=0.1, ge=0.0, le=0.9, description="share of charge at which the battery is nearly empty"
    )
    low_autonomy_s: float = Field(
        default=0.0,
        ge=0.0,
        le=86400.0,
        description="time that the battery lasts, by its own fall, below which it counts as nearly empty as well; 0: "
        "its share of charge alone counts",
    )
    low_hold_s: float = Field(
        default=10.0,
        ge=3.0,
        le=600.0,
        description="time on battery below that share until it counts, and on mains until it does not any more",
    )
    signal_hold_s: float = Field(
        default=60.0,
        ge=3.0,
        le=86400.0,
        description="time on battery after which that of a supply without a voltage counts as nearly empty",
    )
    start_s: float = Field(
        default=120.0,
        ge=0.0,
        le=3600.0,
        description="time after the first reading in which the battery never counts as nearly empty, so that a wrong "
        "reading cannot switch the unit off at each start",
    )

    @model_validator(mode="after")
    def _has_a_span(self) -> Self:
        if self.full_v <= self.empty_v:
            raise ValueError("full_v must be above empty_v")
        return self


class Process:
    """One supply; time is taken from the stamps of the messages only."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self._config = config
        limits = Limits(
            config.shunt_ohm, config.empty_v, config.full_v, config.discharging_a,
            discharging_is_positive=config.discharging_sign == "positive", low_is_mains=config.mains_signal == "0",
        )  # fmt: skip
        self._decoder = Decoder(limits, self.rejects)
        self._low = LowBattery(
            round(config.low_hold_s * NS), round(config.signal_hold_s * NS), round(config.start_s * NS)
        )
        self._supply = SteadySupply(round(config.change_hold_s * NS))
        self._source: str | None = None
        self._reading: Reading | None = None  # the newest, with the state that lasts
        self._read_ns = 0
        self._is_low = False
        self._autonomy = Autonomy()
        self._left_s: float | None = None  # until the battery is low
        self._short = False  # it lasts less than is wanted

    def handle(self, message: Message) -> Iterator[PowerState | PowerEvent]:
        """Process a reading or a tick."""
        match message:
            case PowerRaw():
                yield from self._take(message)
            case Tick() if self._source is not None:
                yield self._state(message.now_ns)

    def _take(self, raw: PowerRaw) -> Iterator[PowerEvent]:
        if self._source not in (None, raw.source):
            self.rejects["too_many_sources"] += 1
            return
        self._source = raw.source
        reading = self._decoder.decode(raw)
        if reading is None:
            return
        was_low, first = self._is_low, self._supply.on_battery is None
        changed = self._supply.update(reading.on_battery, raw.received_ns)
        low_ratio = self._config.low_charge_ratio
        lasting = replace(reading, on_battery=self._supply.on_battery is True)
        self._left_s = self._autonomy.left_s(lasting, raw.received_ns, low_ratio)
        self._short = is_short(self._left_s, self._config.low_autonomy_s, was_low=was_low)
        self._is_low = self._low.update(reading, raw.received_ns, low_ratio, short=self._short)
        self._reading = reading = lasting
        self._read_ns = raw.received_ns
        if self._is_low is not was_low or (changed and (reading.on_battery or not first)):
            yield PowerEvent(
                sampled_ns=raw.received_ns, source=raw.source, on_battery=reading.on_battery, low=self._is_low,
                low_reason=self._low_reason(reading), reason=self._text(reading),
            )  # fmt: skip

    def _state(self, now_ns: int) -> PowerState:
        reading = self._reading
        if reading is None or now_ns - self._read_ns > SILENCE_TIMEOUT_NS:
            return PowerState(sampled_ns=now_ns, source=self._source or "", reason="no plausible reading of the supply")
        return PowerState(
            sampled_ns=now_ns, source=self._source or "", on_battery=reading.on_battery, since_ns=self._supply.since_ns,
            voltage_v=reading.voltage_v, current_a=reading.current_a, charge_ratio=reading.charge_ratio,
            low=self._is_low, low_reason=self._low_reason(reading), low_s=self._low.below_s(),
            reason=self._text(reading),
            consumption_w=_consumption_w(reading), autonomy_s=self._left_s,
        )  # fmt: skip

    def _low_reason(self, reading: Reading) -> LowReason | None:
        """Why the battery counts as nearly empty; None while it does not. Its share of charge comes first."""
        charge = reading.charge_ratio
        if not self._is_low:
            return None
        if charge is None:
            return LowReason.TIME
        return LowReason.AUTONOMY if self._short and charge > self._config.low_charge_ratio else LowReason.CHARGE

    def _text(self, reading: Reading) -> str:
        charge = reading.charge_ratio
        left = "" if charge is None else f", about {charge:.0%} left"
        if self._low_reason(reading) is LowReason.AUTONOMY:
            return f"battery lasts less than the {self._config.low_autonomy_s:.0f} s of low_autonomy_s{left}"
        if self._is_low:
            return f"battery nearly empty{left}"
        return f"on battery{left}" if reading.on_battery else f"mains{left.replace(' left', ' charged')}"


def _consumption_w(reading: Reading) -> float | None:
    """Power [W] out of the battery; None on mains, where the current is that of charging."""
    if not reading.on_battery or reading.voltage_v is None or reading.current_a is None:
        return None
    return min(max(0.0, -reading.voltage_v * reading.current_a), MAX_CONSUMPTION_W)
