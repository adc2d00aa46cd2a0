"""Random wrong installations in the simulator, and recordings falsified at import: what a survey finds of them."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks import tables
from benchmarks.navigation.runs import data_folder
from benchmarks.set_up.recorded import ASIDE, FALSIFICATIONS, SOURCES, Found, found_in, turned_deg
from benchmarks.set_up.trial import GOALS, Left, Trial, trial
from cli import campaign
from services.core.fusion.set_up.survey.findings import Quantity

RESULTS = Path(__file__).resolve().parents[1] / "results"
SIZE = campaign.Size(short=3, usual=20, full=100, unit="installations")
TITLE = """# Set up by driving: what is found of wrong installations

By `python -m benchmarks.set_up`; docs/explanation/set-up.md says how. Measured on {date}.

"""
OF_TRIALS = """## In the simulator

{count} random installations: every second mount at any angle, the others askew by 2° to 40°; an IMU somewhere in front
of the rear axle, an antenna up to 0.8 m from where the settings have it on each axis, fixes 0.1 s early to 0.4 s late,
speeds 8 % low to high. They are driven for ten minutes in a town, a car park, on country roads with tunnels, and on a
motorway, where nobody makes the bends that are asked for. Mounts give way by up to 0.3° per m/s², samples shake by up
to 0.4 m/s² and 0.01 rad/s, the ground is banked by up to 3° as a whole, tyres warm up (0.3 %) and slip (1 % per m/s²).
What the first drive shows is applied, and a second drive is surveyed with it.

"""
OF_RECORDINGS = """## In recordings

Files of public recordings are falsified before they are imported; what is left is against what their authors document.
The inertial unit of `rtk` and `single point` is simulated along a real path, mounted exactly; the odometer's 0.5 % is
documented, its sign follows from the truth. `comma` is 60 s of nearly straight road at up to 20 m/s; its speed is 0.52
km/h too low, 0.8 % of the mean speed. Mountings of `comma` and `navmatlab` are against that found as recorded. Known
is what has a standard deviation of 0.5°, 5 cm, 10 ms and 0.25 % at most. A minute of `comma` without a bend does not
tell its mounting so well: 0.53°, 0.71° and 0.63° by arcs of 6, 10 and 14 s, and its lever arm to 0.8 m at best.

