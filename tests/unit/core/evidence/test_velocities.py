"""Three velocities of a receiver: the one that departs is named, and false signals that agree pass."""

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from services.core.evidence.monitor import EvidenceMonitor
from services.core.evidence.settings import Settings
from services.core.evidence.velocities import Difference, Velocity, VelocityComparison
from shared.messages.base import Vector3
from shared.messages.gnss import CarrierDisplacement, FixType, GnssFix
from shared.messages.trust import Outcome
from tests.support.cases import each

NS = 1_000_000_000
FloatArray = npt.NDArray[np.float64]
Motion = Callable[[float], FloatArray]


def steady(t_s: float) -> FloatArray:
    """A car at 20 m/s that turns at 0.2 rad/s and brakes at 2 m/s² after 20 s."""
    speed = 20.0 - 2.0 * max(t_s - 20.0, 0.0)
    return speed * np.array([np.cos(0.2 * t_s), np.sin(0.2 * t_s), 0.0])


def displaced(motion: Motion, k: int, off: dict[Velocity, FloatArray]) -> CarrierDisplacement:
    fine = np.linspace(k - 1, k, 101)
    mean = np.mean([motion(t) for t in 0.5 * (fine[1:] + fine[:-1])], axis=0) + off.get(Velocity.CARRIER, 0.0)
    doppler = 0.5 * (motion(k - 1) + motion(k)) + off.get(Velocity.DOPPLER, 0.0)
    small = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
    return CarrierDisplacement(
        sampled_ns=k * NS, received_ns=k * NS, source="gnss0", since_ns=(k - 1) * NS,
        displacement_ned_m=vector(mean), displacement_cov_ned_m2=small, slow_cov_ned_m2=small, satellites_used=8,
        redundancy=4, checked=True, doppler_velocity_ned_m_s=vector(doppler), doppler_sd_ned_m_s=(0.04, 0.04, 0.06),
    )  # fmt: skip


def vector(values: FloatArray) -> Vector3:
    north, east, down = values.tolist()
    return north, east, down


def messages(
    off: dict[Velocity, FloatArray], *, lag_s: float = 0.0, from_s: int = 0, until_s: int = 28
) -> Iterator[GnssFix | CarrierDisplacement]:
    for k in range(until_s):
        wrong = off if k >= from_s else {}
        yield GnssFix(
            sampled_ns=k * NS, received_ns=k * NS, source="gnss0", fix_type=FixType.THREE_D,
            velocity_ned_m_s=vector(steady(k - lag_s) + wrong.get(Velocity.RECEIVER, 0.0)),
            velocity_sd_ned_m_s=(0.05, 0.05, 0.1),
        )  # fmt: skip
        if k:
            yield displaced(steady, k, wrong)


def compared(off: dict[Velocity, FloatArray], *, lag_s: float = 0.0) -> list[Difference]:
    comparison = VelocityComparison(0.5)
    given = messages(off, lag_s=lag_s)
    found = [comparison.fix(m) if isinstance(m, GnssFix) else comparison.displacement(m) for m in given]
    return [one for one in found if one is not None]


@each("which", [Velocity.CARRIER, Velocity.DOPPLER, Velocity.RECEIVER])
def test_the_velocity_that_departs_is_named(which: Velocity) -> None:
    found = compared({which: np.array([2.4, -1.8, 0.0])})
    assert len(found) > 20 and {one.differs for one in found} == {which}
    assert all(one.distance_m_s > one.limit_m_s for one in found)


def test_where_each_departs_from_each_no_single_one_is_named() -> None:
    found = compared({Velocity.CARRIER: np.array([6.0, 0.0, 0.0]), Velocity.DOPPLER: np.array([0.0, 6.0, 0.0])})
    assert {one.differs for one in found} == {Velocity.ALL}


def test_bends_braking_and_a_late_receiver_do_not_accuse() -> None:
    for lag_s in (0.0, 0.2):
        found = compared({}, lag_s=lag_s)
        assert len(found) > 20 and all(one.distance_m_s < one.limit_m_s for one in found)


def test_signals_that_are_false_and_agree_pass() -> None:
    """What a consistent spoofer does: it moves all three alike."""
    off = dict.fromkeys((Velocity.CARRIER, Velocity.DOPPLER, Velocity.RECEIVER), np.array([3.0, 3.0, 0.0]))
    assert all(one.distance_m_s < one.limit_m_s for one in compared(off))


def test_the_monitor_accuses_after_the_second_evaluation_and_says_since_when() -> None:
    monitor = EvidenceMonitor(Settings())
    outcomes = {}
    for message in messages({Velocity.RECEIVER: np.array([2.0, 0.0, 0.0])}, from_s=10, until_s=20):
        monitor.velocity(message)
        outcomes[message.sampled_ns // NS] = monitor.results(message.sampled_ns)["velocities"]
    assert outcomes[9].outcome is Outcome.PASS and outcomes[19].outcome is Outcome.ACCUSES
    assert outcomes[19].why.values["differs"] == "receiver"
    since_ns = outcomes[19].suspect_since_ns
    assert since_ns is not None and since_ns <= 10 * NS


def test_without_checked_displacements_nothing_is_compared() -> None:
    comparison = VelocityComparison(0.5)
    for message in messages({}):
        if isinstance(message, GnssFix):
            assert comparison.fix(message) is None
        else:
            assert comparison.displacement(message.model_copy(update={"checked": False})) is None
