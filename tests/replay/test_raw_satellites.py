"""Raw satellite measurements of real receivers: position, fault detection and broadcast ephemerides.

========================  ======================================================================
recording                 measured
========================  ======================================================================
geonet_rinex_raim, 0759   0.74 m horizontal and 2.21 m 3-D at 95 %, 120 epochs, no alarm; by carrier phases
                          3.3 mm/s 3-D at 95 % over 30 s
osnma, ublox_2026_03      satellites within 1.1 deg of NAV-SAT, which rounds to whole degrees
gpsd, ublox-zed-f9r       2.21 m horizontal and 2.58 m 3-D at 95 %, 30 epochs of RTCM MSM5, no alarm
========================  ======================================================================
"""

from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from io import BytesIO
from itertools import pairwise
from math import cos, degrees, radians

import numpy as np
import pytest
from pyubx2.ubxreader import UBXReader

from services.core.cooperative.broadcast.ephemeris import satellite_state
from services.core.cooperative.broadcast.rinex import read_rinex_navigation
from services.core.cooperative.broadcast.rinex_observation import read_rinex_observations
from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.carrier.displacement import carrier_displacement
from services.core.cooperative.hypotheses import satellite_hypotheses
from services.core.cooperative.measurements import (
    WEEK_NS,
    Constellation,
    RawEpoch,
    SatelliteId,
    SatelliteVerdict,
)
from services.core.cooperative.satellites.model import ErrorModel, SatelliteMeasurement, Sky
from services.core.cooperative.satellites.monitor import SatelliteMonitor
from shared.maths.earth import Geodetic, ecef_from_geodetic, geodetic_from_ecef, ned_from_ecef
from shared.messages.trust import Outcome, TrustHypotheses
from tests.support.data import recording
from tests.support.gnss.rtcm import read_rtcm

pytestmark = [pytest.mark.recording, pytest.mark.slow]
Station = tuple[list[RawEpoch], EphemerisStore, np.ndarray]


@pytest.fixture(scope="module")
def station() -> Station:
    folder = recording("geonet_rinex_raim")
    ephemerides, ionosphere = read_rinex_navigation((folder / "07590920.05n").read_text())
    epochs, position = read_rinex_observations((folder / "07590920.05o").read_text())
    store = EphemerisStore(kept=100)
    for ephemeride in ephemerides:
        store.add(ephemeride)
    store.ionosphere = ionosphere
    assert position is not None and len(epochs) == 120 and not store.rejected
    return epochs, store, np.array(position)


def test_the_position_of_a_surveyed_station_is_within_its_accuracy(station: Station) -> None:
    epochs, store, truth = station
    place = geodetic_from_ecef((truth[0], truth[1], truth[2]))
    to_ned, monitor = ned_from_ecef(place.latitude, place.longitude), SatelliteMonitor()
    errors = []
    for epoch in epochs:
        verdict = monitor.evaluate(epoch, store)
        assert verdict.outcome == Outcome.PASS and verdict.solution is not None and verdict.hpl_m is not None
        error = to_ned @ (np.array(verdict.solution.position_e) - truth)
        errors.append(error)
        assert np.hypot(*error[:2]) < verdict.hpl_m
    found = np.array(errors)
    assert np.quantile(np.hypot(found[:, 0], found[:, 1]), 0.95) < 2.5
    assert np.quantile(np.linalg.norm(found, axis=1), 0.95) < 4.0


def test_a_station_stands_still_by_its_carrier_phases(station: Station) -> None:
    """Over 30 s nothing would show half a cycle beside the ionosphere: no displacement is called checked."""
    epochs, store, truth = station
    speeds, squares = [], []
    for before, now in pairwise(epochs):
        found = carrier_displacement(before, now, store, truth)
        assert found is not None and not found.checked
        speeds.append(np.linalg.norm(found.displacement_n) / ((now.gps_time_ns - before.gps_time_ns) * 1e-9))
        squares.append(found.displacement_n @ np.linalg.solve(found.cov, found.displacement_n) / 3.0)
    assert len(speeds) == 119 and np.quantile(speeds, 0.95) < 5e-3
    assert np.mean(squares) < 1.0


def pushes(
    station: Station, bias_m: float
) -> Iterator[tuple[SatelliteVerdict, SatelliteId, float | None, float | None]]:
    """Add a pseudorange error to each satellite of every fourth epoch; yield verdict, satellite, MDB and MIB."""
    epochs, store, _ = station
    for epoch in epochs[::4]:
        clean = SatelliteMonitor().evaluate(epoch, store)
        for finding in clean.findings if clean.dof >= 2 else ():
            measurements = tuple(
                replace(
                    measurement,
                    pseudorange_m=measurement.pseudorange_m + bias_m * (measurement.satellite == finding.satellite),
                )
                for measurement in epoch.measurements
            )
            verdict = SatelliteMonitor().evaluate(replace(epoch, measurements=measurements), store)
            yield verdict, finding.satellite, finding.mdb_m, finding.mib_m


