"""Follows the carriers of one receiver from epoch to epoch."""

import numpy as np

from shared.messages.base import Vector3
from shared.messages.gnss import CarrierDisplacement

from ..broadcast.store import EphemerisStore
from ..measurements import FloatArray, RawEpoch, SatelliteSolution, upper
from ..satellites.model import ErrorModel
from .displacement import Displacement, carrier_displacement

KNOWN_S = 3.0  # for which a position is near enough without a displacement since then


class CarrierTrack:
    """Displacements between the epochs of one receiver, from the first one whose position is known."""

    def __init__(self, errors: ErrorModel) -> None:
        self._errors = errors
        self._source: str | None = None
        self._epoch: RawEpoch | None = None  # the newest
        self._stamp_ns = 0
        self._position_e: FloatArray | None = None
        self._position_ns = 0  # GPS time of it

    def locate(self, solution: SatelliteSolution, gps_time_ns: int) -> None:
        """Take the position at an epoch, as its pseudoranges give it."""
        self._position_e, self._position_ns = np.array(solution.position_e), gps_time_ns

    def follow(
        self, epoch: RawEpoch, source: str, sampled_ns: int, received_ns: int, store: EphemerisStore
    ) -> CarrierDisplacement | None:
        """Displacement from the epoch before to this one; None where there is none."""
        before, before_ns = self._epoch, self._stamp_ns
        is_another = source != self._source
        self._source, self._epoch, self._stamp_ns = source, epoch, sampled_ns
        if is_another:
            self._position_e = None
        if before is None or is_another or not before_ns < sampled_ns:
            return None
        if self._position_e is None or abs(before.gps_time_ns - self._position_ns) > KNOWN_S * 1e9:
            return None
        found = carrier_displacement(before, epoch, store, self._position_e, errors=self._errors)
        if found is None:
            return None
        self._position_e, self._position_ns = found.position_e, epoch.gps_time_ns
        return _message(found, source, before_ns, sampled_ns, received_ns)


def _message(found: Displacement, source: str, since_ns: int, sampled_ns: int, received_ns: int) -> CarrierDisplacement:
    north, east, down = found.displacement_n.tolist()
    return CarrierDisplacement(
        sampled_ns=sampled_ns, received_ns=received_ns, source=source, since_ns=since_ns,
        displacement_ned_m=(north, east, down), displacement_cov_ned_m2=upper(found.cov),
        slow_cov_ned_m2=upper(found.slow_cov), satellites_used=len(found.used), redundancy=found.redundancy,
        satellites_slipped=tuple(map(str, found.slipped)), checked=found.checked,
        doppler_velocity_ned_m_s=_vector(found.doppler_velocity_n), doppler_sd_ned_m_s=_vector(found.doppler_sd),
    )  # fmt: skip


def _vector(values: FloatArray | None) -> Vector3 | None:
    if values is None:
        return None
    north, east, down = values.tolist()
    return north, east, down
