"""A synthetic GPS and Galileo constellation, raw epochs of it, and the navigation words that it broadcasts."""

from dataclasses import replace
from math import cos, pi, radians, sin

import numpy as np
import numpy.typing as npt

from services.core.cooperative.broadcast.ephemeris import Ephemeris, satellite_state
from services.core.cooperative.broadcast.galileo_inav import crc24q
from services.core.cooperative.broadcast.gps_lnav import Klobuchar, parity
from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.measurements import (
    L1_FREQUENCY,
    SPEED_OF_LIGHT,
    WEEK_NS,
    Constellation,
    Measurement,
    RawEpoch,
    SatelliteId,
)
from services.core.cooperative.satellites.model import ErrorModel, Sight, Sky

FloatArray = npt.NDArray[np.float64]
NOW_NS = 2300 * WEEK_NS + 200_000 * 1_000_000_000
TOE_NS = 2300 * WEEK_NS + 201_600 * 1_000_000_000
EARTH_RATE = 7.2921151467e-5  # [rad/s]
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
    for one in constellation():
        store.add(one)
    store.ionosphere = IONOSPHERE
    return store


def sight_of(one: Ephemeris, position_e: FloatArray, gps_time_ns: int) -> tuple[float, Sight]:
    """Geometric range [m] with the Earth turning while the signal is under way, and the satellite as it was seen."""
    flight = 0.07
    for _ in range(6):
        state = satellite_state(one, gps_time_ns, flight)
        x, y, z = state.position_e
        turn = EARTH_RATE * flight
        seen = np.array([x * cos(turn) + y * sin(turn), y * cos(turn) - x * sin(turn), z])
        flight = float(np.linalg.norm(seen - position_e)) / SPEED_OF_LIGHT
    return flight * SPEED_OF_LIGHT, Sight(one.satellite, 0.0, None, None, state.position_e, state.velocity_e)


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
    for one in constellation():
        if one.satellite.constellation not in systems:
            continue
        distance, sight = sight_of(one, position_e, gps_time_ns)
        geometry = Sky((sight,), gps_time_ns, IONOSPHERE, model).geometry(position_e)
        if geometry.elevation[0] < radians(mask_deg):
            continue
        own = clock_m if one.satellite.constellation == Constellation.GPS else galileo_clock_m
        state = satellite_state(one, gps_time_ns, distance / SPEED_OF_LIGHT)
        # The time tag is the receiver's: it is late by its clock, and so is the transmission it measures from.
        pseudorange = distance + own - SPEED_OF_LIGHT * state.clock_s + float(geometry.delay[0])
        sight_e = geometry.ned_from_ecef.T @ geometry.line_of_sight_n[0]
        satellite_e = geometry.ned_from_ecef.T @ geometry.satellite_velocity_n[0]
        rate = float(sight_e @ (satellite_e - velocity_e)) + drift - SPEED_OF_LIGHT * state.clock_drift
        if rng is not None:
            pseudorange += float(geometry.sd[0]) * rng.standard_normal()
            rate += model.range_rate_sd_m_s * rng.standard_normal()
        measurements.append(Measurement(one.satellite, pseudorange, -rate * L1_FREQUENCY / SPEED_OF_LIGHT, 48.0))
    # what the receiver stamps runs ahead by its clock
    return RawEpoch(gps_time_ns + round(clock_m / SPEED_OF_LIGHT * 1e9), tuple(measurements))


def pushed(epoch: RawEpoch, satellite: SatelliteId, bias_m: float) -> RawEpoch:
    """The epoch with a bias on one pseudorange."""
    return replace(
        epoch,
        measurements=tuple(
            replace(one, pseudorange_m=one.pseudorange_m + bias_m) if one.satellite == satellite else one
            for one in epoch.measurements
        ),
    )


class Packer:
    """Concatenates fields of a navigation message, the most significant bit first."""

    def __init__(self) -> None:
        self.text = ""

    def put(self, value: int, bits: int) -> "Packer":
        self.text += format(value & ((1 << bits) - 1), f"0{bits}b")
        return self

    def scaled(self, value: float, bits: int, power: int, unit: float = 1.0) -> "Packer":
        """A value in units of 2^-power."""
        return self.put(round(value / unit * 2.0**power), bits)


SEMICIRCLE = 3.1415926535898


def lnav_words(data: str) -> tuple[int, ...]:
    """240 data bits as ten words with parity, as they are after the complement by D30* was undone."""
    words = []
    for k in range(0, 240, 24):
        word = int(data[k : k + 24], 2) << 6
        words.append(word | parity(word))
    return tuple(words)


