"""The newest messages of the unit, and the facts for the mode decision derived from them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from shared.chosen import NMEA, SILENCE_TIMEOUT_NS, receiver_of
from shared.messages.base import Message, Tick
from shared.messages.gnss import FixType, GnssFix, GnssReceiver
from shared.messages.imu import ImuSamples
from shared.messages.navigation import NavigationSolution, NavigationState
from shared.messages.operation import Mode, ModeState
from shared.messages.power import LowReason, PowerState
from shared.messages.vehicle import VehicleSpeed
from shared.protocols.registry import BY_NAME

from .rules import FUSION_SILENT_S, GNSS_SILENT_S, IMU_SILENT_S, SOLUTION_SILENT_S, Facts, decide
from .sources import Sources, age_s

NS = 1_000_000_000
SPEED_SILENT_S = SILENCE_TIMEOUT_NS / NS
RECEIVER_SILENT_S = 6.0  # a statement comes every two seconds
LISTED = 6
POWER_SILENT_S = 5.0  # a state comes every second


Chosen = tuple[str | None, str | None, str | None]  # names of the GNSS, inertial and speed sources in use


class Decision(NamedTuple):
    """Mode of the unit, the sources that it uses, and why."""

    mode: Mode
    sources: Chosen
    reason: str
    power_off: bool = False
    power_off_reason: LowReason | None = None


@dataclass(slots=True)
class Unit:
    """The newest message of each kind; the time is the latest stamp received."""

    now_ns: int = 0
    started_ns: int | None = None
    receivers: Sources = field(default_factory=lambda: Sources(GNSS_SILENT_S))
    gnss: Sources = field(default_factory=lambda: Sources(GNSS_SILENT_S, "gnss"))  # UBX and NMEA of a receiver are two
    imu: Sources = field(default_factory=lambda: Sources(IMU_SILENT_S, "imu"))
    speed: Sources = field(default_factory=lambda: Sources(SPEED_SILENT_S, "speed", by_name=True))
    fix_ns: int | None = None
    said: GnssReceiver | None = None  # of the receiver that was heard last
    search_ns: int | None = None  # since when a receiver looks for its first position
    first_fix_s: float | None = None  # time that it took
    restarting: bool = False  # a receiver was reset, and has not lost its position yet
    utc_offset_ns: int | None = None  # UTC - OBU time line
    solution: NavigationSolution | None = None
    solution_ns: int | None = None
    state: NavigationState | None = None
    fusion_ns: int | None = None
    has_measured: bool = False
    power: PowerState | None = None

    def note(self, message: Message) -> str | None:
        """Store a message; return the name of the receiver if it is new or was silent, otherwise None."""
        match message:
            case Tick():
                self._advance(message.now_ns)
            case ImuSamples():
                self._advance(message.received_ns)
                self.imu.note_received(message.source, self.now_ns, valid=not message.saturated)
            case VehicleSpeed():
                self._advance(message.received_ns)
                self.speed.note_received(message.source, self.now_ns)
            case GnssFix():
                return self._note_fix(message)
            case GnssReceiver() if self.started_ns is not None:  # one that the broker kept may be of yesterday
                return self._note_receiver(message)
            case PowerState():
                self._advance(message.sampled_ns)
                self.power = message
            case NavigationSolution():
                self._advance(message.sampled_ns)
                self.solution, self.solution_ns = message, self.now_ns
                self.fusion_ns = self.now_ns
            case NavigationState():
                if self.started_ns is not None:  # one that the broker kept may be of yesterday: it starts no clock
                    self._advance(message.sampled_ns)
                self.state, self.fusion_ns = message, max(self.fusion_ns or message.sampled_ns, message.sampled_ns)
        return None

    def facts(self, configuring: str | None, configuration_fault: str | None) -> Facts:
        """Derive the facts at the current time."""
        solution_age_s, fusion_age_s = age_s(self.solution_ns, self.now_ns), age_s(self.fusion_ns, self.now_ns)
        state = self.state if fusion_age_s is not None and fusion_age_s <= FUSION_SILENT_S else None
        phase = state.phase if state else None
        if self.solution and solution_age_s is not None and solution_age_s <= SOLUTION_SILENT_S:
            phase = self.solution.phase  # published more often than the state
        return Facts(
            uptime_s=age_s(self.started_ns, self.now_ns) or 0.0,
            imu_age_s=self.imu.age_s(self.now_ns),
            gnss_age_s=self.gnss.age_s(self.now_ns),
            fix_age_s=age_s(self.fix_ns, self.now_ns),
            receiver=self._receiver_sends(),
            solution_age_s=solution_age_s,
            fusion_age_s=fusion_age_s,
            phase=phase,
            phase_reason=state.reason if state else "",
            configuring=configuring,
            configuration_fault=configuration_fault,
            has_measured=self.has_measured,
        )

    def decided(self, facts: Facts) -> Decision:
        """Determine the mode and select the sources."""
        if reason := self.power_ends():
            cause = self.power.low_reason if self.power is not None else None
            return Decision(Mode.SHUTTING_DOWN, self._chosen(), reason, power_off=True, power_off_reason=cause)
        mode, reason = decide(facts)
        self.has_measured |= mode is Mode.MEASURING or facts.is_gnss_only
        return Decision(mode, self._chosen(), reason)

    def ended(self, reason: str) -> Decision:
        """Decision of a controller that is stopped."""
        return Decision(Mode.SHUTTING_DOWN, self._chosen(), reason)

    def _chosen(self) -> Chosen:
        return self.gnss.choose(self.now_ns), self.imu.choose(self.now_ns), self.speed.choose(self.now_ns)

    def power_ends(self) -> str | None:
        """Reason for which the host is to be switched off; None while it has power, or nothing is known of it."""
        power = self.power
        if power is None or not power.low or (age_s(power.sampled_ns, self.now_ns) or 0.0) > POWER_SILENT_S:
            return None
        return f"{power.source}: {power.reason}"

    def describe(self, decision: Decision, before: ModeState | None) -> ModeState:
        """Create the message of a decision; `since_ns` is kept from the previous state if the mode is unchanged."""
        kinds, mode = (self.gnss, self.imu, self.speed), decision.mode
        gnss, imu, speed = decision.sources
        return ModeState(
            sampled_ns=self.now_ns,
            mode=mode,
            since_ns=before.since_ns if before and before.mode is mode else self.now_ns,
            reason=decision.reason[:400],
            gnss_source=gnss,
            imu_source=imu,
            speed_source=speed,
            time_to_first_fix_s=self.first_fix_s,
            sources=tuple(name for kind in kinds for name in kind.names(self.now_ns)),
            switches=tuple(
                sorted(
                    (switch for kind in kinds for switch in kind.switches),
                    key=lambda source_switch: source_switch.sampled_ns,
                )
            ),
            power_off=decision.power_off or None,
            power_off_reason=decision.power_off_reason,
        )

    def search_again(self) -> None:
        """Measure the time to the first position anew: a receiver was reset."""
        self.search_ns, self.first_fix_s, self.restarting = self.now_ns, None, True

    def _time_first_fix(self, fix: GnssFix) -> None:
        """Measure the time to the first position, from the first message of a receiver or its reset on."""
        self.search_ns = self.now_ns if self.search_ns is None else self.search_ns
        if not has_position(fix):
            self.restarting = False
        elif self.first_fix_s is None and not self.restarting:
            self.first_fix_s = age_s(self.search_ns, self.now_ns)

    def _advance(self, stamp_ns: int) -> None:
        self.now_ns = max(self.now_ns, stamp_ns)
        if self.started_ns is None:
            self.started_ns = self.now_ns

    def _note_receiver(self, said: GnssReceiver) -> str | None:
        self._advance(said.received_ns)
        self.search_ns = self.now_ns if self.search_ns is None else self.search_ns
        self.said = said
        known = bool(said.messages) and self.receivers.note_received(said.source, self.now_ns)
        return said.source if known else None

    def _receiver_sends(self) -> str | None:
        """Say what a receiver sends, and what that means, while it has no position."""
        said = self.said
        if said is None or (age_s(said.received_ns, self.now_ns) or 0.0) > RECEIVER_SILENT_S:
            return None
        if not said.messages and said.other_protocols:
            return f"{said.source} speaks {_other(said.other_protocols)}"
        if not said.messages:
            return f"{said.source} sends bytes that are no messages: check the baud rate of its device"
        listed = ", ".join(said.messages[:LISTED]) + (", ..." if len(said.messages) > LISTED else "")
        if not said.gives_position:
            return f"{said.source} sends no message that gives a position, but {listed}"
        return f"{said.source} has no position yet: give its antenna a view of the sky (it sends {listed})"

    def _note_fix(self, fix: GnssFix) -> str | None:
        self._advance(fix.received_ns)
        self._time_first_fix(fix)
        if has_position(fix):
            self.fix_ns = self.now_ns
        if fix.utc_ns is not None:
            self.utc_offset_ns = fix.utc_ns - fix.sampled_ns
        self.gnss.note_received(
            fix.source, self.now_ns, rank=fix.source.endswith(NMEA),  # UBX is preferred
            valid=has_position(fix), sd=_position_sd_m(fix),
        )  # fmt: skip
        receiver = receiver_of(fix.source)
        return receiver if self.receivers.note_received(receiver, self.now_ns) else None


def has_position(fix: GnssFix) -> bool:
    """Whether a fix is a measured position."""
    return fix.latitude_deg is not None and fix.fix_type is not FixType.TIME_ONLY


def _position_sd_m(fix: GnssFix) -> float | None:
    """Horizontal standard deviation that a fix states."""
    if fix.position_cov_ned_m2 is not None:
        return math.sqrt(max(fix.position_cov_ned_m2[0] + fix.position_cov_ned_m2[3], 0.0))
    return math.hypot(*fix.position_sd_ned_m[:2]) if fix.position_sd_ned_m is not None else None


def _other(names: Sequence[str]) -> str:
    """Protocols that are not read at the port of a receiver, and what to switch on in their place."""
    first = BY_NAME.get(names[0])  # of a recording by another version there may be none
    if first is not None and not first.read_at:
        return f"{first.title}: not decoded; {first.remedy}"
    return f"{', '.join(names)}, which is not read: switch NMEA or UBX on"
