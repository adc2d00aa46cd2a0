"""The receivers as JSON for the page GNSS: sky, signals, why a satellite is not used, corrections, configuration."""

from collections.abc import Iterator, Mapping
from math import degrees

from shared.messages.corrections import CorrectionsState
from shared.messages.gnss import Constellation, GnssSignal, Satellite, SignalQuality
from shared.messages.trust import MonitorTest, Outcome, TrustState
from shared.page.answers import Object
from shared.trust.result import SATELLITE_LEFT_OUT, told

from ..history.gnss_history import ReceiverHistory
from ..state import State
from .models.gnss import Receivers, ReceiverShown, SatelliteShown, SignalShown, Tracks

PARSER = "parsers.gnss"
LETTERS = {
    Constellation.GPS: "G", Constellation.GALILEO: "E", Constellation.GLONASS: "R", Constellation.BEIDOU: "C",
    Constellation.QZSS: "J", Constellation.SBAS: "S", Constellation.NAVIC: "I", Constellation.UNKNOWN: "X",
}  # fmt: skip
SIGNAL_BANDS = {"1": "L1", "2": "L2", "5": "L5", "6": "L6", "7": "E5b", "8": "E5"}  # first digit of the RINEX code
GALILEO_BANDS = {"1": "E1", "5": "E5a", "7": "E5b", "8": "E5", "6": "E6"}
BEIDOU_BANDS = {"1": "B1C", "2": "B1I", "5": "B2a", "7": "B2I", "6": "B3I"}
SIGNALS_AGE_NS = 10_000_000_000  # older signals are replaced by those of raw measurements
_QUALITY_REASONS: dict[SignalQuality | None, str] = {
    SignalQuality.NO_SIGNAL: "no signal",
    SignalQuality.SEARCHING: "searched for, no signal yet",
    SignalQuality.ACQUIRED: "signal acquired, not tracked yet",
    SignalQuality.UNUSABLE: "signal detected, but not usable",
}


def gnss(state: State, now_ns: int) -> Receivers:
    """Show each receiver, the one received last first."""
    trust = state.newest(TrustState, "trust/state", now_ns, live=True)
    monitor = next((m for m in trust.monitors if m.monitor == "satellites"), None) if trust else None
    tests = {test.name: test for test in monitor.tests} if monitor else {}
    receivers = sorted(state.gnss.receivers.values(), key=lambda r: -max(r.updated_ns.values(), default=0))
    return {
        "now_ns": now_ns,
        "receivers": [_receiver(receiver, tests, now_ns) for receiver in receivers],
        "corrections": _corrections(state, now_ns),
        "kinds": [kind.model_dump(mode="json") for kind in state.processes[PARSER].kinds],
    }


def tracks(state: State) -> Tracks:
    """Give the tracks of the satellites in the sky: elevation and azimuth in degrees, twice a minute for an hour."""
    return {
        source: {
            f"{LETTERS[Constellation(constellation)]}{number:02d}": [
                (round(elevation), round(azimuth)) for _, elevation, azimuth in track
            ]
            for (constellation, number), track in receiver.tracks.items()
        }
        for source, receiver in state.gnss.receivers.items()
    }


def name_of(constellation: Constellation, number: int) -> str:
    """Name a satellite as RINEX does: G12, E05."""
    return f"{LETTERS[constellation]}{number:02d}"


def why_not_used(satellite: Satellite, mask_rad: float | None) -> str | None:
    """Reason stated by a receiver for not using a satellite; None for one that is used."""
    below = mask_rad is not None and satellite.elevation_rad is not None and satellite.elevation_rad < mask_rad
    reasons = (
        (satellite.healthy is False, "unhealthy, by its own message"),
        (below, f"below the elevation mask of {degrees(mask_rad or 0.0):.0f}°"),
        (satellite.quality in _QUALITY_REASONS, _QUALITY_REASONS.get(satellite.quality)),
        (satellite.cn0_db_hz is None, "no signal"),
        (satellite.orbit_known is False, "orbit not known yet"),
        (satellite.constellation is Constellation.SBAS, "for corrections only"),
        (satellite.quality is SignalQuality.CODE_LOCKED, "code tracked, carrier not"),
    )
    stated = next((reason for holds, reason in reasons if holds), "tracked; the receiver states no reason")
    return None if satellite.used else stated


def _receiver(receiver: ReceiverHistory, tests: Mapping[str, MonitorTest], now_ns: int) -> ReceiverShown:
    fix, quality, configuration = receiver.fix, receiver.quality, receiver.configuration
    mask_rad = configuration.elevation_mask_rad if configuration else None
    return {
        "source": receiver.source,
        "updated_ns": receiver.updated_ns,
        "fix": None if fix is None else fix.model_dump(
            mode="json",
            include={"fix_type", "carrier_solution", "differential", "satellites_used", "pdop", "hdop", "vdop",
                     "correction_age_s", "correction_source", "utc_ns", "baseline_heading_rad", "baseline_length_m"},
        ),
        "satellites": _satellites(receiver, tests, mask_rad),
        "quality": None if quality is None else quality.model_dump(mode="json", exclude={"sampled_ns", "received_ns"}),
        "configuration": None if configuration is None else configuration.model_dump(mode="json"),
        "device": None if receiver.device is None else receiver.device.model_dump(
            mode="json", include={"device", "found", "protocols", "rate_baud", "sentence"}
        ),
        "said": None if receiver.said is None else receiver.said.model_dump(
            mode="json", include={"messages", "gives_position", "other_protocols", "received_bytes", "other_bytes"}
        ),
        "first_fix_s": _first_fix_s(receiver),
        "bands": {
            name: [{"since_ns": ns, "state": state} for ns, state in changes.until(now_ns)]
            for name, changes in (("fix", receiver.fixes), ("correction", receiver.corrections))
        },
    }  # fmt: skip