@pytest.mark.parametrize("bias_m", [50.0, -50.0])
def test_a_pseudorange_error_of_50_m_is_excluded_in_its_epoch_where_it_is_identifiable(
    station: Station, bias_m: float
) -> None:
    tried = 0
    for verdict, satellite, _, identifiable in pushes(station, bias_m):
        if identifiable is not None and identifiable < 50.0:
            tried += 1
            assert verdict.excluded == (satellite,)
    assert tried > 80


@pytest.mark.parametrize("bias_m", [50.0, -50.0])
def test_a_detectable_pseudorange_error_is_accused_and_its_satellite_excluded_or_suspected(
    station: Station, bias_m: float
) -> None:
    """Where two satellites cannot be separated the other one may be excluded: then both are suspects."""
    wrong = tried = 0
    for verdict, satellite, detectable, _ in pushes(station, bias_m):
        if detectable is not None and detectable < 50.0:
            tried += 1
            assert verdict.outcome == Outcome.ACCUSES
            if satellite not in verdict.excluded:
                wrong += 1
                assert satellite in verdict.suspects and not verdict.fault_free
    assert tried > 150 and wrong < 0.04 * tried


@pytest.fixture(scope="module")
def base_station() -> Station:
    """Epochs of an RTCM stream, and the position of its base station (message 1006).

    That is 318 m from the receiver whose NAV-PVT is in the same log. Without coefficients of the ionosphere, which RTCM
    does not have; it is an hour after midnight there.
    """
    data = (recording("gpsd_receiver_logs/ublox-zed-f9r.log")).read_bytes()
    midnight = datetime(2025, 4, 11, 23, 14, 26) - datetime(1980, 1, 6)  # GPS time has no zone
    messages = [message for _, message in UBXReader(BytesIO(data), protfilter=4)]
    ephemerides, epochs = read_rtcm(messages, round(midnight.total_seconds()) * 10**9)
    store = EphemerisStore()
    for ephemeride in ephemerides:
        store.add(ephemeride)
    base = next(message for message in messages if message.identity == "1006")
    return epochs, store, np.array((base.DF025, base.DF026, base.DF027))


def test_the_solution_of_an_rtcm_stream_is_the_stated_position_of_its_base_station(base_station: Station) -> None:
    epochs, store, truth = base_station
    monitor, errors = SatelliteMonitor(), []
    place = geodetic_from_ecef((truth[0], truth[1], truth[2]))
    to_ned = ned_from_ecef(place.latitude, place.longitude)
    for epoch in epochs:
        verdict = monitor.evaluate(epoch, store)
        assert verdict.outcome == Outcome.PASS and verdict.solution is not None and verdict.dof >= 10
        assert verdict.solution.velocity_e is not None and np.linalg.norm(verdict.solution.velocity_e) < 0.05
        errors.append(to_ned @ (np.array(verdict.solution.position_e) - truth))
    found = np.array(errors)
    assert len(found) == 30 and not store.rejected
    assert np.quantile(np.hypot(found[:, 0], found[:, 1]), 0.95) < 2.5
    assert np.quantile(np.linalg.norm(found, axis=1), 0.95) < 4.0


def test_galileo_ephemerides_give_the_directions_that_the_receiver_states() -> None:
    path = recording("osnma/ublox/ublox_2026_03.ubx")
    store, model, now_ns = EphemerisStore(), ErrorModel(), 0
    here: np.ndarray | None = None
    off: list[tuple[float, float]] = []
    issues: dict[SatelliteId, list[float]] = {}
    with path.open("rb") as file, BytesIO(file.read(1_000_000)) as stream:  # 27 minutes
        for epoch, (_, message) in enumerate(UBXReader(stream, protfilter=2)):
            if message.identity == "NAV-TIMEGAL":
                now_ns = (message.galWno + 1024) * WEEK_NS + message.galTow * 10**9
            elif message.identity == "NAV-PVT" and message.fixType == 3:
                place = Geodetic(radians(message.lat), radians(message.lon), message.height * 1e-3)
                here = np.array(ecef_from_geodetic(place))
            elif message.identity == "RXM-SFRBX" and now_ns:
                satellite = SatelliteId(Constellation.GALILEO, message.svId)
                words = tuple(getattr(message, f"dwrd_{k:02d}") for k in range(1, message.numWords + 1))
                before = store.select(satellite, now_ns)
                after = store.add_words(satellite, words, now_ns)
                if after is not None and not isinstance(before, str) and before.issue != after.issue:
                    apart = [np.array(satellite_state(ephemeris, now_ns).position_e) for ephemeris in (before, after)]
                    issues.setdefault(satellite, []).append(float(np.linalg.norm(apart[1] - apart[0])))
            elif message.identity == "NAV-SAT" and here is not None and epoch % 7 == 0:
                off += list(_angles_off(message, store, now_ns, here, model))
    assert not store.rejected
    assert len(off) > 1000 and np.abs(off).max() < 1.1, "[deg]; whole degrees, and updated every few seconds"
    assert np.abs(np.mean(off, axis=0)).max() < 0.05
    jumps = [jump for issue in issues.values() for jump in issue]
    assert len(jumps) > 10 and np.median(jumps) < 0.5 and max(jumps) < 3.0, "[m] between successive issues"


