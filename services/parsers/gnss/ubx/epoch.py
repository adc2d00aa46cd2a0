"""Combines the UBX messages of one navigation epoch into one fix."""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from shared.maths.dates import DeviceDates
from shared.messages.base import Symmetric3, Vector3
from shared.messages.gnss import CarrierSolution, FixType, GnssFix

from ..gnss_time import gps_time_ns
from . import messages

MAX_SPEED_M_S = 600.0  # civil receivers are limited to about 500 m/s
# Message, and the field of `Epoch` that holds what it says; NAV-EOE says that the epoch is complete.
DECODERS: dict[str, tuple[str, Callable[[bytes], Any]]] = {
    "PVT": ("pvt", messages.decode_pvt),
    "PVAT": ("pvat", messages.decode_pvat),
    "DOP": ("dop", messages.decode_dop),
    "COV": ("covariance", messages.decode_covariance),
    "POSLLH": ("position", messages.decode_position),
    "HPPOSLLH": ("high_precision", messages.decode_high_precision),
    "RELPOSNED": ("baseline", messages.decode_baseline),
    "STATUS": ("status", messages.decode_status),
    "SOL": ("solution", messages.decode_solution),
    "VELNED": ("motion", messages.decode_velocity),
    "TIMEUTC": ("time_utc", messages.decode_time_utc),
    "TIMEGPS": ("time_gps", messages.decode_time_gps),
    "PL": ("levels", messages.decode_levels),
}

EPOCH_MESSAGES = frozenset(("STATUS", "SOL", "POSLLH", "VELNED", "TIMEUTC", "TIMEGPS", "PL"))


@dataclass(slots=True)
class Epoch:
    """The messages received so far of one epoch."""

    itow_ms: int
    first_received_ns: int
    last_received_ns: int
    pvt: messages.Pvt | None = None
    pvat: messages.Pvt | None = None
    dop: messages.Dop | None = None
    covariance: messages.Covariance | None = None
    position: messages.Position | None = None
    high_precision: messages.Position | None = None
    baseline: messages.Baseline | None = None
    status: messages.Status | None = None
    solution: messages.Solution | None = None
    motion: messages.Motion | None = None
    time_utc: tuple[int | None, bool] | None = None
    time_gps: tuple[int | None, bool] | None = None
    levels: messages.Levels | None = None

    def fix(self) -> messages.Pvt | None:
        """The fix of NAV-PVT or NAV-PVAT, or what NAV-POSLLH, SOL, VELNED, STATUS and TIMEUTC tell together.

        None without a message that says what kind of fix it is, or where none of a position came.
        """
        told = self.pvt or self.pvat
        return told if told is not None else self._of_parts()

    def _of_parts(self) -> messages.Pvt | None:
        solution = self.solution
        status = self.status or (solution.status if solution else None)
        if status is None or (solution is None and self.position is None):
            return None
        motion = self.motion or (solution.motion if solution else None)
        utc, time_valid = self.time_utc if self.time_utc and self.time_utc[1] else self.time_gps or (None, False)
        return messages.Pvt(
            itow_ms=self.itow_ms,
            utc_ns=utc,
            time_valid=time_valid,
            time_sd_ns=None,
            fix_type=status.fix_type,
            fix_ok=status.fix_ok,
            differential=status.differential,
            carrier_solution=CarrierSolution.NONE,
            satellites_used=solution.satellites_used if solution else None,
            position=self.position or (solution.position if solution else None),
            velocity_ned_m_s=motion.velocity_ned_m_s if motion else None,
            speed_sd_m_s=motion.speed_sd_m_s if motion else None,
            ground_speed_m_s=motion.ground_speed_m_s if motion else None,
            course_rad=motion.course_rad if motion else None,
            pdop=solution.pdop if solution else None,
            correction_age_s=None,
        )


class EpochAssembler:
    """Groups messages by time of week and yields each epoch once.

    An epoch is complete on NAV-EOE, when every kind of message of the two previous epochs has been received (two, so
    that one corrupted epoch does not truncate the next), or when the next epoch begins.
    `rejects` counts `ubx_<fault>` for invalid content, and `epoch_without_fix`.
    """

    def __init__(self, rejects: Counter[str]) -> None:
        self.rejects = rejects
        self._epoch: Epoch | None = None
        self._kinds: set[str] = set()
        self._kinds_before: deque[set[str]] = deque(maxlen=2)
        self._done = True
        self._has_fix = False  # whether the epoch before had NAV-PVT or NAV-PVAT

    def take(self, kind: str, payload: bytes, received_ns: int) -> Iterator[Epoch]:
        """Process one message; yield the completed epochs. Raises UbxError for one of which nothing is known."""
        itow = messages.itow_of(kind, payload)
        if self._epoch is None or itow != self._epoch.itow_ms:
            yield from self._finish()
            if self._epoch is not None:
                self._has_fix = self._epoch.pvt is not None or self._epoch.pvat is not None
            self._kinds_before.append(self._kinds)
            self._kinds = set()
            self._epoch, self._done = Epoch(itow, received_ns, received_ns), False
        elif self._done and kind in self._kinds:
            self.rejects["repeated_epoch"] += 1  # the receiver's time stands still
            return
        if kind == "EOE":
            yield from self._finish()
            return
        has_fix = self._has_fix or self._epoch.pvt is not None or self._epoch.pvat is not None
        if not (has_fix and kind in EPOCH_MESSAGES):  # of a fix that NAV-PVT gives, nobody waits for these
            self._kinds.add(kind)
            self._epoch.last_received_ns = received_ns
        try:
            field, decode = DECODERS[kind]
            setattr(self._epoch, field, decode(payload))
        except messages.UbxError as fault:
            self.rejects[str(fault)] += 1
        if all(self._kinds_before) and set.union(*self._kinds_before) <= self._kinds:
            yield from self._finish()

    def _finish(self) -> Iterator[Epoch]:
        if self._done or self._epoch is None:
            return
        self._done = True
        if self._epoch.fix() is None:
            self.rejects["epoch_without_fix"] += 1
        else:
            yield self._epoch


