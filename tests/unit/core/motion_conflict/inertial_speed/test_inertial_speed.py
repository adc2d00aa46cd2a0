"""The monitor on simulated and recorded drives: clean ones pass, a common scale of both speeds is found; bad input."""

import csv
from collections import Counter
from math import hypot, inf, nan

import numpy as np
import numpy.typing as npt
import pytest

from services.core.motion_conflict.codes import Code
from services.core.motion_conflict.inertial_speed.monitor import InertialSpeed, geometry_of
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.rotation import ned_from_body
from shared.messages.explanation import explain
from shared.trust.inputs import Input
from shared.trust.result import Test
from tests.support.data import recording

FloatArray = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.float64] | npt.NDArray[np.int64]
SECOND_NS = 1_000_000_000
ATTACK_S, RISE_S = 500.0, 40.0


@pytest.fixture(scope="module", params=[1, 2])
def town(request: pytest.FixtureRequest) -> Drive:
    """A drive of 17 minutes with 27 and 25 bends."""
    return simulate("urban", request.param, 1000.0)


class Samples:
    """Inertial samples and speeds of a drive, in order of time."""

    def __init__(
        self, t_ns: Stamps, force: FloatArray, rate: FloatArray, gnss: FloatArray, odometer: FloatArray | None
    ) -> None:
        self.t_ns, self.force, self.rate = t_ns.astype(np.int64), force, rate
        self.gnss = gnss  # shape (m, 3): stamp [ns], speed, standard deviation [m/s]
        self.odometer = odometer  # shape (k, 2): stamp [ns], speed [m/s]

    @classmethod
    def of(cls, drive: Drive, *, odometer: bool = True) -> "Samples":
        ok = drive.fix_valid
        speed, sd = np.hypot(*drive.fix_velocity_n[ok, :2].T), drive.fix_velocity_sd_n[ok, :2].max(axis=1)
        wheels = np.column_stack([drive.odometer_ns, drive.odometer]) if odometer else None
        return cls(
            drive.t_ns, drive.force_b, drive.rate_b, np.column_stack([drive.fix_ns[ok], speed, np.maximum(sd, 0.05)]),
            wheels,
        )  # fmt: skip

    def run(
        self, monitor: InertialSpeed, factor: float = 1.0, attack_s: float = 0.0, *, wheels_too: bool = True,
        rise_s: float = RISE_S,
    ) -> list[Test]:  # fmt: skip
        """Give a verdict a second; speeds are multiplied by a factor from a time on."""
        start_ns, found, i, k, j = int(self.t_ns[0]), [], 0, 0, 0

        def scaled(stamp_ns: float) -> float:
            elapsed_s = (stamp_ns - start_ns) / SECOND_NS - attack_s
            return 1.0 + (factor - 1.0) * float(np.clip(elapsed_s / rise_s if rise_s else elapsed_s >= 0.0, 0.0, 1.0))

        for second in range(1, 1 + int((self.t_ns[-1] - start_ns) // SECOND_NS)):
            end_ns = start_ns + second * SECOND_NS
            end = int(np.searchsorted(self.t_ns, end_ns))
            batch = slice(i, end)
            if end > i:
                monitor.inertial(self.t_ns[batch].tolist(), self.force[batch].tolist(), self.rate[batch].tolist())
            i = end
            while k < len(self.gnss) and self.gnss[k, 0] < end_ns:
                stamp, speed, sd = self.gnss[k].tolist()
                monitor.gnss(int(stamp), speed * scaled(stamp), sd)
                k += 1
            while self.odometer is not None and j < len(self.odometer) and self.odometer[j, 0] < end_ns:
                stamp, speed = self.odometer[j].tolist()
                monitor.odometer(int(stamp), speed * (scaled(stamp) if wheels_too else 1.0))
                j += 1
            found.append(monitor.verdict(end_ns))
        return found


def monitor_of(drive: Drive) -> InertialSpeed:
    return InertialSpeed(geometry=geometry_of((0.0, 0.0, 0.0), drive.lever_arm_b))


def test_a_clean_drive_through_town_accuses_nobody(town: Drive) -> None:
    monitor = monitor_of(town)
    verdicts = Samples.of(town).run(monitor)
    assert not any(verdict.accuses for verdict in verdicts)
    assert verdicts[-1].evaluated and verdicts[-1].why.code == Code.SCALE_OF_BOTH
    scales = np.array([bend.scale for bend in monitor.bends])
    assert len(scales) >= 20
    assert float(scales.mean()) == pytest.approx(1.0, abs=0.01)
    assert float(scales.std()) < 0.02
    normalised = (scales - 1.0) / np.array([bend.sd for bend in monitor.bends])
    assert 0.5 < float(np.sqrt((normalised**2).mean())) < 1.5


@pytest.mark.parametrize(("factor", "most_bends"), [(1.10, 5), (1.03, 40), (0.9, 5)])
def test_gnss_and_odometer_scaled_alike_are_accused_both(town: Drive, factor: float, most_bends: int) -> None:
    monitor = monitor_of(town)
    verdicts = Samples.of(town).run(monitor, factor, ATTACK_S)
    accusing = [k for k, verdict in enumerate(verdicts) if verdict.accuses]
    assert accusing and accusing[0] > ATTACK_S
    first = verdicts[accusing[0]]
    assert first.accused == ("gnss", "odometer") and first.why.code == Code.BOTH_SCALED
    start_ns = int(town.t_ns[0])
    assert first.suspect_since_ns is not None
    assert first.suspect_since_ns < start_ns + ATTACK_S * SECOND_NS, "before the attack"
    since_ns, until_ns = start_ns + ATTACK_S * SECOND_NS, start_ns + (accusing[0] + 1) * SECOND_NS
    assert sum(since_ns < bend.end_ns < until_ns for bend in monitor.bends) <= most_bends
    assert all(verdict.accuses for verdict in verdicts[accusing[0] :]), "no time ends it"
    assert verdicts[-1].accused == ("gnss", "odometer")


def test_gnss_scaled_alone_is_accused_alone_and_without_an_odometer_the_inertial_sensors_with_it(town: Drive) -> None:
    alone = Samples.of(town).run(monitor_of(town), 1.1, ATTACK_S, wheels_too=False)
    assert alone[-1].accuses and alone[-1].accused == ("gnss",) and alone[-1].why.code == Code.GNSS_SCALED
    without = Samples.of(town, odometer=False).run(monitor_of(town), 1.1, ATTACK_S)
    assert without[-1].accuses and without[-1].accused == ("gnss", "imu")
    assert without[-1].why.code == Code.GNSS_OR_IMU_SCALED


def test_wide_bends_of_a_motorway_are_measured_too() -> None:
    drive = simulate("highway", 1, 420.0)
    monitor = monitor_of(drive)
    assert not any(verdict.accuses for verdict in Samples.of(drive).run(monitor))
    scales = np.array([bend.scale for bend in monitor.bends])
    assert len(scales) >= 5
    assert float(scales.mean()) == pytest.approx(1.0, abs=0.01)


def test_what_is_missing_is_named() -> None:
    monitor = InertialSpeed()
    assert monitor.verdict(SECOND_NS).why == explain(Code.NO_INPUT, input=Input.INERTIAL_SAMPLES)
    drive = simulate("urban", 1, 60.0)
    samples = Samples.of(drive)
    assert samples.run(monitor)[-1].why == explain(Code.FEW_BENDS, bends_count=0, needed_count=5)
    late_ns = int(drive.t_ns[-1]) + 30 * SECOND_NS
    silent = monitor.verdict(late_ns).why
    assert (silent.code, silent.values["input"]) == (Code.INPUT_SILENT, Input.INERTIAL_SAMPLES)
    assert silent.values["age_s"] in range(30, 40)
    moving = InertialSpeed()
    driving = np.hypot(*drive.velocity_n[:, :2].T) > 1.0
    while_driving = Samples(drive.t_ns[driving], drive.force_b[driving], drive.rate_b[driving], samples.gnss, None)
    assert while_driving.run(moving)[-1].why == explain(Code.NO_STANDSTILL)


def test_bad_input_is_counted_and_memory_is_bounded() -> None:
    rejected: Counter[str] = Counter()
    monitor = InertialSpeed(rejected=rejected)
    still = (0.0, 0.0, -STANDARD_GRAVITY)
    monitor.inertial([SECOND_NS], [(nan, 0.0, 0.0)], [(0.0, 0.0, 0.0)])
    monitor.inertial([2 * SECOND_NS, 2 * SECOND_NS], [still, still], [(0.0, 0.0, 0.0)] * 2)
    monitor.inertial([3 * SECOND_NS], [(inf, 0.0, 0.0)], [(0.0, 0.0, 0.0)])
    monitor.inertial([4 * SECOND_NS], [still], [(0.0, 0.0, 1e9)])
    monitor.verdict(5 * SECOND_NS)
    assert sum(rejected.values()) == 4
    monitor.inertial([100 * SECOND_NS], [still], [(0.0, 0.0, 0.0)])
    monitor.inertial([10 * SECOND_NS], [still], [(0.0, 0.0, 0.0)])
    assert rejected["imu: time line started again"] == 1
    for k in range(20_000):  # without a verdict in between, and without speeds
        monitor.inertial([(200 + k) * SECOND_NS // 10], [still], [(0.0, 0.0, 0.0)])
    assert len(monitor._pending) <= 100


def test_a_gap_in_the_inertial_samples_hides_bends_and_makes_none(town: Drive) -> None:
    t_s = town.t_ns / SECOND_NS
    kept = (t_s % 50.0) < 45.0
    samples = Samples.of(town)
    monitor = monitor_of(town)
    gappy = Samples(town.t_ns[kept], town.force_b[kept], town.rate_b[kept], samples.gnss, samples.odometer)
    assert not any(verdict.accuses for verdict in gappy.run(monitor))
    assert all(abs(bend.scale - 1.0) < 0.1 for bend in monitor.bends)


def rtkexp() -> Samples:
    """The recording in body axes, with the author's mounting; the stamps are 0.2 s late, the velocity 0.125 s old."""
    folder = recording("rtkexp_drive")
    imu = np.loadtxt(folder / "imu.csv", delimiter=",", skiprows=1)
    with (folder / "imu.csv").open(encoding="utf-8") as file:
        columns = next(csv.reader(file))
    with (folder / "gnss_rtk.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    turn = ned_from_body(0.0, np.radians(-6.79), np.radians(5.35)) @ np.diag([-1.0, 1.0, -1.0])
    force = imu[:, [columns.index(f"acc_{axis}_g") for axis in "xyz"]] * STANDARD_GRAVITY @ turn.T
    rate = np.radians(imu[:, [columns.index(f"gyr_{axis}_dps") for axis in "xyz"]]) @ turn.T
    start_s = float(rows[0]["gpst_unix_s"])
    stamps = (imu[:, columns.index("gpst_unix_s")] - start_s - 0.2) * SECOND_NS + 10 * SECOND_NS
    gnss = np.array([
        (
            (float(row["gpst_unix_s"]) - start_s - 0.125) * SECOND_NS + 10 * SECOND_NS,
            hypot(float(row["vn"]), float(row["ve"])), max(0.05, float(row["sdvn"]), float(row["sdve"])),
        )
        for row in rows
    ])  # fmt: skip
    return Samples(stamps, force, rate, gnss, None)


@pytest.mark.recording
def test_the_recorded_drive_passes_and_its_speeds_scaled_by_ten_percent_are_found() -> None:
    """Car park and streets, 549 s: 25 bends, 1.006 +- 0.028, without any learning from an earlier drive."""
    samples, monitor = rtkexp(), InertialSpeed()
    assert not any(verdict.accuses for verdict in samples.run(monitor))
    scales = np.array([bend.scale for bend in monitor.bends])
    assert len(scales) >= 20
    assert float(np.median(scales)) == pytest.approx(1.0, abs=0.015)
    assert float(scales.std()) < 0.04
    whole = samples.run(InertialSpeed(), 1.1, 0.0, rise_s=0.0)
    assert whole[-1].accused == ("gnss", "imu"), "the whole drive is falsified: beyond the inertial sensors' own scale"
    within = samples.run(InertialSpeed(), 1.1, 270.0, rise_s=0.0)
    first = next(k for k, verdict in enumerate(within) if verdict.accuses)
    assert 270 < first < 270 + 150
    suspect_ns = within[first].suspect_since_ns
    assert suspect_ns is not None and suspect_ns < int(samples.t_ns[0]) + 270 * SECOND_NS
