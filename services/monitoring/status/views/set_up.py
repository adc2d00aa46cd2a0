"""The set-up as JSON: each step by what the unit measures, and by what somebody has confirmed."""

from collections.abc import Iterable, Mapping
from itertools import pairwise
from math import atan2, degrees, hypot, sqrt
from statistics import fmean, median, pstdev

from shared.messages.corrections import CorrectionsState
from shared.messages.gnss import GnssConfiguration, GnssFix, GnssReceiver
from shared.messages.imu import ImuSamples
from shared.messages.navigation import NavigationSolution, SetUpState, SetUpVerdict
from shared.messages.operation import DeviceState
from shared.messages.settings import SettingsCatalogue
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.page.answers import Object
from shared.processes import BY_NAME
from shared.topics import BY_NAME as TOPICS

from ..state import State
from .models.set_up import DeviceShown, LevelShown, SignalShown, StepShown, StepState

Vector = tuple[float, float, float]  # as of shared.maths.rotation, which needs numpy: 70 MB in this process
STEPS = ("unit", "devices", "receiver", "corrections", "imu", "antenna", "bus", "drive")
CONFIRMED = ("unit", "antenna")  # steps that somebody confirms
MOVING_M_S = 5.0 / 3.6
SETTINGS = (
    "vehicle.name", "vehicle.imu.body_from_sensor", "vehicle.gnss.lever_arm_body_m", "vehicle.gnss.lever_arm_sd_m",
    "core.fusion.gnss.delay_s", "core.fusion.gnss.velocity_delay_s", "core.fusion.odometer.scale",
    "core.spoofing.grade",
)  # fmt: skip
OF_IMU = ("accelerometer_scale", "imu_upright", "imu_axes", "imu_mounting", "gyroscope_axes", "gyroscope_bias")
STILL_RAD_S, STILL_M_S2 = 0.02, 0.35  # spread of samples while nothing moves, the engine may run
ENOUGH_SAMPLES, SHOWN = 200, 50
# Angle random walk [rad/√s] up to which a sensor is of a grade: between those of data sheets of each.
GRADES = ((5e-5, "tactical"), (1.6e-4, "industrial"), (4e-4, "automotive"))


def steps(state: State, confirmed: Mapping[str, int], survey: Object | None, now_ns: int) -> list[StepShown]:
    """State of each step, the order of the page."""
    found = {
        "unit": StepState.AGREES if "unit" in confirmed else StepState.NOT_DONE,
        "devices": _of_devices(devices(state, now_ns)),
        "receiver": _of_receiver(state),
        "corrections": _of_corrections(state, now_ns),
        "imu": _of_checks(state, OF_IMU),
        "antenna": _of_antenna(state, confirmed),
        "bus": _of_bus(state, now_ns),
        "drive": _of_survey(survey),
    }
    return [{"name": name, "state": found[name], "confirmed_ns": confirmed.get(name)} for name in STEPS]


def devices(state: State, now_ns: int) -> list[DeviceShown]:
    """Bytes of every configured device."""
    shown: list[DeviceShown] = []
    for name in sorted(state.expected):
        for topic in BY_NAME[name].produces if name.startswith("sensors.") and name in BY_NAME else ():
            if not TOPICS[topic].is_raw:
                continue
            flow = state.topics[topic]
            age_s = state.age_s(topic, now_ns)
            shown.append({
                "topic": topic, "process": name, "rate_hz": round(flow.rate_hz, 1),
                "fresh": flow.freshness(now_ns) == "fresh", "age_s": None if age_s is None else round(age_s, 1),
                "port": _port(state, name), "kinds": _kinds(state, topic),
            })  # fmt: skip
    return shown


def speed_of(state: State, now_ns: int) -> float | None:
    """Speed of the vehicle [m/s] by the filter, otherwise by the receiver."""
    solution = state.newest(NavigationSolution, "navigation/solution", now_ns, live=True)
    if solution is not None:
        return hypot(*solution.velocity_ned_m_s)
    fix = state.newest(GnssFix, "gnss/fix", now_ns, live=True)
    return None if fix is None else fix.ground_speed_m_s


