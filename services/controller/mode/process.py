"""Decides what the unit should be doing now, configures receivers, and keeps the last position."""

from collections.abc import Iterator

from pydantic import Field

from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import LastPosition, NavigationSolution
from shared.messages.operation import Mode, ModeState
from shared.runtime.config import Section

from .dialogue import Dialogue
from .last_position import PositionKeeper
from .unit import Unit

Output = ModeState | GnssConfigure | LastPosition


class Config(Section):
    """Settings of the controller."""

    configure_gnss: bool = True  # False: the receiver stays as it is
    navigation_period_s: float = Field(default=1.0, gt=0.0)
    gnss_messages: tuple[str, ...] = ("NAV-PVT", "NAV-DOP", "NAV-COV", "NAV-SAT", "NAV-EOE")
    # A receiver that refuses them stays with the others.
    optional_gnss_messages: tuple[str, ...] = ("RXM-RAWX", "RXM-SFRBX")
    last_position_period_s: float = Field(default=10.0, gt=0.0)


class Process:
    """The state machine of `rules.py`, fed with what `unit.py` remembers."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._unit = Unit()
        self._dialogues: dict[str, Dialogue] = {}
        self._keeper = PositionKeeper(config.last_position_period_s)
        self._state: ModeState | None = None

    def handle(self, message: Message) -> Iterator[Output]:
        """Take any message; decide anew, and say so if the mode or a source has changed, or a second has passed."""
        appeared = self._unit.note(message)
        match message:
            case GnssFix() if appeared and self._config.configure_gnss:
                yield from self._dialogue(appeared).start(self._unit.now_ns)
            case GnssConfiguration():
                if dialogue := self._dialogues.get(message.source):
                    dialogue.answer(message, self._unit.now_ns)
            case NavigationSolution():
                yield from self._keeper.take(message, self._unit.utc_offset_ns)
            case Tick():
                for dialogue in self._dialogues.values():
                    yield from dialogue.tick(self._unit.now_ns)
        known = isinstance(message, ImuSamples) and self._state is not None and self._state.imu_source is not None
        if self._unit.started_ns is not None and not known:  # a hundred samples a second change nothing
            yield from self._decide(at_once=isinstance(message, Tick))

    def close(self) -> Iterator[Output]:
        """Say the last words: where the vehicle is, and that the unit shuts down."""
        yield from self._keeper.last(self._unit.utc_offset_ns)
        yield self._unit.describe(Mode.SHUTTING_DOWN, "told to stop", self._state)

    def _decide(self, *, at_once: bool) -> Iterator[ModeState]:
        configuring = next((d.configuring for d in self._dialogues.values() if d.configuring), None)
        fault = next((d.fault for d in self._dialogues.values() if d.fault), None)
        before, state = self._state, self._unit.mode_state(self._unit.facts(configuring, fault), self._state)
        self._state = state
        if at_once or before is None or _essence(before) != _essence(state):
            yield state

    def _dialogue(self, source: str) -> Dialogue:
        return self._dialogues.setdefault(
            source,
            Dialogue(
                source,
                self._config.navigation_period_s,
                self._config.gnss_messages,
                self._config.optional_gnss_messages,
            ),
        )


def _essence(state: ModeState) -> tuple[str | None, ...]:
    return state.mode, state.gnss_source, state.imu_source, state.speed_source
