"""Raw measurements and navigation words of UBX: RXM-RAWX and RXM-SFRBX.

They are unpacked here as NAV-SAT is: pyubx2 needs 2.5 ms for 32 measurements.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), sections 1.5 and 3.17 UBX-RXM.
"""

import struct
from collections import Counter
from dataclasses import dataclass
from math import isfinite

from shared.maths.dates import NS, WEEK_NS
from shared.messages.gnss import MAX_NAVIGATION_WORDS, Constellation, RawMeasurement

from ..gnss_time import MAXIMUM_LEAP_S
from .messages import SIGNALS, UbxError, constellation_of

KINDS = ("SFRBX", "RAWX")  # of RXM
GLONASS = 6  # gnssId
CHANNELS, CHANNEL_OFFSET = range(14), 7  # freqId of GLONASS, and what it exceeds the frequency number by
MAX_PSEUDORANGE_M = 1e8  # satellites in geostationary orbits are 42,000 km away; a receiver's clock adds up to 300 km
MAX_DOPPLER_HZ = 1e5
MAX_CYCLES = 1e10
# Whose navigation words are used, by (gnssId, sigId): L1 C/A, and I/NAV of E1-B, whose signal version 1 leaves at 0.
NAVIGATION_SIGNALS = {(0, 0): "1C", (2, 0): "1B", (2, 1): "1B"}
NAVIGATION_WORDS = {0: 10, 2: 8}  # of a subframe of L1 C/A, of a page of E1-B
_HEAD = struct.Struct("<dHbBB3x")
_MEASUREMENT = struct.Struct("<ddfBBBBHBBBBBx")
_CLOCK_RESET, _LEAP_KNOWN = 2, 1
_PSEUDORANGE_VALID, _CARRIER_VALID, _HALF_CYCLE = 1, 2, 4
_NO_CARRIER_SD = 15


@dataclass(frozen=True, slots=True)
class RawEpoch:
    """UBX-RXM-RAWX."""

    gps_time_ns: int
    leap_seconds: int | None
    clock_reset: bool
    measurements: tuple[RawMeasurement, ...]

    @property
    def itow_ms(self) -> int:
        """Time of week."""
        return round(self.gps_time_ns % WEEK_NS / 1_000_000)


@dataclass(frozen=True, slots=True)
class NavigationBits:
    """UBX-RXM-SFRBX of a signal whose words are used."""

    constellation: Constellation
    number: int
    signal: str
    words: tuple[int, ...]


def decode_raw(payload: bytes, rejects: Counter[str]) -> RawEpoch:
    """Decode UBX-RXM-RAWX.

    Parameters
    ----------
    payload : bytes
        Of any length and content.
    rejects : Counter of str
        Counts `ubx_pseudorange`, `ubx_carrier_phase` and `ubx_doppler` of values that are called valid and cannot be;
        such a value is None.

    Raises
    ------
    UbxError
        Length or time of week cannot be.

    Notes
    -----
    The week is as told: `DeviceDates` judges it. Standard deviations are 0.01 m 2^n, 0.004 cycles n and 0.002 Hz 2^n.
    """
    if len(payload) < _HEAD.size:
        raise UbxError("short")
    tow_s, week, leap_s, count, status = _HEAD.unpack_from(payload)
    if len(payload) != _HEAD.size + count * _MEASUREMENT.size:
        raise UbxError("short")
    if not 0.0 <= tow_s < WEEK_NS / NS:
        raise UbxError("time_of_week")
    known = status & _LEAP_KNOWN and 0 <= leap_s <= MAXIMUM_LEAP_S
    return RawEpoch(
        gps_time_ns=week * WEEK_NS + round(tow_s * NS),
        leap_seconds=leap_s if known else None,
        clock_reset=bool(status & _CLOCK_RESET),
        measurements=tuple(_measurement(fields, rejects) for fields in _MEASUREMENT.iter_unpack(payload[_HEAD.size :])),
    )


def _measurement(fields: tuple[float | int, ...], rejects: Counter[str]) -> RawMeasurement:
    code_m, cycles, doppler_hz = fields[:3]
    system, number, signal, channel, lock_ms, cn0, code_sd, carrier_sd, doppler_sd, status = map(int, fields[3:])
    pseudorange = _plausible(code_m, 0.0, MAX_PSEUDORANGE_M, "pseudorange", rejects, valid=status & _PSEUDORANGE_VALID)
    carrier = _plausible(cycles, -MAX_CYCLES, MAX_CYCLES, "carrier_phase", rejects, valid=status & _CARRIER_VALID)
    doppler = _plausible(doppler_hz, -MAX_DOPPLER_HZ, MAX_DOPPLER_HZ, "doppler", rejects, valid=1)
    known_carrier_sd = carrier is not None and carrier_sd & 15 != _NO_CARRIER_SD
    return RawMeasurement(
        constellation=constellation_of(system),
        number=number,
        signal=SIGNALS.get((system, signal)),
        glonass_frequency_number=channel - CHANNEL_OFFSET if system == GLONASS and channel in CHANNELS else None,
        pseudorange_m=pseudorange,
        pseudorange_sd_m=None if pseudorange is None else 0.01 * 2.0 ** (code_sd & 15),
        carrier_phase_cycles=carrier,
        carrier_phase_sd_cycles=0.004 * (carrier_sd & 15) if known_carrier_sd else None,
        half_cycle_resolved=bool(status & _HALF_CYCLE),
        doppler_hz=doppler,
        doppler_sd_hz=None if doppler is None else 0.002 * 2.0 ** (doppler_sd & 15),
        cn0_db_hz=float(cn0) if cn0 else None,
        lock_time_s=lock_ms * 1e-3,
    )


def _plausible(value: float, low: float, high: float, name: str, rejects: Counter[str], *, valid: int) -> float | None:
    """A value that the receiver calls valid, strictly between two limits; one outside is counted and None."""
    if not valid:
        return None
    if isfinite(value) and low < value < high:
        return value
    rejects[f"ubx_{name}"] += 1
    return None


def decode_navigation_bits(payload: bytes) -> NavigationBits | None:
    """Decode UBX-RXM-SFRBX; None for a signal whose words nobody uses.

    Raises
    ------
    UbxError
        The length is not that of so many words, or a subframe or page has another number of them.
    """
    if len(payload) < 8:
        raise UbxError("short")
    system, number, signal, _, count = payload[:5]
    if len(payload) != 8 + 4 * count or count > MAX_NAVIGATION_WORDS:
        raise UbxError("short")
    name = NAVIGATION_SIGNALS.get((system, signal))
    if name is None:
        return None
    if count < NAVIGATION_WORDS[system]:
        raise UbxError("navigation_words")
    words = struct.unpack_from(f"<{NAVIGATION_WORDS[system]}I", payload, 8)
    return NavigationBits(constellation_of(system), number, name, words)
