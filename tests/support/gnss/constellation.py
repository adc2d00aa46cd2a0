"""A synthetic GPS and Galileo constellation, raw epochs of it, and the navigation words that it broadcasts."""

from dataclasses import fields, replace
from math import cos, pi, radians, sin

import numpy as np
import numpy.typing as npt

from services.core.cooperative.broadcast.ephemeris import Ephemeris, satellite_state
from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.measurements import (
    WEEK_NS,
    Constellation,
    Measurement,
    RawEpoch,
    SatelliteId,
)
from services.core.cooperative.satellites.model import ErrorModel, SatelliteMeasurement, Sky
from services.sensors.simulator.gnss.navigation_words import Elements, inav_page, lnav_subframe
from shared.maths.gnss_signals import EARTH_RATE, L1_FREQUENCY, SPEED_OF_LIGHT, Klobuchar

NS = 1_000_000_000
FloatArray = npt.NDArray[np.float64]
NOW_NS = 2300 * WEEK_NS + 200_000 * 1_000_000_000
TOE_NS = 2300 * WEEK_NS + 201_600 * 1_000_000_000
IONOSPHERE = Klobuchar((1.118e-8, 1.49e-8, -5.96e-8, -5.96e-8), (88060.0, 16380.0, -196600.0, -131100.0))


def ephemeris(satellite: SatelliteId, plane: float, place: float) -> Ephemeris:
    """An orbit in a plane and at a place in it [rad], with ordinary corrections."""
    gps = satellite.constellation == Constellation.GPS
    return Ephemeris(
        satellite, 57, TOE_NS, TOE_NS, sqrt_a=5153.65 if gps else 5440.61, eccentricity=0.008 if gps else 0.0003,
        mean_anomaly=place, mean_motion_difference=4.5e-9, node=plane, node_rate=-8.0e-9,
        inclination=0.965 if gps else 0.977, inclination_rate=2e-10, perigee=0.7, cuc=-2e-6, cus=6e-6, crc=250.0,
        crs=-40.0, cic=1e-7, cis=-8e-8, clock=(1.5e-4 - 1e-6 * satellite.number, 2e-12, 0.0), group_delay_s=-8e-9,
        healthy=True, accuracy_m=2.4,
    )  # fmt: skip


def constellation() -> list[Ephemeris]:
    """24 satellites of each system."""
    found = []
    for system, planes in ((Constellation.GPS, 6), (Constellation.GALILEO, 3)):
        slots = 24 // planes
        for k in range(24):
            plane, slot = divmod(k, slots)
            place = 2.0 * pi * (slot / slots + plane / 24.0) + 0.3 * plane
            found.append(ephemeris(SatelliteId(system, k + 1), 2.0 * pi * plane / planes - 3.0, place % (2 * pi) - pi))
    return found


def filled_store() -> EphemerisStore:
    store = EphemerisStore()
    for ephemeris in constellation():
        store.add(ephemeris)
    store.ionosphere = IONOSPHERE
    return store


def sight_of(one: Ephemeris, position_e: FloatArray, gps_time_ns: int) -> tuple[float, SatelliteMeasurement]:
    """Geometric range [m] with the rotation of the Earth during transmission, and the apparent satellite position."""
    flight = 0.07
    for _ in range(6):
        state = satellite_state(one, gps_time_ns, flight)
        x, y, z = state.position_e
        turn = EARTH_RATE * flight
        seen = np.array([x * cos(turn) + y * sin(turn), y * cos(turn) - x * sin(turn), z])
        flight = float(np.linalg.norm(seen - position_e)) / SPEED_OF_LIGHT
    return flight * SPEED_OF_LIGHT, SatelliteMeasurement(
        one.satellite, 0.0, None, None, state.position_e, state.velocity_e
    )


def raw_epoch(
    position_e: FloatArray,
    *,
    velocity_e: FloatArray | None = None,
    clock_m: float = 45.0,
    galileo_clock_m: float = 51.0,
    drift: float = 3.0,
    gps_time_ns: int = NOW_NS,
    rng: np.random.Generator | None = None,
    mask_deg: float = 10.0,
    systems: tuple[Constellation, ...] = (Constellation.GPS, Constellation.GALILEO),
) -> RawEpoch:
    """Measurements of all satellites above a mask, with the noise that the error model expects, or without any."""
    model = ErrorModel()
    velocity_e = np.zeros(3) if velocity_e is None else velocity_e
    measurements = []
    for ephemeris in constellation():
        if ephemeris.satellite.constellation not in systems:
            continue
        distance, sight = sight_of(ephemeris, position_e, gps_time_ns)
        geometry = Sky((sight,), gps_time_ns, IONOSPHERE, model).geometry(position_e)
        if geometry.elevation[0] < radians(mask_deg):
            continue
        own = clock_m if ephemeris.satellite.constellation == Constellation.GPS else galileo_clock_m
        state = satellite_state(ephemeris, gps_time_ns, distance / SPEED_OF_LIGHT)
        # The time tag has the clock error of the receiver, and so has the transmission time derived from it.
        pseudorange = distance + own - SPEED_OF_LIGHT * state.clock_s + float(geometry.delay[0])
        sight_e = geometry.ned_from_ecef.T @ geometry.line_of_sight_n[0]
        satellite_e = geometry.ned_from_ecef.T @ geometry.satellite_velocity_n[0]
        rate = float(sight_e @ (satellite_e - velocity_e)) + drift - SPEED_OF_LIGHT * state.clock_drift
        if rng is not None:
            pseudorange += float(geometry.sd[0]) * rng.standard_normal()
            rate += model.range_rate_sd_m_s * rng.standard_normal()
        measurements.append(Measurement(ephemeris.satellite, pseudorange, -rate * L1_FREQUENCY / SPEED_OF_LIGHT, 48.0))
    # receiver stamps are ahead by its clock error
    return RawEpoch(gps_time_ns + round(clock_m / SPEED_OF_LIGHT * 1e9), tuple(measurements))


def pushed(epoch: RawEpoch, satellite: SatelliteId, bias_m: float) -> RawEpoch:
    """The epoch with a bias on one pseudorange."""
    return replace(
        epoch,
        measurements=tuple(
            replace(measurement, pseudorange_m=measurement.pseudorange_m + bias_m)
            if measurement.satellite == satellite
            else measurement
            for measurement in epoch.measurements
        ),
    )


def elements(one: Ephemeris) -> Elements:
    """Navigation words that the simulated satellite broadcasts for an ephemeris."""
    names = (field.name for field in fields(Elements) if field.name != "number")
    return Elements(number=one.satellite.number, **{name: getattr(one, name) for name in names})


def lnav_subframes(one: Ephemeris, sent_ns: int) -> list[tuple[int, ...]]:
    """Subframes 1, 2 and 3."""
    return [lnav_subframe(elements(one), number, sent_ns // NS + 6 * (number - 1)) for number in (1, 2, 3)]


def inav_pages(one: Ephemeris, sent_ns: int) -> list[tuple[int, ...]]:
    """Words 1 to 5."""
    return [inav_page(elements(one), kind, sent_ns // NS) for kind in range(1, 6)]