def level(batches: Iterable[ImuSamples]) -> LevelShown | None:
    """Attitude of the unit at rest by gravity, and the noise of its sensors, of successive samples.

    The noise is that of differences between neighbours, which a slow change does not enter.
    """
    stamps, forces, rates = _samples(batches)
    if not stamps:
        return None
    newest = forces[-SHOWN:]
    x, y, z = (fmean(axis) for axis in zip(*newest, strict=True))
    still = _is_still(newest, STILL_M_S2) and _is_still(rates, STILL_RAD_S)
    step_s = 1e-9 * median(after - before for before, after in pairwise(stamps)) if len(stamps) > 1 else 0.0
    enough = still and len(stamps) >= ENOUGH_SAMPLES and step_s > 0.0
    force_walk, rate_walk = (_walk(stamps, vectors, step_s) if enough else None for vectors in (forces, rates))
    grade = None if rate_walk is None else next((name for most, name in GRADES if rate_walk <= most), "consumer")
    return {
        "roll_deg": round(degrees(atan2(-y, -z)), 2),
        "pitch_deg": round(degrees(atan2(x, hypot(y, z))), 2),
        "force_m_s2": round(hypot(x, y, z), 3),
        "still": still,
        "seconds": round(len(stamps) * step_s, 1),
        "force_noise": force_walk,
        "rate_noise": rate_walk,
        "grade": grade,
    }


def signals(state: State, now_ns: int) -> list[SignalShown]:
    """Speeds of the vehicle's network against that of GNSS, the one that follows it best first."""
    fix = state.newest(GnssFix, "gnss/fix", now_ns, live=True)
    gnss = None if fix is None else fix.ground_speed_m_s
    history = state.history.columns(now_ns, 600.0, ("speed_odometer_m_s", "speed_gnss_m_s"))
    pairs = _pairs(history)
    found: list[SignalShown] = []
    for topic in ("vehicle/wheel_speed", "vehicle/speed"):
        flow = state.topics[topic]
        if flow.message is None:
            continue
        ratio, correlation = compared(pairs) if not found else (None, None)  # the history is of the first
        found.append({
            "topic": topic, "rate_hz": round(flow.rate_hz, 1), "speed_m_s": _speed(flow.message), "gnss_m_s": gnss,
            "ratio": ratio, "correlation": correlation,
        })  # fmt: skip
    return found


def compared(pairs: list[tuple[float, float]]) -> tuple[float | None, float | None]:
    """Ratio of two speeds [-], and their correlation [-]; None of fewer than ten in motion."""
    moving = [(a, b) for a, b in pairs if b > 2.0]
    if len(moving) < 10:
        return None, None
    ratio = sum(a * b for a, b in moving) / sum(b * b for _, b in moving)
    a, b = ([pair[k] for pair in pairs] for k in (0, 1))
    spread = pstdev(a) * pstdev(b)
    mean_a, mean_b = fmean(a), fmean(b)
    both = fmean((x - mean_a) * (y - mean_b) for x, y in pairs)
    return round(ratio, 4), round(both / spread, 4) if spread > 0.0 else None


def values(state: State, further: Iterable[str] = ()) -> dict[str, str]:
    """Settings that the steps are about, and further ones, as far as this unit has them."""
    names = {*SETTINGS, *further}
    catalogue = state.topics["settings/catalogue"].message
    rows = catalogue.settings if isinstance(catalogue, SettingsCatalogue) else ()
    return {row.name: row.value for row in rows if row.name in names}


def receiver(state: State) -> Object | None:
    """What the receiver answered to its configuration, otherwise what it sends."""
    for topic, kind in (("gnss/configuration", GnssConfiguration), ("gnss/receiver", GnssReceiver)):
        message = state.topics[topic].message
        if isinstance(message, kind):
            return message.model_dump(mode="json")
    return None


def corrections(state: State, now_ns: int) -> Object | None:
    """State of the corrections, with the kind of the carrier's solution."""
    stated = state.newest(CorrectionsState, "corrections/state", now_ns, live=True)
    fix = state.newest(GnssFix, "gnss/fix", now_ns, live=True)
    if stated is None:
        return None
    return {
        **stated.model_dump(mode="json", include={"active", "reason", "frame_age_s", "types"}),
        "carrier": fix.carrier_solution.value if fix is not None else None,
    }


def _of_devices(rows: list[DeviceShown]) -> StepState:
    if not rows:
        return StepState.NOT_DONE
    if all(row["fresh"] for row in rows):
        return StepState.AGREES
    silent = [row for row in rows if not row["fresh"]]
    return StepState.CONTRADICTS if any(row["age_s"] is not None for row in silent) else StepState.MEASURING


def _of_receiver(state: State) -> StepState:
    stated = state.topics["gnss/configuration"].message
    if isinstance(stated, GnssConfiguration):
        return StepState.AGREES if stated.accepted else StepState.CONTRADICTS
    sent = state.topics["gnss/receiver"].message
    if not isinstance(sent, GnssReceiver):
        return StepState.NOT_DONE
    return StepState.AGREES if sent.gives_position else StepState.MEASURING


