"""Computes the time of validity and the arrival time of each row, on one time line."""

import numpy as np
import numpy.typing as npt

from shared.maths.dates import BEYOND_NS, NS
from shared.maths.earth import FloatArray

from ..mapping import units
from ..mapping.schema import TableFile
from ..readers.table import Table

Stamps = npt.NDArray[np.int64]


def stamped(spec: TableFile, table: Table, start_s: float) -> tuple[Table, Stamps, Stamps]:
    """Compute the stamps of each row, and omit rows that are not later than the previous one.

    Parameters
    ----------
    spec : TableFile
        Clock columns and their delays.
    table : Table
        The columns of the file.
    start_s : float
        [s] Unix time of zero of the file's clock.

    Returns
    -------
    table : Table
        The remaining rows.
    sampled, received : ndarray of int64, shape (rows,)
        [ns] Time of validity and arrival time of each row.

    Notes
    -----
    With an arrival column a, the device clock c is mapped to the host clock by the row with the least latency::

        sampled = c + min(a - c) - least_latency
    """
    time = spec.time
    for column in filter(None, (time.column, time.arrival_column)):
        told_s = table[column] * units.TIME[time.unit] + time.offset_s + start_s
        table = table.keep(np.abs(told_s) < BEYOND_NS / NS, "date after 2100")  # one would make all others late
    clock = table.row_numbers * (time.period_s or 0.0)
    if time.column is not None:
        clock = table[time.column] * units.TIME[time.unit]
    if time.arrival_column is None:
        sampled = clock + (time.offset_s - spec.stamps_late_s)
        received = sampled + spec.latency_s
    else:
        arrival = table[time.arrival_column] * units.TIME[time.unit] + time.offset_s
        sampled = clock + np.min(arrival - clock) - time.least_latency_s - spec.stamps_late_s
        received = np.maximum.accumulate(np.maximum(arrival, sampled)) + spec.latency_s
    later = np.r_[True, sampled[1:] > np.maximum.accumulate(sampled)[:-1]]
    table = table.keep(later, "not later than the previous row")
    return table, _nanoseconds(sampled[later], start_s), _nanoseconds(received[later], start_s)


def _nanoseconds(seconds: FloatArray, start_s: float) -> Stamps:
    """Nanoseconds, rounded to microseconds: the resolution of Unix time in seconds as a double."""
    stamps: Stamps = (np.round(seconds * 1e6).astype(np.int64) + round(start_s * 1e6)) * 1000
    return stamps
