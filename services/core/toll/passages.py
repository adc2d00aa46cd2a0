"""The passage of one vehicle: approach line, gate line, exit line; charged only when all are passed, forward."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import hypot, sqrt

from shared.messages.explanation import Explanation, explain
from shared.messages.explanation import passage as reference_of
from shared.messages.toll import OVERLAPS, POSTERIORS, PassageState
from shared.v2x.evidence import message_digest
from shared.words.words import CodedText, stated

from .codes import Code
from .settings import PassageSettings

SLOWEST, LONGEST_S = 2.0, 30.0  # [m/s], [s] at least and at most to the gate line, of a vehicle that fell silent
ACCELERATION, FASTEST = 3.0, 70.0  # [m/s²], [m/s] of a vehicle that is not seen


@dataclass(frozen=True)
class Mode:
    """Where a vehicle is if its receiver errs in one of the ways that are possible."""

    away: float  # [m] along the road from where it most probably is
    along_sd: float  # [m]
    lanes: tuple[float, ...]  # probability that it errs so and is in each lane


@dataclass(frozen=True)
class TimeMode:
    """When a vehicle crossed the gate line, and where, if its receiver errs in one of the ways that are possible."""

    offset_s: float  # after the crossing time
    sd_s: float
    lanes: tuple[float, ...]  # probability that it errs so and is in each lane


@dataclass(frozen=True)
class Here:
    """Where a vehicle is after a CAM: corrected by the delta position where its track agrees with it."""

    time_ns: int
    east: float  # [m]
    north: float  # [m]
    cov: tuple[float, float, float]  # [m²] east-east, east-north, north-north; the GNSS error included
    heading: float  # [rad] counter-clockwise from east
    speed: float  # [m/s]
    speed_sd: float  # [m/s]
    direction: str  # carriageway
    aligned: bool  # whether the heading is that of the carriageway
    along: float  # [m] front point behind the gate line, negative before it
    along_sd: float  # [m]
    lanes: tuple[float, ...]  # probability of each lane of the plaza
    lane: int  # the most probable lane
    delta_ns: int | None  # stamp of the delta position that is applied
    modes: tuple["Mode", ...] = ()  # by what is supposed of the receiver's error

    @property
    def sd(self) -> float:
        """Standard deviation [m] of the position: the root of the sum of both axes' variances."""
        return hypot(self.cov[0] ** 0.5, self.cov[2] ** 0.5)

    def decided(self, probability: float) -> int | None:
        """Return the lane whose probability reaches the limit; None: undecided."""
        return self.lane if self.lanes[self.lane] >= probability else None


@dataclass(frozen=True)
class Crossing:
    """The front point at the gate line."""

    time_ns: int
    sd_s: float
    lane: int | None  # None: undecided
    lanes: tuple[float, ...]
    delta_ns: int | None
    modes: tuple[TimeMode, ...] = ()

    def widened(self, here: Here) -> "Crossing":
        """Give the time the standard deviation that a slow vehicle's has.

        A position s behind the line, t after the crossing, is s/σ standard deviations of the front point away from it::

            σ_t >= t · σ / max(s, σ)    where s <= 3 σ

        At a constant speed that is σ/v. A vehicle that waits at the line may cross it as late as it goes on.
        """
        if here.along > 3.0 * here.along_sd:
            return self
        elapsed_s = (here.time_ns - self.time_ns) * 1e-9
        least_s = elapsed_s * here.along_sd / max(here.along, here.along_sd)
        modes = tuple(replace(mode, sd_s=max(mode.sd_s, least_s)) for mode in self.modes)
        return replace(self, sd_s=max(self.sd_s, least_s), modes=modes)


def crossing_between(before: Here, after: Here, decided: float) -> Crossing:
    """Interpolate the crossing of the gate line between two positions, before it and behind it.

    The lane is that of the position behind the line; if that is undecided, of the position before it, which may be the
    last one before a restart. A vehicle that was on the line at a restart is `before` it with a coordinate of up to
    `crossed_m`. The variance is that of the position along the road and that of the interpolation over a time T, with
    accelerations of up to a, at the mean speed V between the two::

        σ_t² = (σ/v)² + min(a T² / (8 V), T / √12)²
    """
    share = -before.along / (after.along - before.along) if before.along < 0.0 else 0.0
    elapsed_ns = after.time_ns - before.time_ns
    gap_s = elapsed_ns * 1e-9
    mean_speed = max((after.along - before.along) / gap_s, 0.1)
    interpolated_s = min(ACCELERATION * gap_s**2 / (8.0 * mean_speed), gap_s / sqrt(12.0))
    witness = before if after.decided(decided) is None and before.decided(decided) is not None else after
    time_ns = before.time_ns + round(share * elapsed_ns)
    speed = max(after.speed, mean_speed)
    sd_s = hypot(after.along_sd / speed, interpolated_s)
    modes = tuple(
        TimeMode(-mode.away / speed, hypot(mode.along_sd / speed, interpolated_s), mode.lanes) for mode in witness.modes
    )
    return Crossing(time_ns, sd_s, witness.decided(decided), witness.lanes, witness.delta_ns, modes)


