"""The propagation from one update that the engine decides about to the next, in one call.

All covariance steps and updates of `aids.updates` between the two are in it, in compiled code where there is some.
The result is that of the same steps one by one.
"""

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.compiled import compilable, compiled
from shared.maths.kalman import correct_one

from ..aids.non_holonomic.aid import MIN_SPEED_M_S, ConstraintModel
from ..aids.odometer.aid import OdometerModel
from ..aids.updates import (
    BEYOND_GATE,
    COLUMNS,
    COVARIANCE,
    DOUBT,
    EXCLUDED,
    EXCLUSION,
    IGNORED,
    NO_UPDATE,
    NON_HOLONOMIC,
    NOTHING_DUE,
    ODOMETER,
    UNFIT,
    USED,
    ZERO_ANGULAR_RATE,
    ZERO_VELOCITY,
    Model,
    Speeds,
    Standing,
    inflated,
    observation,
    record,
)
from ..inertial.error_model import ProcessNoise
from ..inertial.propagation import ZERO, Intervals, Samples, Stop, propagate
from ..inertial.row import (
    PARAMETERS,
    Fault,
    Numbers,
    Row,
    begun,
    fault_of,
    mean_rate,
    packed,
    row_of,
    step,
    subtracted,
    three,
)
from ..inertial.standstill import limits_of, norm

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

MAX_RECORDS = 64  # of one call


class Rules(NamedTuple):
    """What does not change in a call."""

    noise: ProcessNoise
    model: Model
    intervals: Intervals


def constants_of(rules: Rules) -> FloatArray:
    """Numbers of the rules in one array, without arrays of their own: compiled code reads tuples slowly."""
    noise, model, intervals = rules
    return np.array([
        noise.vibration_factor, *model.arm_b, *model.constraint, *model.odometer, *model.limits, *intervals,
    ], np.float64)  # fmt: skip


@compilable
def rules_of(c: FloatArray, psd: FloatArray, correlation_s: FloatArray, variance: FloatArray) -> Rules:
    """Rules of their numbers and arrays: the inverse of `constants_of`."""
    noise = ProcessNoise(psd, correlation_s, variance, float(c[0]))
    constraint = ConstraintModel(float(c[4]), float(c[5]), float(c[6]))
    odometer = OdometerModel(float(c[7]), float(c[8]))
    model = Model(three(c, 1), constraint, odometer, three(c, 9))
    intervals = Intervals(float(c[12]), float(c[13]), float(c[14]), float(c[15]), bool(c[16] > 0.0))
    return Rules(noise, model, intervals)


class Segment(NamedTuple):
    """Where a call has ended."""

    numbers: Numbers
    standing: Standing
    taken: int  # samples that were used in full
    used: int  # speeds
    stop: Stop
    fault: int
    records: list[list[float]]  # of updates: see `aids.updates`


