"""Raw measurements of Android, one signal a row, and the time of the receiver's clock."""

from shared.maths.dates import NS, WEEK_NS
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.gnss import Constellation, RawMeasurement
from shared.protocols.gnss_logger import Row, integer, number

L1_HZ = 1_575_420_030.0
RANGES_M = (1.5e7, 6e7)  # pseudoranges of satellites in medium and geostationary orbits
MAX_SV_TIME_SD_NS = 500.0
MAX_CYCLES = 1e10
# Bits of State. A time of week or of day is decoded from this satellite, or known from others. A Galileo E1 signal has
# a bit of its own for the lock to its code.
CODE_LOCK = 1 | 1 << 10  # STATE_CODE_LOCK, STATE_GAL_E1BC_CODE_LOCK
TIME_OF_WEEK = 1 << 3 | 1 << 14  # STATE_TOW_DECODED, STATE_TOW_KNOWN
TIME_OF_DAY = 1 << 7 | 1 << 15  # STATE_GLO_TOD_DECODED, STATE_GLO_TOD_KNOWN
RANGE_VALID, RANGE_INTERRUPTED, HALF_CYCLE_RESOLVED = 1, 2 | 4, 8  # bits of AccumulatedDeltaRangeState
# Time of each system behind GPS time [ns]; GLONASS gives the time of day instead and is not read.
SYSTEMS = {
    1: (Constellation.GPS, 0), 4: (Constellation.QZSS, 0), 5: (Constellation.BEIDOU, 14 * NS),
    6: (Constellation.GALILEO, 0),
}  # fmt: skip
GLONASS = 3
# Observation codes by constellation and band; the band is known by its frequency [MHz].
SIGNALS = {
    (Constellation.GPS, 1575): "1C", (Constellation.GPS, 1176): "5Q", (Constellation.QZSS, 1575): "1C",
    (Constellation.QZSS, 1176): "5Q", (Constellation.GALILEO, 1575): "1C", (Constellation.GALILEO, 1176): "5Q",
    (Constellation.BEIDOU, 1561): "2I", (Constellation.BEIDOU, 1176): "5P", (Constellation.BEIDOU, 1575): "1P",
}  # fmt: skip


def gps_time_ns(row: Row) -> int | None:
    """GPS time [ns] of the receiver's clock; None without it."""
    time_ns, bias_ns = integer(row, "timenanos"), integer(row, "fullbiasnanos")
    if time_ns is None or not bias_ns:
        return None
    return time_ns - bias_ns - round(number(row, "biasnanos") or 0.0)


def measurement(row: Row, gps_ns: int, *, clock_stepped: bool = False) -> RawMeasurement | str:
    """One signal, or why it is rejected; a phase after a step of the receiver's clock begins again.

    Notes
    -----
    With the times of reception and transmission by the receiver's clock and by the satellite's::

        t_rx = TimeNanos - (FullBiasNanos + BiasNanos),    t_tx = ReceivedSvTimeNanos
        pseudorange = c ((t_rx + TimeOffsetNanos - t_system - t_tx) mod week)

    References
    ----------
    European GNSS Agency, Using GNSS raw measurements on Android devices, 2017, section 2.4.
    """
    system, satellite, state = (integer(row, name) for name in ("constellationtype", "svid", "state"))
    sent_ns, offset_ns = integer(row, "receivedsvtimenanos"), number(row, "timeoffsetnanos") or 0.0
    if reason := _without_time(system, state or 0):
        return reason
    if system not in SYSTEMS or satellite is None or not 0 < satellite < 300:
        return "constellation"
    sent_sd_ns = number(row, "receivedsvtimeuncertaintynanos")
    if sent_ns is None or sent_sd_ns is None or not 0.0 <= sent_sd_ns <= MAX_SV_TIME_SD_NS:
        return "time of transmission"
    constellation, behind_ns = SYSTEMS[system]
    flight_ns = (gps_ns - behind_ns - sent_ns + WEEK_NS // 2) % WEEK_NS - WEEK_NS // 2 + offset_ns
    pseudorange = flight_ns / NS * SPEED_OF_LIGHT
    if not RANGES_M[0] <= pseudorange <= RANGES_M[1]:
        return "pseudorange beyond any orbit"
    frequency = number(row, "carrierfrequencyhz") or L1_HZ
    if not 1.1e9 <= frequency <= 1.7e9:
        return "carrier frequency"
    wavelength = SPEED_OF_LIGHT / frequency
    rate, rate_sd = (
        number(row, "pseudorangeratemeterspersecond"), number(row, "pseudorangerateuncertaintymeterspersecond")
    )  # fmt: skip
    phase_state, distance = integer(row, "accumulateddeltarangestate") or 0, number(row, "accumulateddeltarangemeters")
    cycles = distance / wavelength if phase_state & RANGE_VALID and distance is not None else None
    return RawMeasurement(
        constellation=constellation, number=satellite, signal=SIGNALS.get((constellation, int(frequency // 1e6))),
        pseudorange_m=pseudorange, pseudorange_sd_m=max(sent_sd_ns, 1.0) / NS * SPEED_OF_LIGHT,
        carrier_phase_cycles=cycles if cycles is not None and abs(cycles) < MAX_CYCLES else None,
        half_cycle_resolved=bool(phase_state & HALF_CYCLE_RESOLVED),
        lock_time_s=0.0 if clock_stepped or phase_state & RANGE_INTERRUPTED else None,  # reset, or a cycle slip
        doppler_hz=None if rate is None else -rate / wavelength,
        doppler_sd_hz=None if rate_sd is None else rate_sd / wavelength, cn0_db_hz=number(row, "cn0dbhz"),
    )  # fmt: skip


def _without_time(system: int | None, state: int) -> str:
    """Why the time of transmission of a signal is not known, or not used; empty where it is."""
    if not state & CODE_LOCK:
        return "no lock to the code"
    if system == GLONASS:
        return "GLONASS is not used" if state & TIME_OF_DAY else "no time of day"
    return "" if state & TIME_OF_WEEK else "no time of week"
