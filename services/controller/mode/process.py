"""Determines the operating mode, configures GNSS receivers, and stores the last position."""

from collections.abc import Iterator

from pydantic import Field

from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssFix, GnssOutput, GnssReceiver, GnssReset
from shared.messages.imu import ImuSamples
from shared.messages.navigation import LastPosition, NavigationSolution
from shared.messages.operation import Crossing, ModeAnswer, ModeCommand, ModeState
from shared.messages.vehicle import VehicleSpeed
from shared.runtime.config import Section

from .commands import Commands
from .configuration_exchange import ConfigurationExchange
from .crossing import CrossingLog
from .last_position import LastPositionWriter
from .unit import Decision, Unit

Output = ModeState | ModeAnswer | GnssConfigure | GnssReset | LastPosition | Crossing


class Config(Section):
    """Settings of the controller."""

    configure_gnss: bool = Field(
        default=True, description="whether the GNSS receiver is configured; false: its configuration is left unchanged"
    )
    navigation_period_s: float = Field(
        default=1.0, gt=0.0, description="navigation period requested from the GNSS receiver"
    )
    gnss_outputs: tuple[GnssOutput, ...] = Field(
        default=(
            GnssOutput.FIX, GnssOutput.DILUTION, GnssOutput.COVARIANCE, GnssOutput.SATELLITES,
            GnssOutput.RAW_MEASUREMENTS, GnssOutput.NAVIGATION_BITS, GnssOutput.INTERFERENCE, GnssOutput.CLOCK,
            GnssOutput.SIGNALS, GnssOutput.LEVELS,
        ),
        description="what the GNSS receiver is asked to tell; it sends the rest even if it has not all of it",
    )  # fmt: skip
    gnss_dynamic_model: str = Field(
        default="automotive",
        max_length=64,
        description="motion that the GNSS receiver is told to expect, as automotive or stationary; empty: as it is",
    )
    last_position_period_s: float = Field(
        default=10.0, gt=0.0, description="period at which the last position is stored"
    )


class Process:
    """Applies the rules of `rules.py` to the facts of `unit.py`."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._unit = Unit()
        self._exchanges: dict[str, ConfigurationExchange] = {}
        self._last_position = LastPositionWriter(config.last_position_period_s)
        self._crossing = CrossingLog()
        self._commands = Commands(self._unit, self._exchange_at, self._crossing)
        self._state: ModeState | None = None

    def handle(self, message: Message) -> Iterator[Output]:
        """Process a message; yield the mode each second, and when the mode or a selected source has changed."""
        appeared = self._unit.note(message)
        match message:
            case GnssFix() | GnssReceiver() if appeared and self._config.configure_gnss:
                yield from self._exchange(appeared).start(self._unit.now_ns)
            case GnssConfiguration():
                if exchange := self._exchanges.get(message.source):
                    exchange.response(message, self._unit.now_ns)
            case NavigationSolution():
                yield from self._last_position.take(message, self._unit.utc_offset_ns)
            case ModeCommand():
                yield from self._commands.take(message)
            case Crossing() | VehicleSpeed():
                yield from self._follow_crossing(message)
            case Tick():
                for exchange in self._exchanges.values():
                    yield from exchange.tick(self._unit.now_ns)
                yield from self._crossing.keep(self._unit.now_ns)
        yield from self._commands.note(message)
        known = isinstance(message, ImuSamples) and self._state is not None and self._state.imu_source is not None
        if self._unit.started_ns is not None and not known:  # IMU samples at 100 Hz need no decision each
            yield from self._decide(at_once=isinstance(message, Tick))

    def _follow_crossing(self, message: Crossing | VehicleSpeed) -> Iterator[Crossing]:
        if isinstance(message, Crossing):
            yield from self._crossing.adopt(message, self._unit.now_ns)
        elif message.source == self._unit.speed.chosen:
            yield from self._crossing.use_speed(message, self._unit.now_ns)

    def close(self) -> Iterator[Output]:
        """Yield the last position and the mode "shutting down"."""
        yield from self._last_position.last(self._unit.utc_offset_ns)
        yield self._unit.describe(self._unit.ended("stop requested"), self._state)

    def _decide(self, *, at_once: bool) -> Iterator[ModeState | LastPosition]:
        configuring = next((d.configuring for d in self._exchanges.values() if d.configuring), None)
        fault = next((d.fault for d in self._exchanges.values() if d.fault), None)
        before, decision = self._state, self._unit.decided(self._unit.facts(configuring, fault))
        if not at_once and before is not None and _is_of(before, decision):
            return
        self._state = self._unit.describe(decision, before)
        yield self._state
        if decision.power_off and not (before and before.power_off):
            yield from self._last_position.last(self._unit.utc_offset_ns)

    def _exchange_at(self, source: str, period_s: float) -> ConfigurationExchange:
        """Exchange with another navigation period, in place of the one before."""
        config = self._config
        made = ConfigurationExchange(source, period_s, config.gnss_outputs, config.gnss_dynamic_model or None)
        self._exchanges[source] = made
        return made

    def _exchange(self, source: str) -> ConfigurationExchange:
        return self._exchanges.setdefault(
            source,
            ConfigurationExchange(
                source,
                self._config.navigation_period_s,
                self._config.gnss_outputs,
                self._config.gnss_dynamic_model or None,
            ),
        )


def _is_of(state: ModeState, decision: Decision) -> bool:
    """Whether a state says the mode and the sources of a decision."""
    sources = state.gnss_source, state.imu_source, state.speed_source
    return state.mode is decision.mode and sources == decision.sources
