"""What core.trust keeps for its next process: on each change, every 10 s, and every 5 s while something is open."""

from collections.abc import Iterator
from dataclasses import dataclass

from shared.messages.navigation import NavigationSolution
from shared.messages.trust import Belief, Hypothesis, TrustedPosition, TrustLevel, TrustRecord, TrustState

PERIOD_NS, OPEN_PERIOD_NS = 10_000_000_000, 5_000_000_000
CRANKING_NS = 20_000_000_000  # in which power may fail once more before there is a position: it stands where it stood


@dataclass(frozen=True)
class OpenConflict:
    """Since when each source is suspect, and whether the odometer is left out; None and False without a conflict."""

    gnss_ns: int | None = None
    imu_ns: int | None = None
    alike_ns: int | None = None
    disturbed_ns: int | None = None
    odometer_excluded: bool = False


class Recorder:
    """Makes the records of a process."""

    def __init__(self) -> None:
        self._solution: NavigationSolution | None = None
        self._trusted: TrustedPosition | None = None
        self._known: TrustRecord | None = None  # of the process before
        self._begun_ns: int | None = None  # first verdict
        self._last: TrustRecord | None = None

    def see(self, solution: NavigationSolution) -> None:
        """Use a solution."""
        self._solution = solution

    def recall(self, record: TrustRecord) -> None:
        """Keep the last trusted position of the process before."""
        self._trusted, self._known = record.trusted, record

    def update(self, state: TrustState, found: OpenConflict, confirmed_ns: int | None) -> Iterator[TrustRecord]:
        """Use a verdict; yield a record if it is due."""
        solution, last = self._solution, self._last
        levels = state.protection_level_horizontal_m, state.protection_level_vertical_m
        if state.state is TrustLevel.SAFE and solution is not None and levels[0] is not None and levels[1] is not None:
            self._trusted = TrustedPosition(
                sampled_ns=solution.sampled_ns, latitude_deg=solution.latitude_deg,
                longitude_deg=solution.longitude_deg, height_ellipsoid_m=solution.height_ellipsoid_m,
                protection_level_horizontal_m=levels[0], protection_level_vertical_m=levels[1],
            )  # fmt: skip
        self._begun_ns = state.sampled_ns if self._begun_ns is None else self._begun_ns
        young = state.sampled_ns - self._begun_ns < CRANKING_NS
        known = self._known if solution is None and young else None
        record = TrustRecord(
            sampled_ns=state.sampled_ns,
            ended_in_order=known is not None and known.ended_in_order,
            moving=(known is None or known.moving) if solution is None else not solution.stationary,
            confirmed_ns=confirmed_ns,
            suspect_since_ns=found.gnss_ns,
            imu_suspect_since_ns=found.imu_ns,
            alike_since_ns=found.alike_ns,
            disturbed_since_ns=found.disturbed_ns,
            odometer_excluded=found.odometer_excluded,
            beliefs=tuple(filter(is_suspect, state.beliefs)),
            trusted=self._trusted,
        )
        period_ns = OPEN_PERIOD_NS if found != OpenConflict() else PERIOD_NS
        if last is None or _kept(last) != _kept(record) or record.sampled_ns - last.sampled_ns >= period_ns:
            self._last = record
            yield record

    def end(self, state: TrustState | None, found: OpenConflict, confirmed_ns: int | None) -> Iterator[TrustRecord]:
        """Yield the last record of a process that is stopped."""
        if state is not None:
            self._last = None
            for record in self.update(state, found, confirmed_ns):
                yield record.model_copy(update={"ended_in_order": True})


def is_suspect(belief: Belief) -> bool:
    """Whether a hypothesis of a fault survives."""
    return belief.survives and belief.hypothesis is not Hypothesis.NOTHING


def _kept(record: TrustRecord) -> tuple[object, ...]:
    """What is written at once when it changes."""
    return (
        record.moving, record.confirmed_ns is None, record.suspect_since_ns, record.imu_suspect_since_ns,
        record.alike_since_ns, record.disturbed_since_ns, record.odometer_excluded,
        tuple(sorted(belief.hypothesis for belief in record.beliefs)),
    )  # fmt: skip