def _angles_off(
    message: object, store: EphemerisStore, now_ns: int, here: np.ndarray, model: ErrorModel
) -> Iterator[tuple[float, float]]:
    """Elevation and azimuth (along the circle) [deg] less those of NAV-SAT, of satellites with an ephemeris."""
    for k in range(1, message.numSvs + 1):  # type: ignore[attr-defined]
        gnss, number, source, elevation, azimuth = (
            getattr(message, f"{name}_{k:02d}") for name in ("gnssId", "svId", "orbitSource", "elev", "azim")
        )
        ephemeris = store.select(SatelliteId(Constellation.GALILEO, number), now_ns)
        if gnss not in (2, "Galileo") or source != 1 or isinstance(ephemeris, str):
            continue
        state = satellite_state(ephemeris, now_ns, 0.08)
        sight = SatelliteMeasurement(ephemeris.satellite, 0.0, None, None, state.position_e, state.velocity_e)
        geometry = Sky((sight,), now_ns, None, model).geometry(here)
        turn = (degrees(geometry.azimuth[0]) - azimuth + 180.0) % 360.0 - 180.0
        yield degrees(geometry.elevation[0]) - elevation, turn * cos(radians(elevation))


def hypotheses_of(epoch: RawEpoch, store: EphemerisStore) -> tuple[SatelliteVerdict, TrustHypotheses]:
    monitor = SatelliteMonitor()
    verdict = monitor.evaluate(epoch, store)
    return verdict, satellite_hypotheses(monitor.all_in_view(), None, 0, false_alarm_rate=1e-5, risk=1e-3)


def test_every_position_without_a_satellite_is_within_its_level_and_no_separation_is_above_its_limit(
    base_station: Station,
) -> None:
    epochs, store, truth = base_station
    place = geodetic_from_ecef((truth[0], truth[1], truth[2]))
    to_ned, tried = ned_from_ecef(place.latitude, place.longitude), 0
    for epoch in epochs:
        _, said = hypotheses_of(epoch, store)
        assert len(said.solutions) >= 12
        for solution in said.solutions:
            there = Geodetic(
                radians(solution.latitude_deg), radians(solution.longitude_deg), solution.height_ellipsoid_m
            )
            error = to_ned @ (np.array(ecef_from_geodetic(there)) - truth)
            assert np.hypot(*error[:2]) < solution.protection_level_horizontal_m
            assert abs(error[2]) < solution.protection_level_vertical_m
            assert solution.separation is not None and solution.separation_limit is not None
            assert solution.separation < solution.separation_limit
            tried += 1
    assert tried > 400


@pytest.mark.parametrize("bias_m", [50.0, -50.0])
def test_without_the_satellite_that_is_50_m_off_the_residuals_are_the_smallest(
    base_station: Station, bias_m: float
) -> None:
    epochs, store, _ = base_station
    tried = 0
    for epoch in epochs[::10]:
        clean, _ = hypotheses_of(epoch, store)
        for finding in clean.findings:
            if finding.mib_m is None or finding.mib_m >= 50.0:
                continue
            measurements = tuple(
                replace(
                    measurement,
                    pseudorange_m=measurement.pseudorange_m + bias_m * (measurement.satellite == finding.satellite),
                )
                for measurement in epoch.measurements
            )
            _, said = hypotheses_of(replace(epoch, measurements=measurements), store)
            singles = [solution for solution in said.solutions if len(solution.left_out) == 1]
            assert min(singles, key=lambda hypothesis_solution: hypothesis_solution.innovations or 0.0).left_out == (
                str(finding.satellite),
            )
            assert said.solutions[0].left_out == (str(finding.satellite),)
            tried += 1
    assert tried > 30
