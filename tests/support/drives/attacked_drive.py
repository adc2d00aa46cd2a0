"""A simulated drive under attack as the parsers read it, and least squares of its raw measurements."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import radians

import numpy as np
import numpy.typing as npt

from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.measurements import Constellation, Measurement, RawEpoch, SatelliteId
from services.core.cooperative.satellites.model import ErrorModel, Sky, usable_sights
from services.core.cooperative.satellites.solution import fit_position, fit_velocity, solution_of
from services.parsers.can.process import Config as CanConfig
from services.parsers.can.process import Process as CanProcess
from services.parsers.gnss.process import Config, Process
from services.sensors.simulator.gnss.raw_measurements import IONOSPHERE
from services.sensors.simulator.world import DEFAULT_START_NS, messages
from shared.attacks import schedule
from shared.maths.earth import Geodetic, geodetic_from_ecef, ned_from_ecef, ned_from_geodetic_difference
from shared.messages.base import Message
from shared.messages.gnss import GnssFix, GnssNavigationBits, GnssRaw, GnssRawEpoch, GnssSatellites
from shared.messages.navigation import TruthState
from shared.messages.simulation import SimulationState
from shared.messages.vehicle import CanRaw, VehicleSpeed, WheelSpeeds
from shared.runtime.config import load_vehicle
from tests.support.data import REPOSITORY

FloatArray = npt.NDArray[np.float64]
NS = 1_000_000_000
# Equal weights: the residuals are orthogonal to position and clock in the plain sense.
EQUAL = ErrorModel(elevation_mask_rad=radians(5.0), signal_in_space_sd_m=1e5, range_rate_sd_m_s=1.0, min_cn0_db_hz=0.0)


def place(fix: GnssFix) -> Geodetic:
    assert fix.latitude_deg is not None and fix.longitude_deg is not None and fix.height_ellipsoid_m is not None
    return Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), fix.height_ellipsoid_m)


@dataclass(frozen=True)
class EpochSolution:
    """Least squares of one epoch of raw measurements against the fix of the same epoch."""

    t_s: float  # since the start of the drive
    position_n: FloatArray  # [m, NED] minus that of the fix
    velocity_n: FloatArray  # [m/s, NED] minus that of the fix
    clock_m: float
    drift_m_s: float
    residuals_m: FloatArray
    satellites: tuple[SatelliteId, ...]


class Drive:
    """All messages of a drive by type."""

    def __init__(self, stream: list[Message]) -> None:
        self.fixes = [m for m in stream if isinstance(m, GnssFix) and not m.source.endswith("/nmea")]
        self.epochs = [m for m in stream if isinstance(m, GnssRawEpoch)]
        self.skies = [m for m in stream if isinstance(m, GnssSatellites)]
        self.truth = [m for m in stream if isinstance(m, TruthState)]
        self.wheels = [m for m in stream if isinstance(m, WheelSpeeds)]
        self.speeds = [m for m in stream if isinstance(m, VehicleSpeed)]
        self.states = [m for m in stream if isinstance(m, SimulationState)]
        self.raw = [m for m in stream if isinstance(m, GnssRaw | CanRaw)]
        self._bits = [m for m in stream if isinstance(m, GnssNavigationBits)]

    def between(self, begin_s: float, end_s: float) -> list[GnssFix]:
        """Fixes of a part of the drive."""
        return [f for f in self.fixes if begin_s <= seconds(f.sampled_ns) < end_s]

    def solved(self, begin_s: float, end_s: float, without: SatelliteId | None = None) -> Iterator[EpochSolution]:
        """Least squares of each epoch that has raw measurements with ephemerides."""
        fixes = {f.sampled_ns: f for f in self.fixes if f.latitude_deg is not None}
        for epoch in self.epochs:
            fix = fixes.get(epoch.sampled_ns)
            if fix is not None and begin_s <= seconds(epoch.sampled_ns) < end_s:
                yield self._solve(fix, epoch, without)

    def _solve(self, fix: GnssFix, epoch: GnssRawEpoch, without: SatelliteId | None) -> EpochSolution:
        store = self._store
        raw = RawEpoch(epoch.gps_time_ns, tuple(
            one for m in epoch.measurements if m.pseudorange_m is not None
            if (one := Measurement(SatelliteId(Constellation(m.constellation.value), m.number), m.pseudorange_m,
                                   m.doppler_hz)).satellite != without
        ))  # fmt: skip
        sights, rejected = usable_sights(raw, store, EQUAL)
        assert not rejected
        found = fit_position(Sky(sights, epoch.gps_time_ns, IONOSPHERE, EQUAL), None)
        assert found is not None
        velocity = fit_velocity(found, 1e-9)
        assert velocity is not None and fix.velocity_ned_m_s is not None
        x, y, z = solution_of(found, velocity).position_e
        here = geodetic_from_ecef((x, y, z))
        velocity_n = ned_from_ecef(here.latitude, here.longitude) @ np.array(velocity.velocity_e)
        return EpochSolution(
            seconds(epoch.sampled_ns),
            np.array(ned_from_geodetic_difference(here, place(fix))),
            velocity_n - fix.velocity_ned_m_s,
            float(found.fit.parameters[3 + found.clocks[Constellation.GPS]]),
            float(velocity.drift),
            found.fit.residuals,
            tuple(sight.satellite for sight in sights),
        )

    @cached_property
    def _store(self) -> EphemerisStore:
        """What all satellites have sent; the time tells only in which week that was."""
        store = EphemerisStore()
        for bits in self._bits:
            store.add_words(
                SatelliteId(Constellation(bits.constellation.value), bits.number),
                bits.words,
                self.epochs[0].gps_time_ns,
            )
        store.ionosphere = IONOSPHERE
        return store


def seconds(stamp_ns: int) -> float:
    """Time since the start of the drive."""
    return (stamp_ns - DEFAULT_START_NS) / NS


@lru_cache(maxsize=32)
def attacked(*texts: str, scenario: str = "parking_lot", seed: int = 1, duration_s: float = 52.0) -> Drive:
    """Simulate a drive with attacks, and parse the bytes of its devices."""
    vehicle = load_vehicle(REPOSITORY / "deploy" / "vehicles" / "simulated.toml")
    gnss, can = Process(Config()), CanProcess(vehicle.section("parsers.can", CanConfig))
    stream: list[Message] = []
    for message in messages(scenario, seed, duration_s, attacks=[schedule(text) for text in texts]):
        stream.append(message)
        if isinstance(message, GnssRaw):
            stream += gnss.handle(message)
        elif isinstance(message, CanRaw):
            stream += can.handle(message)
    assert not gnss.rejects and not can.rejects
    return Drive(stream)
