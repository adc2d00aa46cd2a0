"""V2X-assisted fault detection: the table of ten ratios and the position errors, beside the published ones."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass
from functools import partial

import numpy as np

from services.core.cooperative.measurements import FloatArray
from services.core.cooperative.paper import scenario
from services.core.cooperative.paper.monte_carlo import (
    RATIOS,
    Rates,
    Row,
    closed_loop,
    draw,
    open_loop,
    row,
    structure_test,
)
from services.core.cooperative.v2x.virtual import (
    baarda_biases,
    choose_virtual,
    design_row,
    horizontal_protection_level,
    local_biases,
    prediction_matrix,
    residual_cov,
)

from .cooperative_over_time import (
    SWEEPS,
    SweepPoint,
    one_run,
    over_time_document,
    over_time_figures,
    sweep_point,
    sweep_table,
)
from .navigation import WORKERS, in_parallel
from .report import Figure, Paper, Table, figure

SEED = 1
P_FA, P_MD = 1e-5, 1e-4
ALERT_LIMIT_M = 15.0  # [m] below the level of the fitted split; the paper does not state its own
POINTS = 1.5  # [%] tolerance of the reference numbers
METHODS = {"paper's test, open loop": "open_loop", "Baarda's test, open loop": "snooping",
           "paper's test, closed loop": "closed_loop", "leave-one-out bank": "leave_one_out"}  # fmt: skip
MEAN_OF_RATIOS = Rates(0.65, 0.45, 43.9)  # of the open loop in the reference simulation


@dataclass(frozen=True)
class Assumption:
    """A changed assumption, and the missed ramp [%] of the reference simulation with it."""

    name: str
    missed_ramp: float
    false_alarm_rate: float = 1e-5
    reference_error_m: float | None = None  # white, of a reference that is right otherwise; None: the open loop
    variance_factor: float | None = None  # of the pseudoranges in a closed loop


ASSUMPTIONS = (
    *(Assumption(f"P_FA {rate:.0e}", ramp, rate) for rate, ramp in ((1e-3, 35.1), (1e-5, 44.8), (1e-7, 53.4))),
    Assumption("reference without error", 45.9, reference_error_m=0.0),
    Assumption("white error of 1 m", 44.8, reference_error_m=1.0),
    Assumption("white error of 3 m", 44.8, reference_error_m=3.0),
    Assumption("white error of 5 m", 44.9, reference_error_m=5.0),
    Assumption("closed, variance x 100", 45.9, variance_factor=100.0),
)
NO_TOLERANCE = "closed, variance x 100"  # reported: the gain of the reference simulation is not specified
FITTED = (
    "Split of the satellites, road, oncoming and parked cars, and the receiver clock's drift: not published, and "
    "chosen so that the published missed ramps come about. Missed ramps are a constant of the geometry; agreement is "
    "not independent evidence.",
    "The reference is read as independent of the satellites under test (open loop); the paper does not say so.",
)
NOT_REPRODUCED = (
    "Published false alarms do not fall with the range-rate deviation (7.03 % at 0.1); ours do. A reference that the "
    "satellites under test correct (closed loop) has false alarms at every ratio, but misses the ramp.",
    "With the variance of the pseudoranges times 100, a closed loop misses more of the ramp (49 %) than the "
    "reference simulation's 45.9 %.",
    "The leave-one-out bank is not in the paper. Closed loops have fewer false alarms here than in the reference "
    "simulation (9.5 and 7.2 %), and at a ratio of 0.1 a larger error (18.6 m, 14 m there).",
    "The paper's text and table differ: a missed step of 0.36 % on average in the text, 0.457 % by the ten columns.",
)


@dataclass(frozen=True)
class Sensitivity:
    """Rates of the paper's test with one assumption changed."""

    assumption: Assumption
    rates: Rates


Done = Row | Sensitivity | SweepPoint


def reproduce(runs: int, progress: bool) -> Paper:
    """Run the table of ten ratios and the sensitivities in parallel."""
    jobs: list[Callable[[], Done]] = [partial(row, k, runs, SEED) for k in range(len(RATIOS))]
    jobs += [partial(sensitivity, assumption, runs) for assumption in ASSUMPTIONS]
    jobs += [partial(sweep_point, sweep, one, runs, SEED) for sweep, received in SWEEPS.items() for one in received]
    done = list(in_parallel(_call, jobs, WORKERS, progress))
    rows = [row for row in done if isinstance(row, Row)]
    changed = [sensitivity for sensitivity in done if isinstance(sensitivity, Sensitivity)]
    points, run = [point for point in done if isinstance(point, SweepPoint)], one_run(SEED)
    tables = [
        _rates_table(rows, runs),
        _positions_table(rows),
        _sensitivity_table(changed),
        sweep_table(points),
        _thresholds_table(),
    ]
    return Paper(
        "cooperative", tables, _document(rows, changed, runs) | over_time_document(run, points), FITTED,
        (*NOT_REPRODUCED, *_steps(rows)),
        deviations=deviations(rows, changed), figures=_figures(rows) + over_time_figures(run, points),
    )  # fmt: skip


