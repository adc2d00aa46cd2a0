"""The newest position for programs, with what it is worth: as a flat object, and as a GeoJSON feature (RFC 7946)."""

from math import degrees, hypot
from typing import cast

from shared.messages.navigation import NavigationSolution

from ..state import State
from .banner import KNOWN
from .geometry import ellipse_95, horizontal_sd, vertical_sd
from .height import above_sea
from .models.position import Feature, Point, Properties, Solution
from .snapshot import rounded

TOPIC = "navigation/solution"
PLACE = ("longitude_deg", "latitude_deg", "height_ellipsoid_m")


def solution(state: State, now_ns: int) -> Solution:
    """Show the newest solution; what is not known is null, and without any solution all of it is."""
    s, verdict = state.newest(NavigationSolution, TOPIC, now_ns), state.verdict
    ellipse = ellipse_95(s.position_cov_ned_m2) if s else None
    limits = state.evidence(now_ns)
    sea = above_sea(state, s) if s else None
    return {
        "state": verdict.state,
        "sentence": verdict.sentence,
        "verdict_known": verdict.state in KNOWN,
        "live": state.newest(NavigationSolution, TOPIC, now_ns, live=True) is not None,
        "age_s": None if s is None else round(max(now_ns - s.sampled_ns, 0) * 1e-9, 3),
        "sampled_ns": s.sampled_ns if s else None,
        "latitude_deg": round(s.latitude_deg, 9) if s else None,
        "longitude_deg": round(s.longitude_deg, 9) if s else None,
        "height_ellipsoid_m": round(s.height_ellipsoid_m, 3) if s else None,
        "height_msl_m": sea.height_m if sea else None,
        "geoid": sea.geoid if sea else None,
        "geoid_sd_m": sea.geoid_sd_m if sea else None,
        "speed_m_s": round(hypot(*s.velocity_ned_m_s[:2]), 3) if s else None,
        "heading_deg": round(degrees(s.yaw_rad) % 360.0, 2) if s else None,
        "ellipse_95_semi_major_m": round(ellipse.semi_major_m, 3) if ellipse else None,
        "ellipse_95_semi_minor_m": round(ellipse.semi_minor_m, 3) if ellipse else None,
        "ellipse_95_orientation_deg": round(degrees(ellipse.orientation_rad) % 180.0, 2) if ellipse else None,
        "height_sd_m": round(vertical_sd(s.position_cov_ned_m2), 3) if s else None,
        "speed_sd_m_s": round(horizontal_sd(s.velocity_cov_ned_m2_s2), 3) if s else None,
        "heading_sd_deg": round(degrees(vertical_sd(s.attitude_cov_ned_rad2)), 2) if s else None,
        "protection_level_horizontal_m": rounded(s.protection_level_horizontal_m, 3) if s else None,
        "protection_level_vertical_m": rounded(s.protection_level_vertical_m, 3) if s else None,
        "alert_limit_horizontal_m": limits.alert_limit_horizontal_m,
        "alert_limit_vertical_m": limits.alert_limit_vertical_m,
        "gnss_age_s": rounded(s.gnss_age_s, 2) if s else None,
        "phase": s.phase if s else None,
        "stationary": s.stationary if s else None,
    }


def feature(state: State, now_ns: int) -> Feature:
    """Show the newest solution as a feature: a point with height in WGS 84, and the rest as properties."""
    shown = solution(state, now_ns)
    properties = cast("Properties", {name: value for name, value in shown.items() if name not in PLACE})
    longitude_deg, latitude_deg, height_m = shown["longitude_deg"], shown["latitude_deg"], shown["height_ellipsoid_m"]
    geometry: Point | None = None
    if longitude_deg is not None and latitude_deg is not None and height_m is not None:
        geometry = {"type": "Point", "coordinates": (longitude_deg, latitude_deg, height_m)}
    return {"type": "Feature", "geometry": geometry, "properties": properties}
