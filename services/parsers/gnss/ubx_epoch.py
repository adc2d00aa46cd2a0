"""Combines the UBX messages of one navigation epoch into one fix."""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from shared.maths.dates import DeviceDates
from shared.messages.base import Symmetric3, Vector3
from shared.messages.gnss import FixType, GnssFix

from . import ubx_messages
from .gnss_time import gps_time_ns, utc_ns

FASTEST_M_S = 600.0  # civil receivers are limited to about 500 m/s


@dataclass(slots=True)
class Epoch:
    """The messages received so far of one epoch."""

    itow_ms: int
    first_received_ns: int
    last_received_ns: int
    pvt: ubx_messages.Pvt | None = None
    dop: ubx_messages.Dop | None = None
    covariance: ubx_messages.Covariance | None = None
    high_precision: ubx_messages.HighPrecision | None = None
    baseline: ubx_messages.Baseline | None = None


class EpochAssembler:
    """Groups messages by time of week and yields each epoch once.

    An epoch is complete on NAV-EOE, when every kind of message of the two previous epochs has been received (two, so
    that one corrupted epoch does not truncate the next), or when the next epoch begins.
    `rejects` counts `ubx_<fault>` for invalid content, and `epoch_without_pvt`.
    """

    def __init__(self, rejects: Counter[str]) -> None:
        self.rejects = rejects
        self._epoch: Epoch | None = None
        self._kinds: set[str] = set()
        self._kinds_before: deque[set[str]] = deque(maxlen=2)
        self._done = True

    def take(self, kind: str, payload: bytes, received_ns: int) -> Iterator[Epoch]:
        """Process one message; yield the completed epochs."""
        message = ubx_messages.parse(kind, payload)
        itow = message.iTOW
        if self._epoch is None or itow != self._epoch.itow_ms:
            yield from self._finish()
            self._kinds_before.append(self._kinds)
            self._kinds = set()
            self._epoch, self._done = Epoch(itow, received_ns, received_ns), False
        if kind == "EOE":
            yield from self._finish()
            return
        self._kinds.add(kind)
        self._epoch.last_received_ns = received_ns
        try:
            _store(self._epoch, kind, message)
        except ubx_messages.UbxError as fault:
            self.rejects[f"ubx_{fault}"] += 1
        if all(self._kinds_before) and set.union(*self._kinds_before) <= self._kinds:
            yield from self._finish()

    def _finish(self) -> Iterator[Epoch]:
        if self._done or self._epoch is None:
            return
        self._done = True
        if self._epoch.pvt is None:
            self.rejects["epoch_without_pvt"] += 1
        else:
            yield self._epoch


def _store(epoch: Epoch, kind: str, message: Any) -> None:
    if kind == "PVT":
        epoch.pvt = ubx_messages.decode_pvt(message)
    elif kind == "DOP":
        epoch.dop = ubx_messages.decode_dop(message)
    elif kind == "COV":
        epoch.covariance = ubx_messages.decode_covariance(message)
    elif kind == "HPPOSLLH":
        epoch.high_precision = ubx_messages.decode_high_precision(message)
    elif kind == "RELPOSNED":
        epoch.baseline = ubx_messages.decode_baseline(message)


def fix_from_epoch(epoch: Epoch, pvt: ubx_messages.Pvt, *, sampled_ns: int, source: str, dates: DeviceDates) -> GnssFix:
    """Combine an epoch into one fix: the most precise position, and only values that the receiver marks valid.

    Parameters
    ----------
    epoch : Epoch
        The messages of the epoch.
    pvt : Pvt
        Its NAV-PVT.
    sampled_ns : int
        [ns, OBU time line] Time of validity of the fix.
    source : str
        Name of the receiver.
    dates : DeviceDates
        Gives UTC its era; an impossible date is counted as `ubx_date`, and the fix is without UTC.

    Returns
    -------
    GnssFix
        Position, velocity and times are None unless the receiver sets gnssFixOK. The position is that of
        NAV-HPPOSLLH if valid; covariances are those of NAV-COV, otherwise diagonal, from the accuracies of NAV-PVT.

    Notes
    -----
    u-blox states the accuracy of the horizontal distance and of the 3D speed, here divided equally among the axes::

        sd_north = sd_east = hAcc / √2        sd_velocity_axis = sAcc / √3
    """
    usable = pvt.fix_ok and pvt.fix_type not in (FixType.NONE, FixType.TIME_ONLY)
    precise = epoch.high_precision.position if epoch.high_precision else None
    position = (precise or pvt.position) if usable else None
    moving = usable and pvt.ground_speed_m_s <= FASTEST_M_S and max(map(abs, pvt.velocity_ned_m_s)) <= FASTEST_M_S
    stated = epoch.covariance or ubx_messages.Covariance(pvt.itow_ms, None, None)
    position_cov = _covariance(stated.position_ned_m2, _position_sd(position))
    velocity_cov = _covariance(stated.velocity_ned_m2_s2, _velocity_sd(pvt))
    dop = epoch.dop or ubx_messages.Dop(pvt.itow_ms, pvt.pdop, None, None)
    known = pvt.time_valid and pvt.fix_ok
    utc = dates.utc_ns(utc_ns(pvt.calendar, pvt.nanosecond), "ubx_date") if known else None
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
        correction_age_s=pvt.correction_age_s,
        baseline_heading_rad=epoch.baseline.heading_rad if epoch.baseline else None,
        baseline_heading_sd_rad=epoch.baseline.heading_sd_rad if epoch.baseline else None,
        baseline_length_m=epoch.baseline.length_m if epoch.baseline else None,
    )


def _position_sd(position: ubx_messages.Position | None) -> Vector3 | None:
    if position is None or position.horizontal_sd_m is None or position.vertical_sd_m is None:
        return None
    axis = position.horizontal_sd_m / 2**0.5
    return axis, axis, position.vertical_sd_m


def _velocity_sd(pvt: ubx_messages.Pvt) -> Vector3 | None:
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
