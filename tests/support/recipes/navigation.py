"""Examples of what computes and judges the position: an aid, a monitor, a hypothesis."""

from .recipe import Example
from .tree import Edit

VIEWS = "services/monitoring/status"
KINDS = "services/core/fusion/aids/kinds.py"

AID: Example = (
    (
        Edit(
            "shared/messages/navigation.py",
            '    STATED_HEADING = "stated_heading"\n',
            after='    MAGNETIC_HEADING = "magnetic_heading"\n',
        ),
    ),
    (
        Edit("services/core/fusion/aids/stated_heading/__init__.py", '"""Aid: heading that a receiver states."""\n'),
        Edit(
            "services/core/fusion/aids/stated_heading/aid.py",
            '''"""Heading that a receiver states by its own filter."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import atan2

import numpy as np

from shared.inertial.strapdown import rotate
from shared.maths.earth import wrap_angle
from shared.messages.gnss import GnssFix
from shared.messages.navigation import AidingKind

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter
from ...settings import Settings
from ..base import Kind, Observation, Sensor

SD = 0.05  # [rad] of a heading that a receiver states


@dataclass(frozen=True)
class StatedHeading(Kind):
    """Heading [rad, clockwise from north] of the vehicle."""

    sensor = Sensor.GNSS

    time_ns: int
    received_ns: int
    source: str
    heading: float

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Heading alone."""
        yield self.observe

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation against the heading of the filter."""
        north, east, _ = rotate(navigation.quaternion, (1.0, 0.0, 0.0))
        H = np.zeros((1, em.SIZE))
        H[0, em.ATTITUDE.stop - 1] = -1.0
        z = np.array([wrap_angle(self.heading - atan2(east, north))])
        return Observation(AidingKind.STATED_HEADING, z, H, np.array([[SD**2]]))


def of_fix(fix: GnssFix, _settings: Settings) -> Iterator[StatedHeading]:
    """Heading of a fix, if it has one."""
    if fix.stated_heading_rad is not None:
        yield StatedHeading(fix.sampled_ns, fix.received_ns, fix.source, fix.stated_heading_rad)


KINDS = {GnssFix: (of_fix,)}
''',
        ),
    ),
    (
        Edit(
            KINDS,
            "from .stated_heading import aid as stated_heading\n",
            after="from .odometer import aid as odometer\n",
        ),
        Edit(KINDS, ", stated_heading", after="barometer, magnetometer, dual_antenna"),
    ),
    (
        Edit(
            f"{VIEWS}/series/fields.py",
            '    AidingKind.STATED_HEADING: "rad",\n',
            after='AidingKind.BASELINE_HEADING: "rad", AidingKind.MAGNETIC_HEADING: "rad",\n',
        ),
    ),
    (
        Edit(
            f"{VIEWS}/views/words.toml",
            'gate_stated_heading = "Stated heading residual"\n',
            after='gate_magnetic_heading = "Magnetic heading residual"\n',
        ),
        Edit(
            f"{VIEWS}/dashboard/charts/chart_words.js",
            '    stated_heading: "Stated heading",\n',
            after='    magnetic_heading: "Magnetic heading",\n',
        ),
    ),
    (
        Edit(
            "docs/explanation/navigation.md",
            "| `stated_heading` | stated - heading of C u | ψ_D: -1 | 0.05 rad |\n| `magnetic_heading` |",
            instead_of="| `magnetic_heading` |",
        ),
    ),
)

