"""Formats a track as CSV and KML."""

from collections.abc import Iterator
from html import escape

import numpy as np

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


def kml_text(track: Track, name: str) -> str:
    """Format a track as a KML line of at most `KML_POINTS` points."""
    position = track.columns("latitude_deg")
    step = -(-len(position) // KML_POINTS) or 1
    chosen = position[np.r_[0 : len(position) : step, len(position) - 1]] if len(position) else position
    points = " ".join(f"{longitude:.8f},{latitude:.8f},{height:.2f}" for latitude, longitude, height in chosen.tolist())
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2">
<Document>
<name>{escape(name)}</name>
<Style id="track"><LineStyle><color>ffb05a00</color><width>3</width></LineStyle></Style>
<Placemark>
<name>Solution</name>
<styleUrl>#track</styleUrl>
<LineString><tessellate>1</tessellate><altitudeMode>clampToGround</altitudeMode>
<coordinates>{points}</coordinates></LineString>
</Placemark>
</Document>
</kml>
"""
