"""Computes the time of validity and the arrival time of each row, on one time line."""

import numpy as np
import numpy.typing as npt

from shared.errors import UserError
from shared.maths.dates import END_DATE_NS, NS
from shared.maths.earth import FloatArray

from ..mapping import units
from ..mapping.schema import TableFile, Time
from ..readers.table import Table
from .scales import GPS_EPOCH_S, WEEK_S, utc_of
from .wraps import unwrapped

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
    Clocks that start anew are continued first, then brought to UTC. With an arrival column a, the device clock c is
    mapped to the host clock by the row with the least latency::

        sampled = c + min(a - c) - least_latency
    """
    time = spec.time
    for column in filter(None, (time.column, time.arrival_column)):
        told_s = table[column] * units.TIME[time.unit] + _days(time, table) + time.offset_s + start_s
        table = table.keep(np.abs(told_s) < END_DATE_NS / NS, "date after 2100")  # one would make all others late
    if not len(table):
        reasons = ", ".join(f"{count} {reason}" for reason, count in table.rejects.items())
        raise UserError(f"{spec.file} holds no row that can be used: {reasons}; check the columns and `quality`")
    clock = table.row_numbers * (time.period_s or 0.0)
    if time.column is not None:
        clock = _continued(spec, table, time.column, _days(time, table))
    if time.arrival_column is None:
        clock = utc_of(clock + start_s, time.known_scale) - start_s
        sampled = clock + (time.offset_s - spec.stamps_late_s)
        received = sampled + spec.latency_s
    else:
        arrival = _continued(spec, table, time.arrival_column, 0.0)
        arrival = utc_of(arrival + start_s, time.known_scale) - start_s + time.offset_s
        sampled = clock + np.min(arrival - clock) - time.least_latency_s - spec.stamps_late_s
        received = np.maximum.accumulate(np.maximum(arrival, sampled)) + spec.latency_s
    later = np.r_[True, sampled[1:] > np.maximum.accumulate(sampled)[:-1]]
    table = table.keep(later, "not later than the previous row")
    return table, _nanoseconds(sampled[later], start_s), _nanoseconds(received[later], start_s)


def _continued(spec: TableFile, table: Table, column: str, days_s: FloatArray | float) -> FloatArray:
    """A clock [s] that goes on where it starts anew; the table's notes say so."""
    clock = table[column] * units.TIME[spec.time.unit] + days_s
    found = unwrapped(clock, table.row_numbers, spec.time.wraps_s, f"{spec.file}: the clock {column!r}")
    table.notes.extend(found.sentences)
    return found.seconds


def _days(time: Time, table: Table) -> FloatArray | float:
    """Beginning [s] of each row's day, or of its GPS week, if it has a column."""
    if time.date_column is not None:
        return table[time.date_column]
    return 0.0 if time.week_column is None else GPS_EPOCH_S + table[time.week_column] * WEEK_S


def _nanoseconds(seconds: FloatArray, start_s: float) -> Stamps:
    """Nanoseconds, rounded to microseconds: the resolution of Unix time in seconds as a double."""
    stamps: Stamps = (np.round(seconds * 1e6).astype(np.int64) + round(start_s * 1e6)) * 1000
    return stamps
