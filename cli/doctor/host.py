"""The computer itself: disk, clock, temperature, supply voltage."""

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from shared.maths.dates import is_plausible
from shared.runtime.clock import maximum_error_s

from .finding import Finding

MIN_FREE_BYTES = 1_000_000_000
HOT_C = 80.0  # at which a Raspberry Pi slows down
UNDER_VOLTAGE, UNDER_VOLTAGE_BEFORE, THROTTLED = 1 << 0, 1 << 16, 1 << 2
THROTTLED_FILES = (
    "sys/devices/platform/soc/soc:firmware/get_throttled",
    "sys/devices/platform/soc@0/soc@0:firmware/get_throttled",
)


def host(folder: Path, root: Path = Path("/")) -> Iterator[Finding]:
    """Check the computer; `root` is the folder in which its `sys` is."""
    free = shutil.disk_usage(folder).free
    yield Finding(
        free > MIN_FREE_BYTES, f"{free / 1e9:.1f} GB free in {folder}", "delete old recordings or set OBU_STATE"
    )
    yield from _clock()
    yield from _temperature(root)
    yield from _supply(root)


def _clock() -> Iterator[Finding]:
    shown = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime())
    if not is_plausible(time.time_ns()):
        yield Finding(False, f"the clock shows {shown}", "set it, or fit a clock with a battery")
        return
    error_s = maximum_error_s()
    if error_s is None:
        yield Finding(True, f"the clock shows {shown}; neither chrony nor systemd-timesyncd holds it")
    else:
        yield Finding(True, f"the clock shows {shown}, held within {error_s * 1e3:.0f} ms")


def _temperature(root: Path) -> Iterator[Finding]:
    found = [_number(path / "temp") for path in sorted((root / "sys/class/thermal").glob("thermal_zone*"))]
    celsius = [value / 1e3 for value in found if value is not None and -50_000 < value < 200_000]
    if celsius:
        hottest = max(celsius)
        yield Finding(hottest < HOT_C, f"the processor has {hottest:.0f} °C", "shade it, or fit a heat sink or a fan")


def _supply(root: Path) -> Iterator[Finding]:
    """Under-voltage, as a Raspberry Pi says it."""
    words = [_number(root / path, base=16) for path in THROTTLED_FILES]
    known = [word for word in words if word is not None]
    alarms = [_number(path) for path in (root / "sys/class/hwmon").glob("hwmon*/in0_lcrit_alarm")]
    present = any(word & (UNDER_VOLTAGE | THROTTLED) for word in known) or any(alarms)
    before = any(word & UNDER_VOLTAGE_BEFORE for word in known)
    if known or alarms:
        remedy = "use a supply that gives 5.1 V and the current of all devices, and a short cable"
        what = "the supply voltage is too low" if present else "the supply voltage was too low since the start"
        yield Finding(not (present or before), what if present or before else "the supply voltage suffices", remedy)


def _number(path: Path, base: int = 10) -> int | None:
    try:
        return int(path.read_text().strip(), base)
    except (OSError, ValueError):
        return None
