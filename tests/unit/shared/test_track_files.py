"""GPX and KML of a track, read back with an XML parser."""

import xml.etree.ElementTree as ET

from shared.maths.geoid.geoid import separation_m
from shared.track_files import TrackPoint, gpx_lines, iso_time, kml_lines

START_NS = 1_790_000_000_250_999_999
GPX = {"g": "http://www.topografix.com/GPX/1/1", "o": "urn:obu:track"}
KML = {"k": "http://www.opengis.net/kml/2.2", "x": "http://www.google.com/kml/ext/2.2"}
FIRST = [
    TrackPoint(START_NS + i * 10**9, 42.37 + i * 1e-5, 13.35, 700.0 + i, {"trust": "safe", "level_m": 3.25})
    for i in range(3)
]
SECOND = [TrackPoint(START_NS + 60 * 10**9, 42.371, -13.36, None, {"trust": "a<b&c", "level_m": None})]


def test_a_gpx_file_has_one_segment_for_each_unbroken_part_with_times_heights_and_extras() -> None:
    root = ET.fromstring("".join(gpx_lines("a & b", [FIRST, SECOND])))
    assert root.findtext("g:trk/g:name", namespaces=GPX) == "a & b"
    segments = root.findall("g:trk/g:trkseg", GPX)
    assert [len(segment) for segment in segments] == [3, 1]
    point = segments[0][1]
    assert (point.get("lat"), point.get("lon")) == ("42.370010000", "13.350000000")
    assert [child.tag.split("}")[1] for child in point] == ["ele", "time", "extensions"], "the order of the schema"
    above_sea_m = 701.0 - separation_m(42.37001, 13.35)
    assert point.findtext("g:ele", namespaces=GPX) == f"{above_sea_m:.3f}", "as GPX means heights"
    assert point.findtext("g:extensions/o:height_ellipsoid_m", namespaces=GPX) == "701"
    assert point.findtext("g:extensions/o:level_m", namespaces=GPX) == "3.25"
    last = segments[1][0]
    assert last.find("g:ele", GPX) is None and last.find("g:extensions/o:level_m", GPX) is None
    assert last.findtext("g:extensions/o:trust", namespaces=GPX) == "a<b&c"


def test_a_kml_file_has_as_many_times_as_places_and_as_values_of_each_field() -> None:
    root = ET.fromstring("".join(kml_lines("a & b", [FIRST, SECOND])))
    tracks = root.findall(".//x:MultiTrack/x:Track", KML)
    assert [len(t.findall("k:when", KML)) for t in tracks] == [3, 1]
    assert [len(t.findall("x:coord", KML)) for t in tracks] == [3, 1]
    assert tracks[0].findtext("x:coord", namespaces=KML) == (
        f"13.350000000 42.370000000 {700.0 - separation_m(42.37, 13.35):.3f}"
    )
    arrays = {a.get("name"): [v.text for v in a] for a in tracks[0].findall(".//x:SimpleArrayData", KML)}
    assert arrays == {"trust": ["safe"] * 3, "level_m": ["3.25"] * 3}
    empty = tracks[1].findall(".//x:SimpleArrayData[@name='level_m']/x:value", KML)
    assert [value.text for value in empty] == [None]


def test_a_time_is_cut_to_the_millisecond_and_never_rounded_up() -> None:
    assert iso_time(START_NS) == "2026-09-21T14:13:20.250Z"
    assert iso_time(1_790_000_000 * 10**9) == "2026-09-21T14:13:20.000Z"


def test_heights_are_by_the_receivers_geoid_where_it_is_known() -> None:
    above_m = f"{700.0 - separation_m(42.37, 13.35) - 1.25:.3f}"
    for lines, height in ((gpx_lines, f"<ele>{above_m}</ele>"), (kml_lines, f" {above_m}</gx:coord>")):
        text = "".join(lines("a", [FIRST], 1.25))
        assert height in text and "by the geoid of the receiver" in text
        assert "coarse grid" in "".join(lines("a", [FIRST]))
