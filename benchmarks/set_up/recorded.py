"""Recordings of public data sets, falsified in their files before the import, and what a survey finds of it.

Documented are the lever arm and the stamps of `rtk_drive_57min`, the age of the fixes and the speed of `comma_segment`,
and the mounting of `navmatlab_car`, which was kept aside: nothing was made or changed by what is found of it.
"""

import shutil
import tempfile
from dataclasses import dataclass
from math import degrees
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.set_up.trial import angle_of
from cli.import_drive.import_drive import import_drive
from cli.set_up.drive import motion_of_drive, read
from services.core.fusion.set_up.findings import Verdict
from services.core.fusion.set_up.survey.arcs import rotations
from services.core.fusion.set_up.survey.findings import Quantity, findings_of
from services.core.fusion.set_up.survey.survey import survey
from shared.maths.earth import FloatArray

ROOT = Path(__file__).resolve().parents[2]
MAPPINGS, VEHICLES = (ROOT / "benchmarks" / "recordings" / name for name in ("mappings", "vehicles"))


@dataclass(frozen=True)
class Source:
    """A recording: its mapping, folder, the seconds of it that are used, and what is documented of it.

    `arm` [m, body], `ratio` the indicated over the true speed, `delay_s` of the fixes; None: not documented.
    """

    mapping: str
    folder: str
    window_s: tuple[float, float] = (0.0, 1e9)
    arm: tuple[float, float] | None = None
    ratio: float | None = None
    delay_s: float | None = 0.0


RTK_RATIO = 1.005  # "an unknown scale error of 0.5 %": its size is documented, and by the truth its sign is this one
COMMA_RATIO = 0.9917  # 0.52 km/h too low at the mean speed of 62 km/h
ARM = (0.136, -0.301)
SOURCES = {
    "rtk 200 Hz, 5 to 20 min": Source(
        "rtk_drive_57min", "rtk_drive_57min/mems_rtk_200hz", (300.0, 1200.0), ARM, RTK_RATIO
    ),
    "rtk 200 Hz, 30 to 45 min": Source(
        "rtk_drive_57min", "rtk_drive_57min/mems_rtk_200hz", (1800.0, 2700.0), ARM, RTK_RATIO
    ),
    "single point 100 Hz, 5 to 20 min": Source(
        "rtk_drive_57min", "rtk_drive_57min/mems_spp_100hz", (300.0, 1200.0), ARM, RTK_RATIO
    ),
    "comma, 60 s": Source("comma_segment", "comma_segment", ratio=COMMA_RATIO),
    "navmatlab, kept aside": Source("navmatlab_car", "navmatlab_car", delay_s=None),
}
ASIDE = "navmatlab, kept aside"


@dataclass(frozen=True)
class Falsification:
    """What is done to the files: axes turned or mirrored, arm moved, fixes stamped late, speeds scaled."""

    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rotation vector
    mirrored: bool = False  # of the axis right
    arm: tuple[float, float] = (0.0, 0.0)  # [m] by which the settings are wrong
    late_s: float = 0.0
    scale: float = 1.0

    @property
    def matrix(self) -> FloatArray:
        """Falsified axes by those of the vehicle, shape (3, 3)."""
        turn = rotations(np.radians(np.array(self.turn_deg)))
        return turn @ np.diag([1.0, -1.0, 1.0]) if self.mirrored else turn


FALSIFICATIONS = {
    "as recorded": Falsification(),
    "turned by 30°": Falsification(turn_deg=(17.3, -17.3, 17.3)),
    "turned by 143°": Falsification(turn_deg=(20.0, 60.0, 128.0)),
    "one axis mirrored": Falsification(mirrored=True),
    "arm moved": Falsification(arm=(0.6, -0.4)),
    "fixes 0.25 s late": Falsification(late_s=0.25),
    "speed 6 % high": Falsification(scale=1.06),
    "all of it": Falsification((-30.0, 10.0, 75.0), arm=(-0.5, 0.5), late_s=0.15, scale=0.94),
}


@dataclass(frozen=True)
class Found:
    """What is left of the errors of one falsified recording; None where nothing is documented or known.

    `mounting_deg` is against the mounting as recorded, which for the simulated inertial unit is exact.
    """

    recording: str
    falsified: str
    matrix: list[list[float]] | None  # vehicle's axes in those as recorded
    mounting_sd_deg: float | None
    arm: tuple[float, float] | None
    arm_sd_m: float | None
    delay_s: float | None
    delay_sd_s: float | None
    ratio: float | None
    ratio_sd: float | None
    wrote: tuple[str, ...]  # quantities whose settings are changed
    known: tuple[str, ...]


