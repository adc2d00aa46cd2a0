"""Displacement from carrier phases: exact without noise, consistent with it, and safe against cycle slips."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from services.core.cooperative.carrier.displacement import Displacement, carrier_displacement
from services.core.cooperative.measurements import Constellation, Measurement, RawEpoch, SatelliteId
from services.core.cooperative.satellites.model import WAVELENGTH, ErrorModel, Sky
from shared.maths.earth import Geodetic, ecef_from_geodetic, ned_from_ecef
from shared.maths.gnss_signals import SECONDS_PER_DAY, SPEED_OF_LIGHT, klobuchar_delay_m
from tests.support.cases import each
from tests.support.gnss.constellation import IONOSPHERE, NOW_NS, constellation, filled_store, raw_epoch, sight_of

FloatArray = npt.NDArray[np.float64]
PLACE = Geodetic(0.6, 1.0, 100.0)  # 15 satellites above the mask
HERE, TO_NED = np.array(ecef_from_geodetic(PLACE)), ned_from_ecef(PLACE.latitude, PLACE.longitude)
STORE = filled_store()
EPHEMERIDES = {one.satellite: one for one in constellation()}
MS_M = 1e-3 * SPEED_OF_LIGHT  # a jump of the receiver's clock by a millisecond


def ionosphere_m(satellite: SatelliteId, position_e: FloatArray, gps_time_ns: int) -> float:
    _, sight = sight_of(EPHEMERIDES[satellite], position_e, gps_time_ns)
    geometry = Sky((sight,), gps_time_ns, IONOSPHERE, ErrorModel()).geometry(position_e)
    elevation, azimuth = float(geometry.elevation[0]), float(geometry.azimuth[0])
    second_of_day = gps_time_ns * 1e-9 % SECONDS_PER_DAY
    return klobuchar_delay_m(IONOSPHERE, PLACE, elevation=elevation, azimuth=azimuth, second_of_day=second_of_day)


def epoch_at(
    offset_n: FloatArray, t_s: float, *, clock_m: float = 45.0, velocity_n: FloatArray | None = None
) -> RawEpoch:
    """Pseudoranges and phases of an antenna away from `HERE` [m, NED], without noise; the phase has I with minus."""
    gps_time_ns, position_e = NOW_NS + round(t_s * 1e9), HERE + TO_NED.T @ offset_n
    velocity_e = TO_NED.T @ (np.zeros(3) if velocity_n is None else velocity_n)
    epoch = raw_epoch(
        position_e, velocity_e=velocity_e, clock_m=clock_m, galileo_clock_m=clock_m + 6.0, gps_time_ns=gps_time_ns
    )
    measured = []
    for one in epoch.measurements:
        phase_m = one.pseudorange_m - 2.0 * ionosphere_m(one.satellite, position_e, gps_time_ns)
        cycles = phase_m / WAVELENGTH + 1000.0 * one.satellite.number
        measured.append(replace(one, carrier_cycles=cycles, lock_time_s=60.0, half_cycle_resolved=True))
    return replace(epoch, measurements=tuple(measured))


def changed(epoch: RawEpoch, satellite: SatelliteId, **values: object) -> RawEpoch:
    changes = [replace(one, **values) if one.satellite == satellite else one for one in epoch.measurements]  # type: ignore[arg-type]
    return replace(epoch, measurements=tuple(changes))


def slip(epoch: RawEpoch, satellite: SatelliteId, cycles: float) -> RawEpoch:
    before = next(one.carrier_cycles for one in epoch.measurements if one.satellite == satellite)
    assert before is not None
    return changed(epoch, satellite, carrier_cycles=before + cycles)


def solved(first: RawEpoch, second: RawEpoch, start_e: FloatArray = HERE) -> Displacement:
    found = carrier_displacement(first, second, STORE, start_e)
    assert found is not None
    return found


@each(
    ("offset", "span_s"),
    [((0.0, 0.0, 0.0), 1.0), ((3.0, -4.0, 0.2), 0.1), ((30.0, 10.0, -1.0), 1.0), ((400.0, -700.0, 20.0), 30.0)],
)
def test_without_noise_the_displacement_is_exact(offset: tuple[float, float, float], span_s: float) -> None:
    velocity_n = np.array(offset) / span_s
    first = epoch_at(np.zeros(3), 0.0, velocity_n=velocity_n)
    found = solved(first, epoch_at(np.array(offset), span_s, velocity_n=velocity_n))
    assert found.displacement_n == pytest.approx(np.array(offset), abs=1e-3 + 5e-6 * np.hypot(*offset[:2]))
    assert not found.slipped and found.statistic < 1.0


def test_a_jump_of_the_receivers_clock_is_in_the_clock_alone() -> None:
    velocity_n = np.array([5.0, 0.0, 0.0])
    first = epoch_at(np.zeros(3), 0.0, velocity_n=velocity_n)
    found = solved(first, epoch_at(velocity_n, 1.0, clock_m=45.0 + MS_M, velocity_n=velocity_n))
    assert found.displacement_n == pytest.approx([5.0, 0.0, 0.0], abs=2e-3)
    assert found.clock_m == pytest.approx(MS_M, abs=1.0) and not found.slipped


def test_a_start_that_is_10_m_off_costs_millimetres() -> None:
    first, second = epoch_at(np.zeros(3), 0.0), epoch_at(np.zeros(3), 1.0)
    found = solved(first, second, HERE + TO_NED.T @ np.array([6.0, -6.0, 5.0]))
    assert np.linalg.norm(found.displacement_n) < 4e-3


SEEN = epoch_at(np.zeros(3), 1.0).measurements
USED = list(solved(epoch_at(np.zeros(3), 0.0), epoch_at(np.zeros(3), 1.0)).used)


@each(
    "values",
    [{"lock_time_s": 0.4}, {"half_cycle_resolved": False}, {"slipped": True}],
)
def test_a_satellite_that_the_receiver_has_lost_is_left_out(values: dict[str, object]) -> None:
    lost = USED[3]
    found = solved(epoch_at(np.zeros(3), 0.0), changed(epoch_at(np.zeros(3), 1.0), lost, **values))
    assert found.slipped == (lost,) and lost not in found.used and len(found.used) == found.redundancy + 4


def test_a_lock_of_the_longest_time_that_is_counted_lasts_over_a_longer_interval() -> None:
    first, second = epoch_at(np.zeros(3), 0.0), epoch_at(np.zeros(3), 30.0)
    assert not solved(first, second).slipped


def test_at_ten_epochs_a_second_doppler_finds_a_slip_without_redundancy() -> None:
    velocity_n, kept = np.array([20.0, 5.0, 0.0]), USED[:5]
    first = only(epoch_at(np.zeros(3), 0.0, velocity_n=velocity_n), kept)
    second = only(epoch_at(0.1 * velocity_n, 0.1, velocity_n=velocity_n), kept)
    found = solved(first, slip(second, kept[2], -1.0))
    assert found.slipped == (kept[2],) and found.redundancy == 0 and not found.checked
    assert found.displacement_n == pytest.approx(0.1 * velocity_n, abs=2e-3)


def only(epoch: RawEpoch, kept: list[SatelliteId]) -> RawEpoch:
    return replace(epoch, measurements=tuple(one for one in epoch.measurements if one.satellite in kept))


def test_without_a_satellite_too_few_there_is_none() -> None:
    kept = USED[:3]
    first, second = only(epoch_at(np.zeros(3), 0.0), kept), only(epoch_at(np.zeros(3), 1.0), kept)
    assert carrier_displacement(first, second, STORE, HERE) is None
    assert carrier_displacement(epoch_at(np.zeros(3), 0.0), epoch_at(np.zeros(3), 40.0), STORE, HERE) is None


def noisy(epoch: RawEpoch, rng: np.random.Generator) -> RawEpoch:
    """With phases of 2.5 mm: thermal noise, and what the antenna's surroundings add."""
    measured: list[Measurement] = []
    for one in epoch.measurements:
        assert one.carrier_cycles is not None
        measured.append(replace(one, carrier_cycles=one.carrier_cycles + 0.0025 / WAVELENGTH * rng.standard_normal()))
    return replace(epoch, measurements=tuple(measured))


