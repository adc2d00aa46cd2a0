"""Errors over time of the five degraded drives: GNSS and fusion, with an outage of half a minute."""

from dataclasses import dataclass

import numpy as np

from services.core.fusion.navigator import Navigator
from services.sensors.simulator.drive import simulate
from services.sensors.simulator.scenarios import scenario_of, with_error

from .navigation import (
    CASES,
    YAW_SD,
    Case,
    FloatArray,
    in_parallel,
    navigate,
    position_errors,
    saved_heading,
    settings_for,
)
from .report import Figure, figure

OUTAGE_S = (150.0, 180.0)  # of the drawn drives only: the numbers of table 2 are of drives without outage
AXES = ("north", "east", "down")


@dataclass(frozen=True)
class DrawnDrive:
    """Errors of one run."""

    name: str
    fix_s: FloatArray
    gnss: FloatArray  # shape (n, 3) [m, NED]
    fused_s: FloatArray
    fused: FloatArray  # shape (m, 3) [m, NED]
    speed: FloatArray  # shape (m,) [m/s] error of the horizontal speed


def drawn_drives(count: int | None, workers: int) -> list[Figure]:
    """Draw degraded drives, all of them without a count: errors to north, east and down, and of horizontal speed."""
    drawn: list[Figure] = []
    cases = [case for case in CASES if case.paper_fused][:count]
    for one in in_parallel(simulate_drawn, cases, workers, False):
        with figure(f"Errors of {one.name}", drawn.append, columns=4, height=2.8) as panels:
            for axis, (axes, name) in enumerate(zip(panels, AXES, strict=False)):
                axes.plot(one.fix_s, one.gnss[:, axis], ".", markersize=2, label="GNSS")
                axes.plot(one.fused_s, one.fused[:, axis], label="fusion")
                axes.set(xlabel="time [s]", title=f"{name} [m]")
            panels[3].plot(one.fused_s, one.speed)
            panels[3].set(xlabel="time [s]", title="speed [m/s]")
            for axes in panels:
                axes.axvspan(*OUTAGE_S, color="grey", alpha=0.2, linewidth=0)
            panels[0].legend(loc="upper left", fontsize="small")
    return drawn


def simulate_drawn(case: Case) -> DrawnDrive:
    """Simulate and navigate one run of a case, with the outage."""
    drive = simulate(with_error(scenario_of("parking_lot"), case.error), seed=0)
    times_s = drive.fix_ns * 1e-9
    drive.fix_valid[(times_s > OUTAGE_S[0]) & (times_s < OUTAGE_S[1])] = False
    navigator = Navigator(settings_for(drive, wheels=case.wheels))
    navigator.use_prior(saved_heading(drive, YAW_SD))
    track = navigate(drive, navigator, wheels=case.wheels)
    horizontal = [np.hypot(*velocity[:, :2].T) for velocity in (track.velocity, drive.velocity_n[track.index])]
    return DrawnDrive(
        case.name, np.asarray(times_s[drive.fix_valid], dtype=float), drive.fix_error_n[drive.fix_valid],
        np.asarray(drive.t_ns[track.index] * 1e-9, dtype=float), position_errors(drive, track),
        horizontal[0] - horizontal[1],
    )  # fmt: skip
