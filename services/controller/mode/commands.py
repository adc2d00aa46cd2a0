"""Commands of the operator: accepted or not, done or failed, and why."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import degrees

from shared.chosen import receiver_of
from shared.messages.base import Message
from shared.messages.gnss import GnssConfigure, GnssFix, GnssReset, GnssStart
from shared.messages.navigation import NavigationSolution, NavigationState
from shared.messages.operation import (
    CommandStage,
    Crossing,
    CrossingEnd,
    ModeAnswer,
    ModeCommand,
    OperatorCommand,
)

from .configuration_exchange import ConfigurationExchange
from .crossing import CrossingLog
from .sources import Sources
from .unit import Unit, has_position

NS = 1_000_000_000
MAX_PENDING = 8  # commands that are in progress
RESTART_S = 10.0  # within which a receiver loses its position after a reset
FIRST_FIX_S = 300.0  # a cold start without assistance takes 30 s in the open, some minutes under trees
SELECT_S = 5.0  # within which a device that the operator wants sends a valid message
STANDSTILL_S = 10.0  # of standstill: biases of the gyroscopes are averaged over it
STAND_WITHIN_S = 60.0
# Output that a pending command gives at a message: an answer, and with it its end; None while it goes on.
Step = Callable[[Message], tuple[CommandStage, str] | None]
Output = ModeAnswer | GnssConfigure | GnssReset | Crossing


@dataclass
class PendingCommand:
    """A command in progress."""

    command: ModeCommand
    step: Step
    until_ns: int
    late: str  # why it has failed at that time


class CommandRejected(Exception):
    """A command that cannot be accepted; its text says why."""


class Commands:
    """Carries out commands by messages to other processes, and answers with what they lead to.

    Parameters
    ----------
    unit : Unit
        Devices and newest messages.
    exchange : callable
        Begins to configure a receiver with another navigation period [s].
    crossing : CrossingLog
        Ferry or train that carries the vehicle.
    """

    def __init__(
        self, unit: Unit, exchange: Callable[[str, float], ConfigurationExchange], crossing: CrossingLog
    ) -> None:
        self._unit, self._exchange, self._crossing = unit, exchange, crossing
        self._pending: dict[str, PendingCommand] = {}

    def take(self, command: ModeCommand) -> Iterator[Output]:
        """Accept or refuse a command; one that was taken before is not taken again."""
        if command.request_id in self._pending:
            return
        try:
            if len(self._pending) >= MAX_PENDING:
                raise CommandRejected(f"{MAX_PENDING} commands are in progress; wait for one of them")
            begin = BEGIN[command.command]
            pending, outputs = begin(self, command)
        except CommandRejected as why:
            yield self._answer(command, CommandStage.FAILED, str(why))
            return
        yield self._answer(command, CommandStage.ACCEPTED, "")
        yield from outputs
        if pending is not None:
            self._pending[command.request_id] = pending
        else:
            yield self._answer(command, CommandStage.DONE, "")

    def note(self, message: Message) -> Iterator[ModeAnswer]:
        """Let pending commands see a message."""
        for key, pending in list(self._pending.items()):
            ended = pending.step(message)
            if ended is None and self._unit.now_ns >= pending.until_ns:
                ended = CommandStage.FAILED, pending.late
            if ended is not None:
                del self._pending[key]
                yield self._answer(pending.command, *ended)

    def _answer(self, command: ModeCommand, stage: CommandStage, reason: str) -> ModeAnswer:
        return ModeAnswer(
            sampled_ns=self._unit.now_ns, request_id=command.request_id, command=command.command, stage=stage,
            reason=reason[:400],
        )  # fmt: skip

    def _until(self, span_s: float) -> int:
        return self._unit.now_ns + round(span_s * NS)

    def _receiver(self, command: ModeCommand) -> str:
        """Receiver that a command names, or the one in use."""
        unit = self._unit
        known = unit.receivers.names(unit.now_ns)
        if command.source is not None:
            if receiver_of(command.source) not in known:
                raise CommandRejected(
                    f"no receiver {command.source} is received; received are: {', '.join(known) or 'none'}"
                )
            return receiver_of(command.source)
        chosen = unit.gnss.chosen
        if chosen is None and len(known) != 1:
            raise CommandRejected(
                "no receiver is in use; name one with its source" if known else "no receiver is received"
            )
        return receiver_of(chosen) if chosen is not None else known[0]

    def _reset(self, command: ModeCommand) -> tuple[PendingCommand, list[Output]]:
        unit, receiver, start_ns = self._unit, self._receiver(command), self._unit.now_ns
        said = unit.said
        if (
            said is not None
            and said.source == receiver
            and not any(message.startswith("UBX") for message in said.messages)
        ):
            raise CommandRejected(f"{receiver} sends no UBX, and takes no such command: switch it off and on instead")
        unit.search_again()
        is_lost = False

        def step(message: Message) -> tuple[CommandStage, str] | None:
            nonlocal is_lost
            if not isinstance(message, GnssFix) or receiver_of(message.source) != receiver:
                return None
            span_s = (unit.now_ns - start_ns) / NS
            if not has_position(message):
                is_lost = True
            elif is_lost:
                return CommandStage.DONE, f"position after {span_s:.0f} s"
            elif span_s > RESTART_S:
                return CommandStage.FAILED, f"{receiver} did not restart: it goes on with its position"
            return None

        reset = GnssReset(request_id=command.request_id, source=receiver, start=STARTS[command.command])
        late = f"{receiver} has no position {FIRST_FIX_S:.0f} s after its start: give its antenna a view of the sky"
        return PendingCommand(command, step, self._until(FIRST_FIX_S), late), [reset]

    def _rate(self, command: ModeCommand) -> tuple[PendingCommand, list[Output]]:
        if command.navigation_period_s is None:
            raise CommandRejected("name the period of fixes")
        exchange = self._exchange(self._receiver(command), command.navigation_period_s)

        def step(_: Message) -> tuple[CommandStage, str] | None:
            if exchange.fault is not None:
                return CommandStage.FAILED, exchange.fault
            return (CommandStage.DONE, "") if exchange.configuring is None else None

        outputs = list(exchange.start(self._unit.now_ns))
        return PendingCommand(command, step, self._until(FIRST_FIX_S), "the receiver did not answer"), [*outputs]

    def _select(self, command: ModeCommand) -> tuple[PendingCommand | None, list[Output]]:
        unit = self._unit
        kinds = unit.gnss, unit.imu, unit.speed
        if command.source is None:
            for sources in kinds:
                sources.wanted = None
            return None, []
        wanted: Sources | None = next((kind for kind in kinds if command.source in kind.names(unit.now_ns)), None)
        if wanted is None:
            known = ", ".join(name for kind in kinds for name in kind.names(unit.now_ns)) or "none"
            raise CommandRejected(f"no device {command.source} is received; received are: {known}")
        wanted.wanted = command.source

        def step(_: Message) -> tuple[CommandStage, str] | None:
            return (CommandStage.DONE, "") if wanted.choose(unit.now_ns) == command.source else None

        late = f"{command.source} sends no valid message; it is used as soon as it does"
        return PendingCommand(command, step, self._until(SELECT_S), late), []

    def _calibrate(self, command: ModeCommand) -> tuple[PendingCommand, list[Output]]:
        """The filter measures the biases at each standstill; wait until one was long enough."""
        since_ns: int | None = None

        def step(message: Message) -> tuple[CommandStage, str] | None:
            nonlocal since_ns
            if not isinstance(message, NavigationSolution):
                return None
            if not message.stationary or message.gyroscope_bias_sd_rad_s is None:
                since_ns = None
                return None
            since_ns = message.sampled_ns if since_ns is None else since_ns
            if message.sampled_ns - since_ns < STANDSTILL_S * NS:
                return None
            sd = max(message.gyroscope_bias_sd_rad_s)
            return CommandStage.DONE, f"gyroscope biases known to {degrees(sd):.2g} degrees a second"

        late = (
            f"the vehicle did not stand for {STANDSTILL_S:.0f} s within {STAND_WITHIN_S:.0f} s, "
            "or no inertial unit runs"
        )
        return PendingCommand(command, step, self._until(STAND_WITHIN_S), late), []

    def _confirm(self, command: ModeCommand) -> tuple[PendingCommand, list[Output]]:
        """The filter takes the command itself; wait until its level holds nothing any more."""

        def step(message: Message) -> tuple[CommandStage, str] | None:
            if not isinstance(message, NavigationState):
                return None
            if message.conflict_since_ns is not None or message.exclusion_declined_code is not None:
                return (
                    CommandStage.FAILED,
                    "GNSS contradicts other sensors now: the position cannot be confirmed",
                )
            return (CommandStage.DONE, "the level holds no offset") if message.held_code is None else None

        late = "no state of the filter, or it still holds an offset"
        return PendingCommand(command, step, self._until(SELECT_S), late), []

    def _begin_crossing(self, _: ModeCommand) -> tuple[PendingCommand | None, list[Output]]:
        if self._crossing.since_ns is not None:
            raise CommandRejected("a crossing is open already; end it first")
        return None, [self._crossing.begin(self._unit.now_ns)]

    def _end_crossing(self, _: ModeCommand) -> tuple[PendingCommand | None, list[Output]]:
        if self._crossing.since_ns is None:
            raise CommandRejected("no crossing is open: the wheels may have turned for 100 m, which closes it")
        return None, [self._crossing.end(self._unit.now_ns, CrossingEnd.DRIVER)]


STARTS = {OperatorCommand.COLD_START: GnssStart.COLD, OperatorCommand.WARM_START: GnssStart.WARM}
BEGIN: dict[OperatorCommand, Callable[[Commands, ModeCommand], tuple[PendingCommand | None, list[Output]]]] = {
    OperatorCommand.COLD_START: Commands._reset,
    OperatorCommand.WARM_START: Commands._reset,
    OperatorCommand.NAVIGATION_RATE: Commands._rate,
    OperatorCommand.SELECT_SOURCE: Commands._select,
    OperatorCommand.CALIBRATE_AT_REST: Commands._calibrate,
    OperatorCommand.CONFIRM_POSITION: Commands._confirm,
    OperatorCommand.CROSSING_BEGIN: Commands._begin_crossing,
    OperatorCommand.CROSSING_END: Commands._end_crossing,
}
