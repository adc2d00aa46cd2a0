"""Messages from which monitoring.outputs makes its reports: a vehicle that drives north-east at 5 m/s."""

from typing import Any

from shared.messages.gnss import Constellation, FixType, GnssFix, GnssSatellites, Satellite
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.messages.operation import Origin, OriginKind
from shared.messages.trust import TrustLevel, TrustState

LATITUDE_DEG, LONGITUDE_DEG = 48.123456789, 11.567891234
HEIGHT_M, SEPARATION_M = 560.0, 46.5


def solution(time_ns: int, **changes: Any) -> NavigationSolution:
    values: dict[str, Any] = {
        "sampled_ns": time_ns, "phase": NavigationPhase.NAVIGATING, "latitude_deg": LATITUDE_DEG,
        "longitude_deg": LONGITUDE_DEG, "height_ellipsoid_m": HEIGHT_M, "velocity_ned_m_s": (3.0, 4.0, -0.5),
        "roll_rad": 0.01, "pitch_rad": 0.02, "yaw_rad": -0.5, "position_cov_ned_m2": (1.0, 0.0, 0.0, 4.0, 0.0, 9.0),
        "velocity_cov_ned_m2_s2": (0.01, 0.0, 0.0, 0.01, 0.0, 0.04),
        "attitude_cov_ned_rad2": (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), "angular_rate_body_rad_s": (0.0, 0.0, 0.0),
        "accelerometer_bias_m_s2": (0.0, 0.0, 0.0), "gyroscope_bias_rad_s": (0.0, 0.0, 0.0), "stationary": False,
        "gnss_age_s": 0.1,
    }  # fmt: skip
    return NavigationSolution(**{**values, **changes})


def verdict(time_ns: int, state: TrustLevel = TrustLevel.SAFE, **changes: Any) -> TrustState:
    return TrustState(sampled_ns=time_ns, state=state, since_ns=time_ns, row=1, reasons=(),
                      alert_limit_horizontal_m=10.0, alert_limit_vertical_m=20.0, **changes)  # fmt: skip


def fix(time_ns: int, utc_ns: int | None, **changes: Any) -> GnssFix:
    values: dict[str, Any] = {
        "sampled_ns": time_ns, "received_ns": time_ns, "source": "gnss0", "utc_ns": utc_ns,
        "fix_type": FixType.THREE_D, "satellites_used": 8, "height_ellipsoid_m": HEIGHT_M,
        "height_msl_m": HEIGHT_M - SEPARATION_M, "pdop": 1.5, "hdop": 0.9, "vdop": 1.2,
    }  # fmt: skip
    return GnssFix(**{**values, **changes})


def satellites(time_ns: int, used: int = 8, seen: int = 12) -> GnssSatellites:
    rows = tuple(
        Satellite(constellation=(Constellation.GPS, Constellation.GALILEO)[number % 2], number=number + 1,
                  cn0_db_hz=40.0, elevation_rad=0.5, azimuth_rad=1.0, used=number < used)
        for number in range(seen)
    )  # fmt: skip
    return GnssSatellites(sampled_ns=time_ns, received_ns=time_ns, source="gnss0", satellites=rows)


def origin(time_ns: int, kind: OriginKind = OriginKind.LIVE) -> Origin:
    return Origin(now_ns=time_ns, kind=kind, name="car")
