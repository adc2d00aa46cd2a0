"""Velocity of recorded phones at rest, by carrier phases and by Doppler: the paper has 9.7 mm/s.

The recordings hold satellite positions, velocities and clocks beside the measurements of each second.
"""

import csv
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import pairwise
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np

from services.core.cooperative.carrier.displacement import CarrierModel, Displacement, PhaseChange, displacement_by
from services.core.cooperative.measurements import Constellation, SatelliteId
from services.core.cooperative.satellites.model import ErrorModel, SatelliteMeasurement, noise_factor
from shared.maths.dates import GPS_EPOCH_UTC_NS, NS

RECORDING = "gsdc_samples"
PHONES = {  # at rest, by their ground truth: 1 to 3 mm/s
    "Pixel 4, 2021": "2022_device_gnss.csv",
    "Pixel 7 Pro, 2023": "2023_2023-09-07-18-59-us-ca_pixel7pro_device_gnss.csv",
}
LEAP_SECONDS = 18
SYSTEMS = {"GPS_L1": Constellation.GPS, "GAL_E1": Constellation.GALILEO}
VALID, INTERRUPTED = 1, 2 | 4  # of the state of an accumulated range
PUBLISHED_M_S = 0.0097
Row = Mapping[str, str]
Epochs = dict[int, dict[SatelliteId, Row]]


class PhoneVelocity(NamedTuple):
    """Velocity of a phone at rest, root mean square in space."""

    intervals: int
    checked: int  # of them, in which a slip would have been found
    carrier_m_s: float
    doppler_m_s: float


def phone_velocities(folder: Path) -> dict[str, PhoneVelocity]:
    """Velocities of each recorded phone, of all intervals of a second."""
    found = {}
    for name, file in PHONES.items():
        epochs = read(folder / file)
        intervals = [one for one in map(_displacement, pairwise(sorted(epochs.items()))) if one is not None]
        if intervals:
            carrier = [np.sum(one.displacement_n**2) for one in intervals]
            doppler = [np.sum(one.doppler_velocity_n**2) for one in intervals if one.doppler_velocity_n is not None]
            checked = sum(one.checked for one in intervals)
            found[name] = PhoneVelocity(len(intervals), checked, sqrt(np.mean(carrier)), sqrt(np.mean(doppler)))
    return found


def read(path: Path) -> Epochs:
    """Signals on L1 and E1 of each second whose phase is valid, by GPS time [ns]."""
    epochs: Epochs = defaultdict(dict)
    with path.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            system = next((value for name, value in SYSTEMS.items() if row["SignalType"].startswith(name)), None)
            if system is not None and int(row["AccumulatedDeltaRangeState"] or 0) & VALID:
                time_ns = int(row["utcTimeMillis"]) * 1_000_000 - GPS_EPOCH_UTC_NS + LEAP_SECONDS * NS
                epochs[time_ns][SatelliteId(system, int(row["Svid"]))] = row
    return epochs


def _displacement(pair: tuple[tuple[int, dict[SatelliteId, Row]], ...]) -> Displacement | None:
    """Displacement in a second; None where phases do not suffice."""
    (first_ns, first), (second_ns, second) = pair
    span_s, errors = (second_ns - first_ns) * 1e-9, ErrorModel()
    changes = list(_changes(first, second, errors))
    if not 0.5 < span_s < 1.5 or len(changes) < 4:
        return None
    row = next(iter(first.values()))
    place_e = np.array([float(row[f"WlsPosition{axis}EcefMeters"]) for axis in "XYZ"])
    return displacement_by(changes, [], (first_ns, second_ns), None, place_e, CarrierModel(), errors)


def _changes(
    first: dict[SatelliteId, Row], second: dict[SatelliteId, Row], errors: ErrorModel
) -> Iterator[PhaseChange]:
    for satellite, now in second.items():
        then = first.get(satellite)
        if then is None or int(now["AccumulatedDeltaRangeState"]) & INTERRUPTED:
            continue
        by_carrier = _number(now, "AccumulatedDeltaRangeMeters") - _number(then, "AccumulatedDeltaRangeMeters")
        clock_m = _number(now, "SvClockBiasMeters") - _number(then, "SvClockBiasMeters")
        rate = 0.5 * sum(_number(one, "PseudorangeRateMetersPerSecond") for one in (then, now))
        rate_sd = errors.range_rate_sd_m_s * noise_factor(_number(now, "Cn0DbHz"), errors) / sqrt(2.0)
        yield PhaseChange(
            _sight(satellite, then), _sight(satellite, now), by_carrier + clock_m, by_carrier, rate, rate_sd
        )


def _sight(satellite: SatelliteId, row: Row) -> SatelliteMeasurement:
    x, y, z = (_number(row, f"SvPosition{axis}EcefMeters") for axis in "XYZ")
    vx, vy, vz = (_number(row, f"SvVelocity{axis}EcefMetersPerSecond") for axis in "XYZ")
    pseudorange = _number(row, "RawPseudorangeMeters") + _number(row, "SvClockBiasMeters")
    return SatelliteMeasurement(satellite, pseudorange, None, _number(row, "Cn0DbHz"), (x, y, z), (vx, vy, vz))


def _number(row: Row, name: str) -> float:
    return float(row[name])