def unseen_slips(draws: int) -> tuple[int, int, int, float]:
    """How many results claim to be checked, how many of those are 5 sd off or name the slip, and their mean NEES."""
    rng, first = np.random.default_rng(7), epoch_at(np.zeros(3), 0.0)
    offset = np.array([12.0, -9.0, 0.3])
    second = epoch_at(offset, 1.0)
    names = USED
    checked = wrong = found_slips = 0
    squares = []
    for _ in range(draws):
        kept = [names[k] for k in rng.permutation(len(names))[: rng.integers(len(names) - 3, len(names) + 1)]]
        slipped = kept[int(rng.integers(len(kept)))]
        cycles = float(rng.choice([-1.0, -0.5, 0.5, 1.0]))
        # without Doppler, which would find most of them by itself
        pair = [noisy(only(one, kept), rng) for one in (first, second)]
        silent = [
            replace(one, measurements=tuple(replace(m, doppler_hz=None) for m in one.measurements)) for one in pair
        ]
        result = carrier_displacement(silent[0], slip(silent[1], slipped, cycles), STORE, HERE)
        if result is None or not result.checked:
            continue
        checked += 1
        found_slips += slipped in result.slipped
        error = result.displacement_n - offset
        nees = float(error @ np.linalg.solve(result.cov, error))
        wrong += nees > 25.0
        squares.append(nees / 3.0)
    return checked, wrong, found_slips, float(np.mean(squares))


@pytest.mark.parametrize("draws", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_no_slip_moves_a_checked_result_by_five_standard_deviations(draws: int) -> None:
    checked, wrong, found, nees = unseen_slips(draws)
    assert checked > 0.4 * draws and wrong == 0
    assert found > 0.95 * checked
    assert nees < 1.5


def test_the_covariance_of_noise_is_that_of_the_errors() -> None:
    """Noise alone: the stated covariance holds slow errors and multipath as well, which this noise has none of."""
    rng, first, second = np.random.default_rng(3), epoch_at(np.zeros(3), 0.0), epoch_at(np.zeros(3), 1.0)
    squares = []
    for _ in range(150):
        found = solved(noisy(first, rng), noisy(second, rng))
        squares.append(float(found.displacement_n @ np.linalg.solve(found.cov, found.displacement_n)) / 3.0)
        assert (np.linalg.eigvalsh(found.cov - found.slow_cov) > 0.0).all()
    assert 0.1 < np.mean(squares) < 1.2


def test_galileo_alone_and_gps_alone_agree() -> None:
    velocity_n = np.array([1.0, 2.0, 0.0])
    first, second = (epoch_at(t_s * velocity_n, t_s, velocity_n=velocity_n) for t_s in (0.0, 1.0))
    for system in Constellation:
        kept = [one.satellite for one in SEEN if one.satellite.constellation == system]
        assert solved(only(first, kept), only(second, kept)).displacement_n == pytest.approx([1.0, 2.0, 0.0], abs=2e-3)
