"""Formats a track as CSV, and thins it for KML."""

from collections.abc import Iterator

import numpy as np

from shared.track_files import TrackPoint

from ..track import NAMES, Track

HEADER = ("sampled_ns", "time_s", "phase", *NAMES)
# Rounding is below 1 mm, 0.1 mm/s and 1 microradian.
DECIMALS = {
    "latitude_deg": 9,
    "longitude_deg": 9,
    "height_ellipsoid_m": 4,
    "protection_level_horizontal_m": 4,
    "protection_level_vertical_m": 4,
    "stationary": 0,
    "gnss_age_s": 3,
}
KML_POINTS = 20_000


def csv_lines(track: Track) -> Iterator[str]:
    """Format a track as CSV, one line per solution; unknown values are empty."""
    yield ",".join(HEADER) + "\n"
    formats = [f"%.{DECIMALS.get(name, 7)}f" for name in NAMES]
    line = "%d,%.6f,%s," + ",".join(formats)
    first = int(track.stamps_ns[0]) if len(track) else 0
    for stamp, phase, row in zip(track.stamps_ns.tolist(), track.phases, track.values.tolist(), strict=True):
        text = line % (stamp, (stamp - first) * 1e-9, phase.value, *row)
        yield text.replace("nan", "") + "\n"


def kml_points(track: Track) -> list[TrackPoint]:
    """At most `KML_POINTS` points of a track and its last one."""
    position = track.columns("latitude_deg")
    step = -(-len(position) // KML_POINTS) or 1
    chosen: list[int] = np.unique(np.r_[0 : len(position) : step, len(position) - 1]).tolist() if len(position) else []
    return [TrackPoint(int(track.stamps_ns[k]), *position[k].tolist()) for k in chosen]
