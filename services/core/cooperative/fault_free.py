"""The fault-free least-squares fix: position and velocity from the satellites that are left when some are excluded."""

from math import degrees

import numpy as np

from shared.maths.earth import geodetic_from_ecef, ned_from_ecef
from shared.messages.gnss import FaultFreeFix, GnssRawEpoch

from .measurements import SatelliteVerdict, upper


def fault_free_fix(verdict: SatelliteVerdict, epoch: GnssRawEpoch) -> FaultFreeFix | None:
    """Solution of an epoch in which satellites are excluded and the others agree; None of any other epoch."""
    solution = verdict.solution
    if solution is None or not (verdict.excluded and verdict.fault_free):
        return None
    place = geodetic_from_ecef(solution.position_e)
    to_ned = ned_from_ecef(place.latitude, place.longitude)
    velocity = cov = None
    if solution.velocity_e is not None and solution.velocity_cov_e is not None:
        north, east, down = (to_ned @ np.array(solution.velocity_e)).tolist()
        velocity, cov = (north, east, down), upper(to_ned @ solution.velocity_cov_e @ to_ned.T)
    return FaultFreeFix(
        sampled_ns=epoch.sampled_ns, received_ns=epoch.received_ns, source=epoch.source,
        latitude_deg=degrees(place.latitude), longitude_deg=degrees(place.longitude), height_ellipsoid_m=place.height,
        position_cov_ned_m2=upper(to_ned @ solution.position_cov_e @ to_ned.T),
        velocity_ned_m_s=velocity, velocity_cov_ned_m2_s2=cov,
        satellites_left_out=tuple(str(satellite) for satellite in verdict.excluded),
    )  # fmt: skip