def _of_corrections(state: State, now_ns: int) -> StepState:
    stated = state.newest(CorrectionsState, "corrections/state", now_ns, live=True)
    if stated is None:
        return StepState.NOT_DONE
    return StepState.AGREES if stated.active is not None else StepState.MEASURING


def _of_checks(state: State, names: Iterable[str]) -> StepState:
    stated = state.topics["navigation/set_up"].message
    if not isinstance(stated, SetUpState):
        return StepState.NOT_DONE
    verdicts = {check.name: check.verdict for check in stated.checks}
    found = [verdicts.get(name, SetUpVerdict.UNKNOWN) for name in names]
    if SetUpVerdict.CONTRADICTS in found:
        return StepState.CONTRADICTS
    return StepState.AGREES if found and SetUpVerdict.UNKNOWN not in found else StepState.MEASURING


def _of_antenna(state: State, confirmed: Mapping[str, int]) -> StepState:
    measured = _of_checks(state, ("lever_arm",))
    if measured in (StepState.AGREES, StepState.CONTRADICTS):
        return measured
    return StepState.MEASURING if "antenna" in confirmed else StepState.NOT_DONE


def _of_bus(state: State, now_ns: int) -> StepState:
    if not signals(state, now_ns):
        return StepState.NOT_DONE
    return _of_checks(state, ("odometer_scale",))


def _of_survey(survey: Object | None) -> StepState:
    rows = survey.get("findings") if survey else None
    if not isinstance(rows, list):
        return StepState.NOT_DONE
    found = [row.get("verdict") for row in rows if isinstance(row, dict)]
    if "contradicts" in found:
        return StepState.CONTRADICTS
    return StepState.AGREES if "agrees" in found else StepState.MEASURING


def _port(state: State, process: str) -> Object | None:
    message = state.topics["device/state"].message
    if process == "sensors.gnss":
        known = [one.device for one in state.gnss.receivers.values() if one.device is not None]
        message = max(known, key=lambda one: one.sampled_ns, default=None)
    if not isinstance(message, DeviceState) or message.process != process:
        return None
    return message.model_dump(mode="json", include={"device", "found", "protocols", "rate_baud", "sentence"})


def _kinds(state: State, topic: str) -> list[str]:
    names = [name for name in TOPICS[topic].consumers if name.startswith("parsers.")]
    return [kind.kind for name in names if name in state.processes for kind in state.processes[name].kinds][:12]


def _speed(message: object) -> float | None:
    if isinstance(message, VehicleSpeed):
        return message.speed_m_s
    if isinstance(message, WheelSpeeds):
        wheels = message.rear_left_m_s, message.rear_right_m_s, message.front_left_m_s, message.front_right_m_s
        known = [one for one in wheels if one is not None]
        return fmean(known) if known else None
    return None


def _pairs(history: Mapping[str, object]) -> list[tuple[float, float]]:
    fields = history["fields"]
    assert isinstance(fields, dict)
    both = zip(fields["speed_odometer_m_s"], fields["speed_gnss_m_s"], strict=True)
    return [(a, b) for a, b in both if a is not None and b is not None]


def _samples(batches: Iterable[ImuSamples]) -> tuple[list[int], list[Vector], list[Vector]]:
    """Stamps [ns], forces [m/s²] and rates [rad/s] of batches, one after the other."""
    stamps: list[int] = []
    forces: list[Vector] = []
    rates: list[Vector] = []
    for batch in batches:
        stamps += batch.sampled_ns
        forces += batch.specific_force_body_m_s2
        rates += batch.angular_rate_body_rad_s
    return stamps, forces, rates


def _is_still(vectors: list[Vector], most: float) -> bool:
    return all(pstdev(axis) < most for axis in zip(*vectors, strict=True))


def _walk(stamps: list[int], vectors: list[Vector], step_s: float) -> float | None:
    """Random walk of the worst axis: of white noise, differences between neighbours have twice its variance."""
    pairs = [
        (vectors[place], vectors[place + 1])
        for place, (before, after) in enumerate(pairwise(stamps))
        if after - before < 1.5e9 * step_s
    ]
    if not pairs:
        return None
    worst = max(fmean((after[axis] - before[axis]) ** 2 for before, after in pairs) for axis in range(3))
    return sqrt(0.5 * worst * step_s)