def found_in(data: str, recording: str, falsified: str) -> Found:
    """Falsify the files of a recording, import them, and survey the result."""
    source, how = SOURCES[recording], FALSIFICATIONS[falsified]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _falsify(Path(data) / source.folder, folder, source, how)
        drive = read(_imported(folder, source, how), None, Console(stderr=True, quiet=True))
        settings = drive.settings
        shown = survey(motion_of_drive(drive, lambda messages, _: messages), settings)
        findings = {one.quantity: one for one in findings_of(shown, settings)}
    known = {quantity: one for quantity, one in findings.items() if one.verdict is not Verdict.UNKNOWN}
    of = shown.adjusted.of if shown.adjusted else None
    sds = {quantity: one.sd for quantity, one in findings.items()}
    matrix = None if shown.matrix is None else (how.matrix.T @ shown.matrix).tolist()
    return Found(
        recording, falsified, matrix if Quantity.MOUNTING in known else None, sds[Quantity.MOUNTING],
        (float(of.arm[0]), float(of.arm[1])) if of and Quantity.LEVER_ARM in known else None, sds[Quantity.LEVER_ARM],
        of.delay_s - how.late_s if of and Quantity.DELAY in known else None, sds[Quantity.DELAY],
        of.ratio / how.scale if of and Quantity.ODOMETER_SCALE in known else None, sds[Quantity.ODOMETER_SCALE],
        tuple(quantity.value for quantity, one in known.items() if one.changes), tuple(known),
    )  # fmt: skip


def turned_deg(matrix: list[list[float]], reference: list[list[float]]) -> float:
    """Angle between two mountings [deg]."""
    return degrees(angle_of(np.array(reference).T @ np.array(matrix)))


def _imported(folder: Path, source: Source, how: Falsification) -> Path:
    mapping = (MAPPINGS / f"{source.mapping}.toml").read_text(encoding="utf-8").partition("\n[truth]")[0]
    mapping = mapping.replace('truth_is = "recorded"', 'truth_is = "none"')
    vehicle = (VEHICLES / f"{source.mapping}.toml").read_text(encoding="utf-8")
    if source.arm is not None:
        before, after = (
            f"lever_arm_body_m = [{x:.3f}, {y:.3f}, -0.184]"
            for x, y in (source.arm, np.add(source.arm, how.arm).tolist())
        )
        assert before in vehicle
        vehicle = vehicle.replace(before, after)
    (folder / "vehicle.toml").write_text(vehicle, encoding="utf-8")
    path = folder / "mapping.toml"
    path.write_text(mapping.replace(f"../vehicles/{source.mapping}.toml", "vehicle.toml"), encoding="utf-8")
    import_drive(path, folder, folder / "drive.mcap")
    return folder / "drive.mcap"


def _falsify(source: Path, folder: Path, of: Source, how: Falsification) -> None:
    for path in source.iterdir():
        target = folder / path.name
        if path.name == "imu.npz":
            _falsify_arrays(path, target, of, how)
        elif path.name in ("imu.csv", "gnss_ublox.csv", "can_speed.csv", "gnss.csv", "gnssv.txt", "odo.txt"):
            _falsify_table(path, target, of, how)
        else:
            shutil.copyfile(path, target)


def _falsify_arrays(path: Path, target: Path, of: Source, how: Falsification) -> None:
    with np.load(path) as arrays:
        values = {name: arrays[name] for name in arrays.files}
    after_s = values["t_s"] - values["t_s"][0]
    inside = (after_s >= of.window_s[0]) & (after_s <= of.window_s[1])
    kept = {name: array[inside] if len(array) == len(inside) else array for name, array in values.items()}
    for name in ("dtheta_rad", "dvel_m_s"):
        kept[name] = (kept[name] @ how.matrix.T).astype(np.float32)
    np.savez(target, **kept)


def _falsify_table(path: Path, target: Path, of: Source, how: Falsification) -> None:
    """Rewrite the columns of a table: the first one is the time."""
    separator, lines = ("," if path.suffix == ".csv" else None), path.read_text(encoding="utf-8").splitlines()
    head = lines[:1] if path.suffix == ".csv" else []
    rows = [line.split(separator) for line in lines[len(head) :]]
    begin_s = float(rows[0][0])
    written = list(head)
    for row in rows:
        if not of.window_s[0] <= float(row[0]) - begin_s <= of.window_s[1]:
            continue
        if path.name.startswith("imu"):
            vectors = [how.matrix @ np.array([float(value) for value in row[k : k + 3]]) for k in (1, 4)]
            row[1:7] = [f"{value:.9f}" for vector in vectors for value in vector.tolist()]
        elif path.name.startswith("gnss"):
            row[0] = f"{float(row[0]) + how.late_s:.6f}"
        else:
            row[1] = f"{float(row[1]) * how.scale:.6f}"
        written.append((separator or " ").join(row))
    target.write_text("\n".join(written) + "\n", encoding="utf-8")