@compiled
def run(  # noqa: C901, PLR0912, PLR0913, PLR0915, PLR0917  # one loop, and compiled code takes numbers and arrays
    time_ns: int,
    values: FloatArray,
    P: FloatArray,
    times_ns: Sequence[int] | IntArray,
    rows: Sequence[Sequence[float]] | FloatArray,
    begin: int,
    end: int,
    speed_times_ns: IntArray,
    readings: FloatArray,
    stand_until_ns: IntArray,
    next_ns: int,
    wheels_until_ns: int,
    inflation_ns: int,
    constants: FloatArray,
    psd: FloatArray,
    correlation_s: FloatArray,
    variance: FloatArray,
) -> tuple[int, FloatArray, FloatArray, int, int, int, int, int, int, FloatArray]:
    """See `segment`: `Numbers` of the row; `Standing`; samples, speeds, stop and fault; records."""
    row = row_of(time_ns, values, P, values[PARAMETERS:].copy())
    noise, model, intervals = rules_of(constants, psd, correlation_s, variance)
    records = np.zeros((MAX_RECORDS, COLUMNS))
    k, used, n, fault, stop = begin, 0, 0, 0, 0
    rate_is_due, rate, rate_sd = False, ZERO, 0.0  # of a standstill, after its zero velocity
    while n < MAX_RECORDS:
        kind, verdict, due_ns = NO_UPDATE, USED, next_ns
        if rate_is_due:
            kind, rate_is_due = ZERO_ANGULAR_RATE, False
        else:
            if used < len(speed_times_ns):
                due_ns = int(speed_times_ns[used])
                if due_ns < row.state.time_ns:  # of a gap that ended the solution
                    used += 1
                    continue
            limits = limits_of(row.P, row.state.time_ns <= wheels_until_ns)
            state, taken, stop = propagate(row.state, times_ns, rows, k, end, row.imu, limits, intervals, due_ns)
            k += taken
            if stop == Stop.COVARIANCE_DUE.value:
                kind = COVARIANCE
            elif stop == Stop.ZERO_VELOCITY_DUE.value:
                rate, rate_sd = mean_rate(state)
                kind, rate_is_due, state = ZERO_VELOCITY, True, begun(state, True)
            elif stop == Stop.NON_HOLONOMIC_DUE.value:
                state = begun(state, False)
                kind = NON_HOLONOMIC if norm(state.velocity) > MIN_SPEED_M_S else NOTHING_DUE
            elif stop == Stop.MEASUREMENT_DUE.value and used < len(speed_times_ns):
                kind = ODOMETER
                if readings[used, IGNORED] > 0.0:
                    kind, used = NOTHING_DUE, used + 1
            row = Row(state, row.P, row.imu, row.parameters, row.position_correction)
        if kind == NO_UPDATE:
            at_end = stop == Stop.END_OF_SAMPLES.value and k == len(times_ns)
            if not (at_end and intervals.covariance_at_end and row.state.span_s > 0.0):
                break
            kind = COVARIANCE
        if kind == NOTHING_DUE:
            continue
        z, H, R, unsure = observation(kind, row, readings, used, rate, rate_sd, model)
        if row.state.span_s > 0.0:
            row = step(row, noise)
            fault = fault_of(row)
        if kind != COVARIANCE and not fault:
            valid, x, P_after, distance2, _, S, _ = correct_one(row.P, z, H, R)
            if not valid:
                fault = Fault.INNOVATION_COVARIANCE.value
            elif not isfinite(distance2):
                fault = Fault.INNOVATION.value
            else:
                ratio = distance2 / model.limits[len(z) - 1]
                excluded = kind == ODOMETER and readings[used, EXCLUSION] > 0.0
                in_doubt = unsure and readings[used, DOUBT] > 0.0
                verdict = EXCLUDED if excluded else UNFIT if in_doubt else BEYOND_GATE if ratio > 1.0 else USED
                if verdict == USED:
                    row = subtracted(row, x, P_after)
                    fault = fault_of(row)
                record(records[n], row.state.time_ns - time_ns, kind, verdict, ratio, z, S, x)
                n += 1
                if kind == ODOMETER and not excluded:
                    wheels_until_ns = int(stand_until_ns[used])
                    row, inflation_ns = inflated(row, inflation_ns, H, verdict == BEYOND_GATE)
        used += kind == ODOMETER
        if fault:
            stop = Stop.DIVERGED.value
            break
    else:
        stop = Stop.END_OF_SAMPLES.value  # of this call
    after = packed(row)
    return (
        after.time_ns, after.values, after.P, wheels_until_ns, inflation_ns, k - begin, used, stop, fault, records[:n]
    )  # fmt: skip


def segment(
    numbers: Numbers, samples: Samples, begin: int, end: int, speeds: Speeds, standing: Standing, rules: Rules,
) -> Segment:  # fmt: skip
    """Propagate over samples, from row `begin` to before row `end`, with all updates until the engine must decide.

    Parameters
    ----------
    numbers : Numbers
        Row at the end of the sample before.
    samples : Samples
        Arrays for compiled code, lists for Python.
    begin, end : int
        Rows of the samples.
    speeds : Speeds
        Speeds that may be due within the samples.
    standing : Standing
        After the speeds before.
    rules : Rules
        Of the filter and its updates.

    Returns
    -------
    Segment
    """
    times_ns, rows, _ = samples
    of = speeds
    time_ns, values, P, wheels_until_ns, inflation_ns, taken, used, stop, fault, records = run(
        *numbers, times_ns, rows, begin, end, of.times_ns, of.readings, of.stand_until_ns, of.due_ns, *standing,
        constants_of(rules), rules.noise.psd, rules.noise.correlation_s, rules.noise.variance,
    )  # fmt: skip
    standing = Standing(wheels_until_ns, inflation_ns)
    return Segment(Numbers(time_ns, values, P), standing, taken, used, Stop(stop), fault, records.tolist())