def expected_crossing(here: Here) -> Crossing:
    """When a vehicle that fell silent before the gate line would have crossed it, at its last speed or a walk.

    The standard deviation is half the time until then, at least 1 s: it may have braked or queued.
    """
    ahead_s = min(max(-here.along, 0.0) / max(here.speed, SLOWEST), LONGEST_S)
    return Crossing(here.time_ns + round(ahead_s * 1e9), max(0.5 * ahead_s, 1.0), None, here.lanes, here.delta_ns)


def passage_id(plaza: str, frame: bytes) -> str:
    """Hash the plaza's name and the digest of the first CAM at the approach line: a replay makes the same.

    The digest of a signed CAM is that of what is signed and by whom: a replay may have another hop limit, or the other
    signature of the same, (r, n - s).
    """
    return hashlib.sha256(plaza.encode() + b"\0" + message_digest(frame)).hexdigest()


@dataclass
class Passage:
    """A passage in progress. `advance` and `leave` move it through its states; OPEN and CROSSED alone change."""

    passage_id: str
    opened_ns: int
    direction: str
    station_ids: list[int]
    here: Here
    state: PassageState = PassageState.OPEN
    why: CodedText | None = None
    doubt: CodedText | None = None  # why it will be suspect once it has crossed
    crossing: Crossing | None = None
    exit_ns: int | None = None
    registered: bool = False
    tickets: list[str] = field(default_factory=list)  # of its authenticated CAM, in the order of use
    authenticated: bool = False  # all of its CAM are
    identity: CodedText | None = None  # why it is reviewed if no contract is known
    track: int | None = None  # number of the track; None: no track has it
    stated_ns: int = 0  # time of the newest statement; a checkpoint follows a second later
    overlaps: list[str] = field(default_factory=list)  # IDs of passages at the gate line within its vehicle's length
    posteriors: list[tuple[int, tuple[float, ...]]] = field(default_factory=list)  # once a second, and at the crossing
    furthest: float = field(init=False)  # [m] greatest coordinate behind the gate line

    def __post_init__(self) -> None:
        self.furthest = self.here.along

    def remember_lanes(self) -> None:
        """Note the lane probabilities of now, as evidence."""
        if not self.posteriors or self.posteriors[-1][0] < self.here.time_ns:
            self.posteriors.append((self.here.time_ns, self.here.lanes))
            del self.posteriors[:-POSTERIORS]

    def advance(self, here: Here, crossing: Crossing | None, settings: PassageSettings) -> bool:
        """Use a position, but for the exit line; return whether the state has changed.

        Parameters
        ----------
        here : Here
            Position after the newest CAM, relative to the passage's direction.
        crossing : Crossing or None
            The crossing of the gate line, if the front point is behind it.
        settings : PassageSettings
            Limits.
        """
        self.here = here
        self.furthest = max(self.furthest, here.along)
        before = self.state
        if self.state.is_final:
            return False
        if here.along < self.furthest - settings.turned_m:
            is_before = self.state is PassageState.OPEN
            self._end(PassageState.VOID, explain(Code.TURNED_BEFORE if is_before else Code.TURNED_BEHIND))
        elif self.state is PassageState.OPEN and crossing and here.along >= settings.crossed_m:
            self.state, self.crossing = PassageState.CROSSED, crossing
            self.posteriors = [*self.posteriors[1 - POSTERIORS :], (here.time_ns, crossing.lanes)]
        elif self.state is PassageState.CROSSED and self.crossing:
            self.crossing = self.crossing.widened(here)
        return self.state is not before

    def leave(self, exit_line: float, settings: PassageSettings) -> bool:
        """End the passage if it has crossed and is behind the exit line [m behind the gate line]; whether it has.

        Both lines may lie between two CAM. The crossing is stated before the end all the same: from it follow the
        vehicles that it overlaps, and the evidence.
        """
        if self.state is not PassageState.CROSSED or self.here.along < exit_line:
            return False
        self.exit_ns = self.here.time_ns
        if not self.registered:
            self._end_unregistered()
        elif self.crossing is None or self.crossing.lane is None:
            self._end(PassageState.UNDECIDED, explain(Code.UNDECIDED, decided_probability=settings.decided))
        else:
            self._end(PassageState.CHARGED, explain(Code.PASSED))
        return True

    def _end_unregistered(self) -> None:
        if self.identity:
            self.state, self.why = PassageState.SUSPECT, self.identity
        else:
            self._end(PassageState.UNREGISTERED, explain(Code.UNREGISTERED))

    def identify(self, other: "Passage") -> None:
        """Note that another passage has the same station ID under another ticket."""
        self.identity = stated(explain(Code.IDENTITY, passage=reference_of(other.passage_id)))

    def contradict(self, other: "Passage") -> None:
        """Note that another passage has the same station ID, and that they cannot be of one vehicle."""
        self.doubt = stated(explain(Code.SAME_STATION, passage=reference_of(other.passage_id)))

    def suspect(self, overlapped: Sequence["Passage"]) -> None:
        """Note the passages that it overlaps in its lane; end it if another one has its station ID.

        Which of two vehicles at one place is there, the detectors decide: the ledger counts their pulses.
        """
        self.overlaps = [passage.passage_id for passage in overlapped][:OVERLAPS]
        if self.doubt:
            self.state, self.why = PassageState.SUSPECT, self.doubt

    def lose(self) -> None:
        """End the passage of a vehicle that fell silent.

        Behind the gate line it has passed, whatever it says or does not say afterwards: a switch must be no free ride.
        The ledger charges it if a detector confirms it, and leaves it to a person otherwise. Before the gate line it
        may have passed: it is stated when that would have been, and a pulse which nothing else explains is a review.
        """
        if self.state is PassageState.OPEN:
            if self.registered and self.here.aligned:
                self.crossing = expected_crossing(self.here)
            self._end(PassageState.VOID, explain(Code.SILENT_BEFORE))
        elif not self.registered:
            self._end_unregistered()
        elif self.crossing is None:
            self._end(PassageState.SUSPECT, explain(Code.SILENT_BETWEEN))
        elif self.crossing.lane is None:
            self._end(PassageState.UNDECIDED, explain(Code.SILENT_BETWEEN))
        else:
            self._end(PassageState.CHARGED, explain(Code.SILENT_BETWEEN))

    def give_way(self, older: "Passage") -> None:
        """End the passage because the vehicle's older one is continued."""
        self._end(PassageState.VOID, explain(Code.CONTINUES, passage=reference_of(older.passage_id)))

    def _end(self, state: PassageState, why: Explanation) -> None:
        self.state, self.why = state, stated(why)


