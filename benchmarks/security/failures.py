"""Each process of a running unit is killed, and stopped: back within 20 s, and named as the only cause."""

import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from .unit import Unit

BACK_S = 20.0
WELL_S = 150.0  # until the filter has aligned again and every monitor is ready
BROKER, HEALTH = "broker", "monitoring.health"
SHORT = ("core.fusion", "parsers.gnss", BROKER)


@dataclass(frozen=True)
class Failure:
    """What came of one failure."""

    what: str
    how: str
    back_s: float | None  # until a new process of this name runs
    causes: tuple[str, ...]  # what the unit named
    recordings_lost: int

    @property
    def passed(self) -> bool:
        """Back in time, nothing else accused, no recording lost."""
        named = not self.causes or set(self.causes) == {self.what}
        return self.back_s is not None and self.back_s <= BACK_S and named and not self.recordings_lost


def every_failure(unit: Unit, names: Sequence[str]) -> Iterator[Failure]:
    """Kill and stop each process, one after the other; the broker as well."""
    # A relapse within ten seconds would continue the outage of before: so each of them once, and then each again.
    for how in (signal.SIGKILL, signal.SIGSTOP):
        for name in names:
            yield _fail(unit, name, how)
            unit.until(unit.is_well, WELL_S)


def _fail(unit: Unit, name: str, how: signal.Signals) -> Failure:
    before = {path.name for path in (unit.state / "recordings").glob("*.mcap")}
    victim = unit.broker() if name == BROKER else unit.child(f"cli run {name}")
    earlier = unit.outages()
    victim.send_signal(how)

    def is_back() -> bool:
        try:
            now = unit.broker() if name == BROKER else unit.child(f"cli run {name}")
        except LookupError:
            return False
        return now.pid != victim.pid

    back_s = unit.until(is_back, BACK_S + 10.0)
    unit.until(unit.is_well, WELL_S)
    causes = {what for what, _ in unit.outages() - earlier}
    if name != HEALTH:
        causes.discard(HEALTH)
    lost = before - {path.name for path in (unit.state / "recordings").glob("*.mcap")}
    back_s = None if back_s is None else round(back_s, 1)
    return Failure(name, how.name, back_s, tuple(sorted(causes)), len(lost))