def _corrections(state: State, now_ns: int) -> Object | None:
    """Where corrections come from, with age and kinds; None of a unit without sources of corrections."""
    stated = state.newest(CorrectionsState, "corrections/state", now_ns, live=True)
    if stated is None:
        return None
    return stated.model_dump(
        mode="json", include={"active", "reason", "protocol", "frame_age_s", "forwarded_bytes", "types", "streams"}
    )


def _first_fix_s(receiver: ReceiverHistory) -> float | None:
    """Time to the first fix: as the receiver states it, otherwise as seen here from its first message on."""
    status = receiver.quality.status if receiver.quality else None
    if status is not None and status.time_to_first_fix_s is not None:
        return round(status.time_to_first_fix_s, 1)
    if receiver.waited_since_ns is None or receiver.first_position_ns is None:
        return None
    return round((receiver.first_position_ns - receiver.waited_since_ns) * 1e-9, 1)


def _satellites(
    receiver: ReceiverHistory, tests: Mapping[str, MonitorTest], mask_rad: float | None
) -> list[SatelliteShown]:
    rows: list[SatelliteShown] = []
    stated = _stated_signals(receiver)
    measured = _measured_signals(receiver)
    for satellite in receiver.satellites.satellites if receiver.satellites else _satellites_of(stated):
        name = name_of(satellite.constellation, satellite.number)
        test = tests.get(name)
        excluded = test is not None and _is_excluded(test)
        rows.append({
            "name": name,
            "constellation": satellite.constellation,
            "elevation_deg": _degrees(satellite.elevation_rad),
            "azimuth_deg": _degrees(satellite.azimuth_rad),
            "cn0_db_hz": satellite.cn0_db_hz,
            "signals": [_signal(gnss_signal, satellite, mask_rad) for gnss_signal in stated.get(name, ())]
            or measured.get(name, []),
            "residual_m": None if satellite.residual_m is None else round(satellite.residual_m, 1),
            "used": satellite.used,
            "excluded": excluded,
            "suspect": test is not None and test.outcome is Outcome.ACCUSES and not excluded,
            "reason": why_not_used(satellite, mask_rad),
            "integrity": None if test is None else told(test),
        })  # fmt: skip
    return rows


def _is_excluded(test: MonitorTest) -> bool:
    """Whether a satellite is left out of the test of the others; of a message without codes it is not known."""
    return test.reason_code is not None and test.reason_code.code == SATELLITE_LEFT_OUT


def _stated_signals(receiver: ReceiverHistory) -> dict[str, list[GnssSignal]]:
    """Signals of each satellite as the receiver states them, unless it has ended to."""
    newest_ns = max(receiver.updated_ns.values(), default=0)
    found: dict[str, list[GnssSignal]] = {}
    if receiver.signals and newest_ns - receiver.updated_ns["signals"] <= SIGNALS_AGE_NS:
        for signal in receiver.signals.signals:
            found.setdefault(name_of(signal.constellation, signal.number), []).append(signal)
    return found


def _satellites_of(stated: Mapping[str, list[GnssSignal]]) -> Iterator[Satellite]:
    """Satellites of a receiver that states signals only: without direction, with the strongest C/N0."""
    for signals in stated.values():
        best = max(signals, key=lambda signal: signal.cn0_db_hz or 0.0)
        yield _as_satellite(best).model_copy(update={"used": any(signal.pseudorange_used for signal in signals)})


def _as_satellite(signal: GnssSignal) -> Satellite:
    return Satellite(
        constellation=signal.constellation, number=signal.number, cn0_db_hz=signal.cn0_db_hz,
        used=signal.pseudorange_used, quality=signal.quality, healthy=signal.healthy,
    )  # fmt: skip


def _signal(signal: GnssSignal, satellite: Satellite, mask_rad: float | None) -> SignalShown:
    """Show one signal; the satellite adds elevation and orbit to the reason why it is not used."""
    of_satellite = {"elevation_rad": satellite.elevation_rad, "orbit_known": satellite.orbit_known}
    reason = why_not_used(_as_satellite(signal).model_copy(update=of_satellite), mask_rad)
    band = band_of(signal.constellation, signal.signal)
    return {"band": band, "cn0_db_hz": signal.cn0_db_hz, "used": signal.pseudorange_used, "reason": reason}


def _measured_signals(receiver: ReceiverHistory) -> dict[str, list[SignalShown]]:
    """C/N0 of each signal of a satellite, of receivers that send raw measurements; these do not state the use."""
    found: dict[str, list[SignalShown]] = {}
    for measured in receiver.epoch.measurements if receiver.epoch else ():
        if measured.cn0_db_hz is not None:
            band, cn0 = band_of(measured.constellation, measured.signal), round(measured.cn0_db_hz, 1)
            rows = found.setdefault(name_of(measured.constellation, measured.number), [])
            rows.append({"band": band, "cn0_db_hz": cn0, "used": None, "reason": None})
    return found


def band_of(constellation: Constellation, code: str | None) -> str:
    """Name the band of a signal by the first digit of its RINEX code: L2, E5b; "-" for an unknown signal."""
    bands = {Constellation.GALILEO: GALILEO_BANDS, Constellation.BEIDOU: BEIDOU_BANDS}.get(constellation, SIGNAL_BANDS)
    return bands.get((code or "")[:1], code) or "-"


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else round(degrees(angle_rad), 1)
