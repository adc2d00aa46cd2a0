"""Formats a track as GPX 1.1 and as timed KML (gx:Track), line by line; a break in the track begins a new segment.

Heights are above mean sea level, as GPX and KML mean them, by the coarse grid of `maths.geoid`, corrected to the
receiver's geoid where that is given; those above the ellipsoid are in GPX beside them.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from itertools import pairwise

from .maths.geoid.geoid import ERROR_95_M, separation_m

Extra = float | int | str | None
DATUM = f"Heights are above mean sea level, by a coarse grid of EGM96: {ERROR_95_M} m (95 %) worse than the position."
RECEIVER_DATUM = "Heights are above mean sea level, by the geoid of the receiver."
HALF_TURN_DEG = 180.0
EXTENSIONS = "urn:obu:track"  # namespace of the extra fields in GPX


@dataclass(frozen=True)
class TrackPoint:
    """One position; `extras` are further fields by name, None where a value is unknown."""

    time_ns: int  # [ns] UTC since 1970
    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float | None = None
    extras: Mapping[str, Extra] = field(default_factory=dict)


Segment = Sequence[TrackPoint]


def crosses_antimeridian(before_deg: float, longitude_deg: float) -> bool:
    """Whether the short way between two longitudes crosses 180 degrees: a line would be drawn around the world."""
    return abs(longitude_deg - before_deg) > HALF_TURN_DEG


def cut_at_antimeridian(points: Segment) -> list[Segment]:
    """Cut a segment where it crosses 180 degrees."""
    cuts = [k for k, (a, b) in enumerate(pairwise(points), 1) if crosses_antimeridian(a.longitude_deg, b.longitude_deg)]
    return [points[begin:end] for begin, end in pairwise((0, *cuts, len(points)))]


def gpx_lines(name: str, segments: Iterable[Segment], geoid_correction_m: float | None = None) -> Iterator[str]:
    """Format segments as one GPX track.

    Parameters
    ----------
    name : str
        Of the track.
    segments : iterable of sequences of TrackPoint
        Unbroken parts.
    geoid_correction_m : float, optional
        [m] Geoid of the receiver above that of the grid; without it, heights are by the grid.

    References
    ----------
    GPX 1.1 Schema Documentation, https://www.topografix.com/GPX/1/1/
    """
    yield '<?xml version="1.0" encoding="UTF-8"?>\n'
    yield f'<gpx version="1.1" creator="obu" xmlns="http://www.topografix.com/GPX/1/1" xmlns:obu="{EXTENSIONS}">\n'
    yield f"<trk><name>{escape(name)}</name><desc>{_datum(geoid_correction_m)}</desc>\n"
    for segment in segments:
        yield "<trkseg>\n"
        yield from (_gpx_point(point, geoid_correction_m) for point in segment)
        yield "</trkseg>\n"
    yield "</trk>\n</gpx>\n"


def kml_lines(name: str, segments: Iterable[Segment], geoid_correction_m: float | None = None) -> Iterator[str]:
    """Format segments as one KML placemark with a time for each point; parameters as of `gpx_lines`.

    References
    ----------
    OGC 12-007r2, KML 2.3, section 11.3 (Track and MultiTrack), in the form of Google's extension namespace.
    """
    yield '<?xml version="1.0" encoding="UTF-8"?>\n'
    yield '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">\n'
    yield f"<Document><name>{escape(name)}</name><description>{_datum(geoid_correction_m)}</description>\n"
    yield '<Style id="track"><LineStyle><color>ffb27200</color><width>3</width></LineStyle></Style>\n'
    yield f"<Placemark><name>{escape(name)}</name><styleUrl>#track</styleUrl><gx:MultiTrack>\n"
    for segment in segments:
        yield from _kml_track(segment, geoid_correction_m)
    yield "</gx:MultiTrack></Placemark>\n</Document>\n</kml>\n"


def iso_time(time_ns: int) -> str:
    """Write a time as ISO 8601 in UTC, to the millisecond."""
    return datetime.fromtimestamp(time_ns // 1_000_000 / 1000, UTC).isoformat(timespec="milliseconds")[:-6] + "Z"


def _datum(geoid_correction_m: float | None) -> str:
    return DATUM if geoid_correction_m is None else RECEIVER_DATUM


def _above_sea_m(point: TrackPoint, geoid_correction_m: float | None) -> float | None:
    if point.height_ellipsoid_m is None:
        return None
    separation = separation_m(point.latitude_deg, point.longitude_deg) + (geoid_correction_m or 0.0)
    return point.height_ellipsoid_m - separation


def _gpx_point(point: TrackPoint, geoid_correction_m: float | None) -> str:
    above_sea_m = _above_sea_m(point, geoid_correction_m)
    height = "" if above_sea_m is None else f"<ele>{above_sea_m:.3f}</ele>"
    more = {"height_ellipsoid_m": point.height_ellipsoid_m, **point.extras}
    extras = "".join(f"<obu:{k}>{_text(v)}</obu:{k}>" for k, v in more.items() if v is not None)
    extensions = f"<extensions>{extras}</extensions>" if extras else ""
    return (
        f'<trkpt lat="{point.latitude_deg:.9f}" lon="{point.longitude_deg:.9f}">'
        f"{height}<time>{iso_time(point.time_ns)}</time>{extensions}</trkpt>\n"
    )


def _kml_track(segment: Segment, geoid_correction_m: float | None) -> Iterator[str]:
    """Format one track: all times, then all places, then one array for each extra field."""
    yield "<gx:Track><altitudeMode>clampToGround</altitudeMode>\n"
    for point in segment:
        yield f"<when>{iso_time(point.time_ns)}</when>\n"
    for point in segment:
        above_sea_m = _above_sea_m(point, geoid_correction_m)
        height = "" if above_sea_m is None else f" {above_sea_m:.3f}"
        yield f"<gx:coord>{point.longitude_deg:.9f} {point.latitude_deg:.9f}{height}</gx:coord>\n"
    names = dict.fromkeys(name for point in segment for name in point.extras)
    if names:
        yield "<ExtendedData><SchemaData>\n"
        for name in names:
            values = "".join(f"<gx:value>{_text(point.extras.get(name))}</gx:value>" for point in segment)
            yield f'<gx:SimpleArrayData name="{escape(name)}">{values}</gx:SimpleArrayData>\n'
        yield "</SchemaData></ExtendedData>\n"
    yield "</gx:Track>\n"


def _text(value: Extra) -> str:
    return "" if value is None else escape(f"{value:.6g}" if isinstance(value, float) else str(value))