"""


def main(arguments: Sequence[str]) -> int:
    """Run everything and write `benchmarks/results/set_up.md`."""
    options = campaign.options_of(argparse.ArgumentParser(description=__doc__), arguments, SIZE)
    trials = campaign.run(
        "set_up", [campaign.Job(f"installation {seed}", trial, (seed,)) for seed in range(options.runs)],
        workers=options.workers, fresh=options.fresh, smoke=options.smoke,
    )  # fmt: skip
    names = [name for name, source in SOURCES.items() if (data_folder() / source.folder).is_dir()]
    jobs = [
        campaign.Job(f"{name}, {falsified}", found_in, (str(data_folder()), name, falsified))
        for name in names[: 0 if options.short else None]
        for falsified in FALSIFICATIONS
    ]  # fmt: skip
    recordings = campaign.run("set_up_recordings", jobs, workers=options.workers, fresh=options.fresh)
    text = of_trials(trials.results) + "\n" + of_recordings(recordings.results)
    Console().print(text, markup=False, soft_wrap=True)
    if campaign.worth_storing(options, trials, recordings):
        if set(names) != set(SOURCES):
            Console(stderr=True).print("Recordings are missing: nothing is stored; set OBU_DATA to their folder.")
            return 1
        date = datetime.now(UTC).date().isoformat()
        tables.publish(RESULTS / "set_up.md", TITLE.format(date=date) + text)
        found = {
            "date": date, "trials": [asdict(one) for one in trials.results],
            "recordings": [asdict(one) for one in recordings.results],
        }  # fmt: skip
        (RESULTS / "set_up.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0 if trials.complete and recordings.complete else 1


def of_trials(trials: Sequence[Trial]) -> str:
    """Table of the simulated installations, and its summary."""
    lines = [
        OF_TRIALS.format(count=len(trials)),
        "| | goal | known | within the goal | median | largest | error over 1 σ |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for quantity, (goal, unit) in GOALS.items():
        rows = [one.left[quantity.value] for one in trials]
        known = [row for row in rows if row.known]
        errors = np.array([row.after for row in known]) if known else np.zeros(1)
        pulls = np.array([row.after / row.sd for row in known if row.sd]) if known else np.zeros(1)
        lines.append(
            f"| {quantity.value.replace('_', ' ')} | {_text(goal, unit)} | {len(known)} of {len(rows)} | "
            f"{int((errors <= goal).sum())} of {len(known)} | {_text(float(np.median(errors)), unit)} | "
            f"{_text(float(errors.max()), unit)} | {np.sqrt((pulls**2).mean()):.1f} RMS, {pulls.max():.1f} at most |"
        )
    silent = sum(not row.known and not row.written for one in trials for row in one.left.values())
    unknown = sum(not row.known for one in trials for row in one.left.values())
    headings = " | ".join(f"{name.value.replace('_', ' ')} [{unit}]" for name, (_, unit) in GOALS.items())
    lines += [
        "",
        f"Where a quantity was not known, {silent} times of {unknown} nothing was written. Each installation:",
        "",
        f"| | drive | {headings} |",
        "| --- | --- |" + " --- |" * len(GOALS),
    ]
    for one in trials:
        cells = " | ".join(_cell(one.left[quantity.value]) for quantity in GOALS)
        lines.append(f"| {one.seed} | {one.scenario.replace('_', ' ')} | {cells} |")
    lines += ["", "Before → after both drives; *not known*: nothing was written.", ""]
    return "\n".join(lines)


def of_recordings(found: Sequence[Found]) -> str:
    """Table of the falsified recordings."""
    lines = [OF_RECORDINGS, "| recording | falsified | mounting | lever arm | delay | odometer scale | written |",
             "| --- | --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    references = {one.recording: one.matrix for one in found if one.falsified == "as recorded"}
    for one in found:
        source = SOURCES[one.recording]
        reference = np.eye(3).tolist() if source.arm is not None else references.get(one.recording)
        mounting = None if one.matrix is None or reference is None else turned_deg(one.matrix, reference)
        arm = None
        if one.arm is not None and source.arm is not None:
            arm = float(np.hypot(one.arm[0] - source.arm[0], one.arm[1] - source.arm[1]))
        scale = None if one.ratio is None or source.ratio is None else one.ratio / source.ratio - 1.0
        delay = None if one.delay_s is None or source.delay_s is None else one.delay_s - source.delay_s
        cells = (
            _left(mounting, one.mounting_sd_deg, "deg", Quantity.MOUNTING in one.known),
            _left(arm, one.arm_sd_m, "m", Quantity.LEVER_ARM in one.known),
            _left(delay, one.delay_sd_s, "s", Quantity.DELAY in one.known),
            _left(scale, one.ratio_sd, "-", Quantity.ODOMETER_SCALE in one.known),
        )
        wrote = ", ".join(name.replace("_", " ") for name in one.wrote) or "nothing"
        lines.append(f"| {one.recording} | {one.falsified} | {' | '.join(cells)} | {wrote} |")
    aside = next((one for one in found if one.recording == ASIDE and one.falsified == "as recorded"), None)
    if aside is not None and aside.matrix is not None:
        yaw, pitch = _yaw_pitch(aside.matrix)
        lines += ["", f"`navmatlab` as recorded: its IMU is found {yaw:.1f}° askew in yaw and {pitch:.1f}° in pitch; "
                      "documented are 3° to 4° and 3° to 11°."]  # fmt: skip
    return "\n".join([*lines, ""])


def _yaw_pitch(matrix: list[list[float]]) -> tuple[float, float]:
    """Yaw and pitch [deg] of the vehicle's axes in those as recorded, without their signs."""
    forward = np.array(matrix)[:, 0]
    yaw = np.degrees(np.arctan2(forward[1], forward[0]))
    return abs(float(yaw)), abs(float(np.degrees(np.arcsin(np.clip(forward[2], -1.0, 1.0)))))


def _cell(left: Left) -> str:
    return f"{left.before:.3g} → {left.after:.2g}" if left.known else f"{left.before:.3g}, not known"


def _left(error: float | None, sd: float | None, unit: str, known: bool) -> str:
    if sd is None:
        return "not shown"
    shown = "not known" if not known else "not documented" if error is None else _text(abs(error), unit)
    return f"{shown} (1 σ {_text(sd, unit)})"


def _text(value: float, unit: str) -> str:
    match unit:
        case "deg":
            return f"{value:.2f}°"
        case "m":
            return f"{100.0 * value:.1f} cm"
        case "s":
            return f"{1000.0 * value:.1f} ms"
        case _:
            return f"{100.0 * value:.2f} %"
