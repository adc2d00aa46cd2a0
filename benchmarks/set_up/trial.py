"""One wrong installation through the wizard: a drive, its findings applied, another drive, and what is left."""

from dataclasses import dataclass
from math import atan2, degrees

import numpy as np

from benchmarks.set_up.installation import Installation
from cli.set_up.drive import motion_of
from services.core.fusion.set_up.findings import Verdict
from services.core.fusion.set_up.survey.findings import Finding, Quantity, changes_of, findings_of
from services.core.fusion.set_up.survey.survey import survey
from services.core.fusion.settings import Settings
from shared.maths.earth import FloatArray

DRIVES = 2
GOALS = {
    Quantity.MOUNTING: (1.0, "deg"), Quantity.LEVER_ARM: (0.10, "m"), Quantity.DELAY: (0.020, "s"),
    Quantity.ODOMETER_SCALE: (0.005, "-"),
}  # fmt: skip


@dataclass(frozen=True)
class Left:
    """What is left of one error: before, after, the standard deviation that was stated, and whether it was known."""

    before: float
    after: float
    sd: float | None
    known: bool
    written: bool


@dataclass(frozen=True)
class Trial:
    """One installation: its scenario, and what is left of each error."""

    seed: int
    scenario: str
    left: dict[str, Left]


def trial(seed: int) -> Trial:
    """Set up the installation of a seed by two drives."""
    installation = Installation.random(seed)
    settings = installation.settings
    before = errors(installation, settings)
    known: dict[Quantity, Finding] = {}
    written: set[str] = set()
    for drive in range(1, DRIVES + 1):
        motion = motion_of(installation.messages(settings, drive), settings)
        assert motion is not None
        findings = findings_of(survey(motion, settings), settings)
        known |= {one.quantity: one for one in findings if one.verdict is not Verdict.UNKNOWN}
        changes = changes_of(findings)
        written |= set(changes)
        settings = settings.with_values({name.removeprefix("core.fusion."): value for name, value in changes.items()})
    after = errors(installation, settings)
    of_setting = {
        Quantity.MOUNTING: "vehicle.imu.body_from_sensor", Quantity.LEVER_ARM: "vehicle.gnss.lever_arm_body_m",
        Quantity.DELAY: "core.fusion.gnss.delay_s", Quantity.ODOMETER_SCALE: "core.fusion.odometer.scale",
    }  # fmt: skip
    left = {
        quantity.value: Left(
            before[quantity], after[quantity], known[quantity].sd if quantity in known else None,
            quantity in known, of_setting[quantity] in written,
        )
        for quantity in GOALS
    }  # fmt: skip
    return Trial(seed, installation.scenario, left)


def errors(installation: Installation, settings: Settings) -> dict[Quantity, float]:
    """Sizes of the errors of settings [deg, m, s, -]; of the scale against that of warm tyres."""
    true = installation.mounting.T  # body from sensor
    turn = np.array(settings.vehicle.imu.body_from_sensor) @ true.T
    arm = np.array(settings.vehicle.gnss.lever_arm_body_m) - installation.arm
    scale = settings.odometer.scale * installation.scale * (1.0 + installation.wind_up)
    return {
        Quantity.MOUNTING: degrees(angle_of(turn)),
        Quantity.LEVER_ARM: float(np.hypot(arm[0], arm[1])),
        Quantity.DELAY: abs(settings.gnss.delay_s - installation.delay_s),
        Quantity.ODOMETER_SCALE: abs(scale - 1.0),
    }


def angle_of(turn: FloatArray) -> float:
    """Angle of a rotation [rad]; half a turn of one that mirrors."""
    if np.linalg.det(turn) < 0.0:
        return float(np.pi)
    sine = 0.5 * float(np.linalg.norm(turn - turn.T)) / 2.0**0.5
    return atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0))