MOTION = "services/core/motion_conflict"
MOTION_TEST = "tests/unit/core/motion_conflict/test_process.py"
MONITOR: Example = (
    (
        Edit(
            "services/core/trust/facts.py",
            '    SPEED_RANGE = "speed_range"  # what a road vehicle can drive\n',
            after='    MOTION_FAST = "motion_fast"  # difference of speeds over 5 s\n',
        ),
    ),
    (
        Edit(
            f"{MOTION}/speed_range.py",
            '''"""Range of the odometer's speed: more than a road vehicle can drive is a wrong odometer."""

from shared.messages.explanation import explain
from shared.messages.trust import Outcome
from shared.trust.accused import ODOMETER
from shared.trust.result import Test, judged

from .codes import Code

LARGEST_M_S = 120.0


def range_test(speed_m_s: float | None) -> Test:
    """Compare a speed with the largest of a road vehicle."""
    if speed_m_s is None:
        return Test(Outcome.NOT_EVALUATED, explain(Code.NO_SPEED))
    base = Test(Outcome.PASS, explain(Code.SPEED_RANGE), "m/s", accused=(ODOMETER,))
    return judged(base, abs(speed_m_s), LARGEST_M_S)
''',
        ),
    ),
    (
        Edit(
            f"{MOTION}/process.py",
            "from .speed_range import range_test\n",
            after="from .settings import Settings\n",
        ),
        Edit(
            f"{MOTION}/process.py",
            '                yield statement("speed_range", range_test(self._driven_m_s), time_ns)\n',
            after='                yield statement("coherent_scale", self.inertial.verdict(time_ns), time_ns)\n',
        ),
        Edit(
            f"{MOTION}/process.py",
            "        self._driven_m_s: float | None = None  # newest speed of the odometer\n",
            after="        self._monitor = MotionMonitor(config)\n",
        ),
        Edit(
            f"{MOTION}/process.py",
            "                self._driven_m_s = message.speed_m_s\n",
            after="                self._use_odometer(message)\n",
        ),
        Edit(MOTION_TEST, '        "speed_range",\n', after='        "motion_fast",\n        "coherent_scale",\n'),
    ),
    (
        Edit(
            f"{MOTION}/codes.py",
            '    NO_SPEED = "motion.no_speed"\n    SPEED_RANGE = "motion.speed_range"\n',
            after='    NO_INPUT = "motion.no_input"  # has never come\n',
        ),
        Edit(
            f"{MOTION}/words.toml",
            '[motion.no_speed]\ndetail = "no speed of the odometer received yet"\n\n'
            '[motion.speed_range]\ndetail = "{statistic:speed} by the odometer, limit {threshold:speed}"\n\n'
            "[motion.no_input]\n",
            instead_of="[motion.no_input]\n",
        ),
    ),
    (
        Edit(
            "services/core/trust/words.toml",
            'speed_range = "Range of speeds"\n',
            after='motion_fast = "Fast motion test"\n',
        ),
        Edit(
            f"{VIEWS}/dashboard/words.js",
            '      speed_range: "speed of the odometer with the largest of a road vehicle",\n',
            after='      gyroscope: "yaw rate of the gyroscope against wheels, GNSS course and headings",\n',
        ),
    ),
    (
        Edit(
            "docs/explanation/trust.md",
            "| `speed_range` | speed with that of a road vehicle | `core.motion_conflict` |\n| `evidence` |",
            instead_of="| `evidence` |",
        ),
    ),
)

TRUST = "services/core/trust"
STYLE = f"{VIEWS}/dashboard/map/style.js"
HYPOTHESIS: Example = (
    (
        Edit(
            "shared/messages/trust.py",
            '    TYRES = "tyres"  # the radius of the wheels has changed\n',
            after='    ODOMETER = "odometer"\n',
        ),
    ),
    (
        Edit(
            f"{TRUST}/hypotheses/priors.py",
            "    # A change of tyres, until the scale is estimated.\n    Hypothesis.TYRES: 1e-4,\n",
            after="    Hypothesis.ODOMETER: 1e-3,\n",
        ),
    ),
    (
        Edit(
            f"{TRUST}/hypotheses/evidence.py",
            "    if monitor is Monitor.MOTION_FAST and ODOMETER in named:\n        found[Hypothesis.TYRES] = PARTLY\n",
            after="    found = {hypothesis: EXPLAINED for name, hypothesis in OF_SOURCE.items() if name in named}\n",
        ),
    ),
    (
        Edit(
            "services/core/fusion/hypotheses/bank.py",
            '    CursorPlan(Hypothesis.TYRES, ("odometer",), _without_odometer, INFINITE_AGE_S, odometer=True),\n',
            after='    CursorPlan(Hypothesis.ODOMETER, ("odometer",), _without_odometer, INFINITE_AGE_S, '
            "odometer=True),\n",
        ),
    ),
    (
        Edit(
            f"{TRUST}/words.toml",
            'tyres = "the radius of the wheels has changed"\n',
            after='odometer = "the odometer is wrong"\n',
        ),
        Edit(
            f"{VIEWS}/views/words.toml",
            'tyres = "The radius of the wheels has changed"\n',
            after='odometer = "The odometer is wrong"\n',
        ),
        Edit(
            f"{VIEWS}/views/words.toml",
            'tyres = "if the radius of the wheels has changed"\n',
            after='odometer = "if the odometer is wrong"\n',
        ),
        Edit("shared/words/en.toml", 'tyres = "the tyres"\n', after='gnss_and_odometer = "GNSS and odometer"\n'),
        Edit("shared/words/de.toml", 'tyres = "Reifen"\n', after='gnss_and_odometer = "GNSS und Wegmesser"\n'),
        Edit("shared/words/fr.toml", 'tyres = "pneus"\n', after='gnss_and_odometer = "GNSS et odomètre"\n'),
    ),
    (
        Edit(f"{VIEWS}/dashboard/trust/hypotheses.js", ' "tyres",', after='"imu", "odometer",'),
        Edit(STYLE, ' tyres: "#3d5a00",', after='odometer: "#00795a",'),
        Edit(STYLE, ' tyres: "#a5d05a",', after='odometer: "#35c495",'),
        Edit(STYLE, ' tyres: "#b3442f",', after='odometer: "#d9543f",'),
        Edit(STYLE, " tyres: [3, 3],", after="odometer: [6, 2, 1, 2],"),
    ),
    (
        Edit(
            "docs/explanation/trust.md",
            "| `tyres`: the radius of the wheels has changed | 1e-4 | as for the odometer |\n| `gnss`: ",
            instead_of="| `gnss`: ",
        ),
    ),
)

EXAMPLES = {"aid": AID, "monitor": MONITOR, "hypothesis": HYPOTHESIS}