def fix_from_epoch(epoch: Epoch, pvt: messages.Pvt, *, sampled_ns: int, source: str, dates: DeviceDates) -> GnssFix:
    """Combine an epoch into one fix: the most precise position, and only values that the receiver marks valid.

    Parameters
    ----------
    epoch : Epoch
        The messages of the epoch.
    pvt : Pvt
        Its `fix`.
    sampled_ns : int
        [ns, OBU time line] Time of validity of the fix.
    source : str
        Name of the receiver.
    dates : DeviceDates
        Gives UTC its era; an impossible date is counted as `ubx_date`, and the fix is without UTC.

    Returns
    -------
    GnssFix
        Position, velocity and times are None unless the receiver sets gnssFixOK. Of a fix of time alone the position
        is that which was surveyed: `fix_type` says so, and it is not measured. The position is that of
        NAV-HPPOSLLH if valid; covariances are those of NAV-COV, otherwise diagonal, from the accuracies of NAV-PVT.

    Notes
    -----
    u-blox states the accuracy of the horizontal distance and of the 3D speed, here divided equally among the axes::

        sd_north = sd_east = hAcc / √2        sd_velocity_axis = sAcc / √3
    """
    stated_place = pvt.fix_ok and pvt.fix_type is not FixType.NONE
    usable = stated_place and pvt.fix_type is not FixType.TIME_ONLY
    position = (epoch.high_precision or pvt.position) if stated_place else None
    velocity, speed = pvt.velocity_ned_m_s or (), pvt.ground_speed_m_s
    moving = usable and speed is not None and max(speed, *map(abs, velocity)) <= MAX_SPEED_M_S
    stated = epoch.covariance or messages.Covariance(None, None)
    position_cov = _covariance(stated.position_ned_m2, _position_sd(position))
    velocity_cov = _covariance(stated.velocity_ned_m2_s2, _velocity_sd(pvt))
    dop = epoch.dop or messages.Dop(pvt.pdop, None, None)
    utc = dates.utc_ns(pvt.utc_ns, "ubx_date") if pvt.time_valid and pvt.fix_ok else None
    return GnssFix(
        sampled_ns=sampled_ns,
        received_ns=epoch.last_received_ns,
        source=source,
        gps_time_ns=None if utc is None else gps_time_ns(utc, pvt.itow_ms),
        utc_ns=utc,
        fix_type=pvt.fix_type,
        carrier_solution=pvt.carrier_solution,
        differential=pvt.differential,
        satellites_used=pvt.satellites_used,
        latitude_deg=position.latitude_deg if position else None,
        longitude_deg=position.longitude_deg if position else None,
        height_ellipsoid_m=position.height_ellipsoid_m if position else None,
        height_msl_m=position.height_msl_m if position else None,
        velocity_ned_m_s=pvt.velocity_ned_m_s if moving else None,
        ground_speed_m_s=pvt.ground_speed_m_s if moving else None,
        course_rad=pvt.course_rad if moving else None,
        position_sd_ned_m=_sd(position_cov) if position else None,
        velocity_sd_ned_m_s=_sd(velocity_cov) if moving else None,
        position_cov_ned_m2=position_cov if position else None,
        velocity_cov_ned_m2_s2=velocity_cov if moving else None,
        pdop=dop.pdop or pvt.pdop,
        hdop=dop.hdop,
        vdop=dop.vdop,
        gdop=dop.gdop,
        tdop=dop.tdop,
        time_sd_s=pvt.time_sd_ns / 1e9 if pvt.time_valid and pvt.time_sd_ns is not None else None,
        correction_age_s=pvt.correction_age_s,
        baseline_heading_rad=epoch.baseline.heading_rad if epoch.baseline else None,
        baseline_heading_sd_rad=epoch.baseline.heading_sd_rad if epoch.baseline else None,
        baseline_length_m=epoch.baseline.length_m if epoch.baseline else None,
        stated_horizontal_level_m=epoch.levels.horizontal_m if epoch.levels else None,
        stated_vertical_level_m=epoch.levels.vertical_m if epoch.levels else None,
        stated_level_ned_m=epoch.levels.ned_m if epoch.levels else None,
    )


def _position_sd(position: messages.Position | None) -> Vector3 | None:
    if position is None or position.horizontal_sd_m is None or position.vertical_sd_m is None:
        return None
    axis = position.horizontal_sd_m / 2**0.5
    return axis, axis, position.vertical_sd_m


def _velocity_sd(pvt: messages.Pvt) -> Vector3 | None:
    if pvt.speed_sd_m_s is None:
        return None
    axis = pvt.speed_sd_m_s / 3**0.5
    return axis, axis, axis


def _covariance(stated: Symmetric3 | None, sd: Vector3 | None) -> Symmetric3 | None:
    if stated is not None or sd is None:
        return stated
    north, east, down = sd
    return north * north, 0.0, 0.0, east * east, 0.0, down * down


def _sd(covariance: Symmetric3 | None) -> Vector3 | None:
    if covariance is None:
        return None
    return covariance[0] ** 0.5, covariance[3] ** 0.5, covariance[5] ** 0.5