def _lnav_head(number: int, tow_s: int) -> Packer:
    return Packer().put(0x8B, 8).put(0, 16).put(tow_s // 6, 17).put(0, 2).put(number, 3).put(0, 2)


def lnav_subframes(one: Ephemeris, sent_ns: int) -> list[tuple[int, ...]]:
    """Subframes 1, 2 and 3."""
    week, tow = divmod(sent_ns, WEEK_NS)
    tow_s = tow // 1_000_000_000
    toe, toc = (time_ns % WEEK_NS // 16_000_000_000 for time_ns in (one.toe_ns, one.toc_ns))
    first = _lnav_head(1, tow_s).put(week, 10).put(1, 2).put(0, 4).put(0 if one.healthy else 63, 6)
    first.put(one.issue >> 8, 2).put(0, 88).scaled(one.group_delay_s, 8, 31).put(one.issue, 8).put(toc, 16)
    first.scaled(one.clock[2], 8, 55).scaled(one.clock[1], 16, 43).scaled(one.clock[0], 22, 31).put(0, 2)
    second = _lnav_head(2, tow_s + 6).put(one.issue, 8).scaled(one.crs, 16, 5)
    second.scaled(one.mean_motion_difference, 16, 43, SEMICIRCLE).scaled(one.mean_anomaly, 32, 31, SEMICIRCLE)
    second.scaled(one.cuc, 16, 29).scaled(one.eccentricity, 32, 33).scaled(one.cus, 16, 29).scaled(one.sqrt_a, 32, 19)
    second.put(toe, 16).put(0, 8)
    third = _lnav_head(3, tow_s + 12).scaled(one.cic, 16, 29).scaled(one.node, 32, 31, SEMICIRCLE)
    third.scaled(one.cis, 16, 29).scaled(one.inclination, 32, 31, SEMICIRCLE).scaled(one.crc, 16, 5)
    third.scaled(one.perigee, 32, 31, SEMICIRCLE).scaled(one.node_rate, 24, 43, SEMICIRCLE).put(one.issue, 8)
    third.scaled(one.inclination_rate, 14, 43, SEMICIRCLE).put(0, 2)
    return [lnav_words(packer.text) for packer in (first, second, third)]


def inav_pages(one: Ephemeris, sent_ns: int) -> list[tuple[int, ...]]:
    """Words 1 to 5."""
    week, tow = divmod(sent_ns - 1024 * WEEK_NS, WEEK_NS)
    toe, toc = (time_ns % WEEK_NS // 60_000_000_000 for time_ns in (one.toe_ns, one.toc_ns))
    words = [Packer().put(kind, 6) for kind in range(1, 6)]
    for word in words[:4]:
        word.put(one.issue, 10)
    words[0].put(toe, 14).scaled(one.mean_anomaly, 32, 31, SEMICIRCLE).scaled(one.eccentricity, 32, 33)
    words[0].scaled(one.sqrt_a, 32, 19).put(0, 2)
    words[1].scaled(one.node, 32, 31, SEMICIRCLE).scaled(one.inclination, 32, 31, SEMICIRCLE)
    words[1].scaled(one.perigee, 32, 31, SEMICIRCLE).scaled(one.inclination_rate, 14, 43, SEMICIRCLE).put(0, 2)
    words[2].scaled(one.node_rate, 24, 43, SEMICIRCLE).scaled(one.mean_motion_difference, 16, 43, SEMICIRCLE)
    words[2].scaled(one.cuc, 16, 29).scaled(one.cus, 16, 29).scaled(one.crc, 16, 5).scaled(one.crs, 16, 5).put(107, 8)
    words[3].put(one.satellite.number, 6).scaled(one.cic, 16, 29).scaled(one.cis, 16, 29).put(toc, 14)
    words[3].scaled(one.clock[0], 31, 34).scaled(one.clock[1], 21, 46).scaled(one.clock[2], 6, 59).put(0, 2)
    words[4].put(0, 11 + 11 + 14 + 5 + 10).scaled(one.group_delay_s, 10, 32).put(0, 2).put(0 if one.healthy else 1, 2)
    words[4].put(0, 2).put(week, 12).put(tow // 1_000_000_000, 20).put(0, 23)
    return [inav_page(word.text) for word in words]


def inav_page(word: str) -> tuple[int, ...]:
    """128 bits of a word as the eight words of a page, with CRC."""
    even = "00" + word[:112] + "000000"
    odd = "10" + word[112:] + "0" * 64
    crc = crc24q(int(even[:114] + odd, 2), 196)
    bits = even.ljust(128, "0") + (odd + format(crc, "024b")).ljust(128, "0")
    return tuple(int(bits[k : k + 32], 2) for k in range(0, 256, 32))