def _call(job: Callable[[], Done]) -> Done:
    return job()


def _steps(rows: Sequence[Row]) -> list[str]:
    """Missed steps of the printed test above the published ones, as far as these runs have them."""
    return [
        f"Missed step at a ratio of {row.ratio}: {row.open_loop.missed_step:.2f} % with the printed test "
        f"({row.snooping.missed_step:.2f} % with Baarda's), published {row.published.missed_step} %."
        for row in rows
        if row.open_loop.missed_step > 1.5 * row.published.missed_step and row.open_loop.missed_step > 1.0
    ]


def sensitivity(assumption: Assumption, runs: int) -> Sensitivity:
    """Run the paper's test at a ratio of 0.5 with one assumption changed."""
    drive = draw(runs, SEED)
    if assumption.variance_factor is not None:
        return Sensitivity(assumption, closed_loop(drive, 0.5, assumption.variance_factor)[0])
    if assumption.reference_error_m is None:
        return Sensitivity(assumption, open_loop(drive, 0.5, assumption.false_alarm_rate)[0])
    shape = (scenario.EPOCHS, runs, 3)
    error = assumption.reference_error_m * np.random.default_rng((SEED, 1)).standard_normal(shape)
    return Sensitivity(assumption, structure_test(drive, error, np.zeros(shape[:2]), assumption.false_alarm_rate))


def mean_rates(rows: Sequence[Row], method: str) -> Rates:
    """Mean over the ratios."""
    false_alarm, step, ramp = np.mean([astuple(getattr(row, method)) for row in rows], axis=0).tolist()
    return Rates(false_alarm, step, ramp)


def deviations(rows: Sequence[Row], changed: Sequence[Sensitivity]) -> list[str]:
    """Numbers outside the tolerance of the reference, and acceptance limits that are exceeded."""
    texts = []
    names = ("false alarms", "missed step", "missed ramp")
    found = mean_rates(rows, "open_loop")
    for name, value, expected in zip(names, astuple(found), astuple(MEAN_OF_RATIOS), strict=True):
        if value > expected + POINTS:
            texts.append(f"open loop, mean of ten ratios: {name} {value:.2f} %, reference {expected} % + {POINTS}")
    for sensitivity in changed:
        name, expected = sensitivity.assumption.name, sensitivity.assumption.missed_ramp
        if sensitivity.rates.missed_ramp > expected + POINTS and name != NO_TOLERANCE:
            texts.append(
                f"{name}: missed ramp {sensitivity.rates.missed_ramp:.1f} %, reference {expected} % + {POINTS}"
            )
    for one_row in rows:
        bank = one_row.leave_one_out
        if bank.missed_ramp > 60.0:
            texts.append(f"ratio {one_row.ratio}: the bank absorbs the ramp, {bank.missed_ramp:.1f} % are missed")
        if one_row.ratio == 0.5:
            for name, value, limit in zip(names, astuple(bank), (1.0, 0.5, 50.0), strict=True):
                if value > limit:
                    texts.append(f"bank at ratio 0.5: {name} {value:.2f} %, limit {limit} %")
    return texts


def _rates_text(rates: Rates) -> str:
    return f"{rates.false_alarm:.2f} {rates.missed_step:.2f} {rates.missed_ramp:5.1f}"


def _rates_table(rows: Sequence[Row], runs: int) -> Table:
    found = [
        (f"{row.ratio}", _rates_text(row.published), *(_rates_text(getattr(row, m)) for m in METHODS.values()))
        for row in rows
    ]
    means = (_rates_text(mean_rates(rows, method)) for method in ("published", *METHODS.values()))
    title = f"False alarms, missed step, missed ramp [%]; {runs} runs of 90 epochs a ratio"
    columns = ("ratio", "paper", "open loop", "Baarda", "closed loop", "leave-one-out")
    return Table(title, columns, (*found, ("mean", *means)))


def _positions_table(rows: Sequence[Row]) -> Table:
    ratio = {row.ratio: row for row in rows}
    found = [
        (f"{method}, {value}", *(f"{ratio[value].position_m[method][phase]:.1f}" for phase in scenario.PHASES))
        for value in (1.0, 0.5, 0.1)
        for method in ratio[value].position_m
        if value == 1.0 or method != "four satellites alone"
    ]
    title = "Horizontal RMS error [m]; ramp from 31 s, step from 51 to 80 s"
    return Table(title, ("method, ratio", *scenario.PHASES), found)


def _sensitivity_table(changed: Sequence[Sensitivity]) -> Table:
    found = [
        (
            sensitivity.assumption.name,
            *(f"{v:.2f}" for v in astuple(sensitivity.rates)),
            f"{sensitivity.assumption.missed_ramp}",
        )
        for sensitivity in changed
    ]
    columns = ("", "false alarm", "step", "ramp", "ramp, reference")
    return Table("False alarms and misses [%] with one assumption changed, ratio 0.5", columns, found)


