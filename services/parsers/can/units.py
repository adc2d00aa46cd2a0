"""Units as DBC files write them, in SI."""

from math import pi

DEGREE = pi / 180.0
# In lower case and without blanks: files write km/h, KPH, km / h, Kmh ...
UNITS_M_S = {
    **dict.fromkeys(("m/s", "mps", "meter/s", "m/sec"), 1.0), **dict.fromkeys(("cm/s",), 0.01),
    **dict.fromkeys(("mm/s",), 0.001),
    **dict.fromkeys(("km/h", "kph", "kmh", "kmph", "kmp/h", "km/hr", "km/hour", "kilometerperhour", "kilometreperhour"),
                    1 / 3.6),
    **dict.fromkeys(("mph", "mi/h", "mile/h", "miles/h", "milesperhour"), 0.44704),
    **dict.fromkeys(("kn", "kt", "kts", "knot", "knots"), 1852.0 / 3600.0),
}  # fmt: skip
UNITS_RAD = {
    **dict.fromkeys(("rad", "radian", "radians"), 1.0), "mrad": 0.001,
    **dict.fromkeys(("deg", "°", "degree", "degrees", "grad", "º"), DEGREE),
}  # fmt: skip
UNITS_RAD_S = {
    **{f"{name}/{second}": factor for name, factor in UNITS_RAD.items() for second in ("s", "sec", "second")},
    "dps": DEGREE, "degpersec": DEGREE,
}  # fmt: skip
UNITS_M_S2 = {
    **dict.fromkeys(("m/s2", "m/s^2", "m/s/s", "m/s²", "mps2", "m/ss", "m/s**2"), 1.0), "g": 9.80665, "mg": 9.80665e-3,
}  # fmt: skip
UNITS_M = {
    **dict.fromkeys(("m", "meter", "metre"), 1.0), "cm": 0.01, "mm": 0.001,
    **dict.fromkeys(("km", "kilometer", "kilometre"), 1000.0), **dict.fromkeys(("mi", "mile", "miles"), 1609.344),
}  # fmt: skip
OF_SI = {"m/s": UNITS_M_S, "rad/s": UNITS_RAD_S, "rad": UNITS_RAD, "m/s²": UNITS_M_S2, "m": UNITS_M}
# Named quantities whose unit on the bus is SI; other names keep the unit that the file states.
QUANTITIES = {
    "vehicle_speed": "m/s", "wheel_speed": "m/s", "yaw_rate": "rad/s", "steering_angle": "rad",
    "steering_wheel_angle": "rad", "acceleration_longitudinal": "m/s²", "acceleration_lateral": "m/s²", "odometer": "m",
}  # fmt: skip


def factor_of(text: str | None, si_unit: str) -> float | None:
    """Factor from a unit to an SI unit, however it is written; None if it is no known unit of that quantity."""
    return OF_SI[si_unit].get("".join((text or "").lower().split()).strip("[]()"))


def examples_of(si_unit: str) -> str:
    """Some spellings of the units of a quantity."""
    table = OF_SI[si_unit]
    return ", ".join({factor: name for name, factor in reversed(table.items())}.values())
