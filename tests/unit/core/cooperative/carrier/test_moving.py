"""A simulated drive: what core.cooperative publishes of carrier phases against the path of the antenna."""

from itertools import pairwise
from math import radians

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from services.core.cooperative.process import Config, Process
from services.parsers.gnss.process import Config as GnssConfig
from services.parsers.gnss.process import Process as GnssParser
from services.sensors.simulator.vehicle import LEVER_ARM_B
from services.sensors.simulator.world import messages
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.maths.rotation import ned_from_body
from shared.messages.gnss import CarrierDisplacement, GnssFix, GnssNavigationBits, GnssRaw, GnssRawEpoch
from shared.messages.navigation import TruthState

DURATION_S = 55.0  # ephemerides take 30 s


@pytest.fixture(scope="module")
def drive() -> tuple[list[CarrierDisplacement], list[TruthState], list[GnssFix]]:
    parser, process = GnssParser(GnssConfig()), Process(Config())
    found: list[CarrierDisplacement] = []
    truth: list[TruthState] = []
    fixes: list[GnssFix] = []
    for message in messages("parking_lot", 3, DURATION_S):
        if isinstance(message, TruthState):
            truth.append(message)
        for parsed in parser.handle(message) if isinstance(message, GnssRaw) else ():
            if isinstance(parsed, GnssFix):
                fixes.append(parsed)
            if isinstance(parsed, GnssRawEpoch | GnssNavigationBits | GnssFix):
                found += [one for one in process.handle(parsed) if isinstance(one, CarrierDisplacement)]
    return found, truth, fixes


def path_of(truth: list[TruthState]) -> CubicSpline:
    """Places of the antenna [m, NED] over the stamps [s]."""
    places = [Geodetic(radians(t.latitude_deg), radians(t.longitude_deg), t.height_ellipsoid_m) for t in truth]
    turned = [ned_from_body(t.roll_rad or 0.0, t.pitch_rad or 0.0, t.yaw_rad or 0.0) @ LEVER_ARM_B for t in truth]
    offsets = [ned_from_geodetic_difference(place, places[0]) for place in places]
    return CubicSpline([t.sampled_ns * 1e-9 for t in truth], np.array(offsets) + np.array(turned))


def test_the_displacement_is_that_of_the_antenna_to_millimetres(
    drive: tuple[list[CarrierDisplacement], list[TruthState], list[GnssFix]],
) -> None:
    found, truth, _ = drive
    path, speeds, squares = path_of(truth), [], []
    for one in found:
        moved = path(one.sampled_ns * 1e-9) - path(one.since_ns * 1e-9)
        error = np.array(one.displacement_ned_m) - moved
        cov = np.zeros((3, 3))
        cov[np.triu_indices(3)] = one.displacement_cov_ned_m2
        cov += np.triu(cov, 1).T
        speeds.append(np.linalg.norm(error) / ((one.sampled_ns - one.since_ns) * 1e-9))
        squares.append(error @ np.linalg.solve(cov, error) / 3.0)
    assert len(found) > 20 and max(np.hypot(*one.displacement_ned_m[:2]) for one in found) > 2.0
    assert np.quantile(speeds, 0.95) < 0.03
    assert 0.05 < np.mean(squares) < 1.5


def test_nearly_every_interval_is_checked_and_follows_the_one_before(
    drive: tuple[list[CarrierDisplacement], list[TruthState], list[GnssFix]],
) -> None:
    found, _, _ = drive
    assert sum(one.checked for one in found) > 0.8 * len(found)
    assert not any(one.satellites_slipped for one in found)
    assert all(earlier.sampled_ns == later.since_ns for earlier, later in pairwise(found))


def test_fixes_scatter_by_decimetres_where_phases_do_not(
    drive: tuple[list[CarrierDisplacement], list[TruthState], list[GnssFix]],
) -> None:
    found, truth, fixes = drive
    path, places = path_of(truth), {fix.sampled_ns: fix for fix in fixes}
    errors = []
    for one in found:
        here, before = (places.get(stamp) for stamp in (one.sampled_ns, one.since_ns))
        if here is None or before is None or None in (here.latitude_deg, before.latitude_deg):
            continue
        later, earlier = (
            Geodetic(radians(f.latitude_deg or 0.0), radians(f.longitude_deg or 0.0), f.height_ellipsoid_m or 0.0)
            for f in (here, before)
        )
        moved = path(one.sampled_ns * 1e-9) - path(one.since_ns * 1e-9)
        errors.append(np.linalg.norm(np.array(ned_from_geodetic_difference(later, earlier)) - moved))
    assert len(errors) > 20
    assert np.median(errors) > 0.02, "phases do not follow the errors of the fixes"