@dataclass(frozen=True)
class SatelliteSplit:
    """What follows from a choice of real and virtual satellites, without any measurement."""

    local_m: list[float]  # bias at which the printed local test of each real satellite fires
    baarda_m: list[float]  # the same of Baarda's test
    hpl_m: float  # horizontal protection level


def splits() -> dict[str, SatelliteSplit]:
    """The fitted split; the four highest satellites real; and these with virtual ones that were chosen anew.

    Virtual satellites need not exist: they are chosen of directions every 60 degrees of azimuth at 15, 45 and 75
    degrees of elevation, and chosen anew where the protection level exceeds the alert limit. The level is that of least
    squares over all eight: it does not say that the printed local tests of the four highest are blind for the step.
    """
    H = np.vstack([scenario.real_rows(), scenario.virtual_rows()])
    highest = np.argsort(-H[:, 2]).tolist()
    angles = np.radians([(elevation, azimuth) for elevation in (75, 45, 15) for azimuth in range(0, 360, 60)])
    candidates = np.array([design_row(elevation, azimuth) for elevation, azimuth in angles.tolist()])
    real = H[highest[:4]]
    chosen = choose_virtual(real, candidates, level=lambda virtual: _level(real, virtual), limit=ALERT_LIMIT_M)
    anew = candidates[list(chosen or ())]
    pairs = {"as fitted": (H[:4], H[4:]), "four highest real": (real, H[highest[4:]]), "chosen anew": (real, anew)}
    return {name: _split(*pair) for name, pair in pairs.items()}


def _split(real: FloatArray, virtual: FloatArray) -> SatelliteSplit:
    sd = np.full(4, scenario.PSEUDORANGE_SD)
    W = residual_cov(prediction_matrix(real, virtual), sd, sd)
    return SatelliteSplit(local_biases(W, P_FA).tolist(), baarda_biases(W, P_FA).tolist(), _level(real, virtual))


def _level(real: FloatArray, virtual: FloatArray) -> float:
    return horizontal_protection_level(
        np.vstack([real, virtual]), range(4), scenario.PSEUDORANGE_SD, false_alarm_rate=P_FA,
        missed_detection_rate=P_MD,
    )  # fmt: skip


def _thresholds_table() -> Table:
    def biases(values: Sequence[float]) -> str:
        return " ".join(f"{value:.1f}" for value in values)

    rows = [
        (name, biases(split.local_m), biases(split.baarda_m), f"{split.hpl_m:.1f}") for name, split in splits().items()
    ]
    title = (
        f"Bias [m] that fires the local tests of the four real satellites (step: 50 m); HPL, limit {ALERT_LIMIT_M:g} m"
    )
    return Table(title, ("split into real and virtual", "paper's test", "Baarda's test", "HPL [m]"), rows)


def _document(rows: Sequence[Row], changed: Sequence[Sensitivity], runs: int) -> dict[str, object]:
    return {
        "runs": runs,
        "columns": ["false_alarm_percent", "missed_step_percent", "missed_ramp_percent"],
        "ratios": [
            {
                "ratio": row.ratio,
                "position_rms_m": row.position_m,
                **{name: astuple(getattr(row, name)) for name in ("published", *METHODS.values())},
            }
            for row in rows
        ],
        "mean": {name: astuple(mean_rates(rows, name)) for name in ("published", *METHODS.values())},
        "sensitivities": {sensitivity.assumption.name: astuple(sensitivity.rates) for sensitivity in changed},
        "reference_missed_ramp_percent": {assumption.name: assumption.missed_ramp for assumption in ASSUMPTIONS},
        "splits": {name: asdict(split) for name, split in splits().items()},
        "alert_limit_m": ALERT_LIMIT_M,
    }


def _figures(rows: Sequence[Row]) -> list[Figure]:
    drawn: list[Figure] = []
    ratios = [row.ratio for row in rows]
    labels = {"false_alarm": "false alarms [%]", "missed_step": "missed step [%]", "missed_ramp": "missed ramp [%]"}
    with figure("Rates over the ratio", drawn.append, columns=3) as panels:
        for axes, (name, label) in zip(panels, labels.items(), strict=True):
            for text, method in {"paper": "published", **METHODS}.items():
                axes.plot(ratios, [getattr(getattr(row, method), name) for row in rows], marker=".", label=text)
            axes.set(xlabel="ratio of the range-rate deviation", ylabel=label)
        panels[2].legend()
    with figure("Position errors", drawn.append) as (axes,):
        chosen = next(row for row in rows if row.ratio == 0.5).position_m
        for offset, (method, errors) in enumerate(chosen.items()):
            axes.bar(np.arange(len(errors)) + 0.16 * offset, list(errors.values()), 0.15, label=method)
        axes.set(ylabel="horizontal RMS [m], ratio 0.5")
        axes.set_xticks(np.arange(len(scenario.PHASES)) + 0.32, list(scenario.PHASES))
        axes.legend(loc="upper left")
    return drawn