def can_reach(last: Here, here: Here, *, gate_m: float, longest_s: float) -> bool:
    """Whether a vehicle can have driven from one position to another on its carriageway.

    Parameters
    ----------
    last, here : Here
        The positions; a late CAM of before `last` may be used after it.
    gate_m : float
        [m] Tolerance along the road, beside three standard deviations of the distance.
    longest_s : float
        [s] Longest time between the two.

    Notes
    -----
    In a time t it comes at most v t + ½ a t² further, not faster than 70 m/s, and not back.
    """
    elapsed_s = (here.time_ns - last.time_ns) * 1e-9
    if here.direction != last.direction or not here.aligned or abs(elapsed_s) > longest_s:
        return False
    t = abs(elapsed_s)
    way = min(last.speed * t + 0.5 * ACCELERATION * t**2, FASTEST * t)
    moved = here.along - last.along if elapsed_s >= 0.0 else last.along - here.along
    tolerance = gate_m + 3.0 * hypot(last.along_sd, here.along_sd)
    return -tolerance <= moved <= way + tolerance


def overlap(front: Passage, behind: Here, length_m: float, *, relative_sd: float) -> bool:
    """Whether a vehicle at the gate line stands inside the one before it in the same lane.

    Parameters
    ----------
    front : Passage
        Of the vehicle that crossed first.
    behind : Here
        The vehicle that crosses now.
    length_m : float
        [m] Length of the first vehicle.
    relative_sd : float
        [m] Standard deviation of the distance of two vehicles with the same common GNSS error.

    Notes
    -----
    The distance of the front points is that at the time of `behind`; vehicles that follow each other keep at least a
    vehicle's length. Twice the standard deviation is granted.
    """
    elapsed_s = (behind.time_ns - front.here.time_ns) * 1e-9
    distance = front.here.along + front.here.speed * elapsed_s - behind.along
    return distance < length_m - 2.0 * relative_sd
