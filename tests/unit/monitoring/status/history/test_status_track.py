from collections.abc import Mapping, Sized
from itertools import pairwise
from typing import cast

import pytest
from pydantic_core import to_json

from services.monitoring.status.history.track import (
    METRES_PER_DEGREE,
    Place,
    Track,
    TrackRow,
    columns,
    distance_m,
    length_m,
    segments,
)

NS = 1_000_000_000


def row(
    second: float, north_m: float | None = 0.0, *, state: str = "safe", aided: bool = True, gnss: bool = False
) -> TrackRow:
    place = None if north_m is None else Place(48.0 + north_m / METRES_PER_DEGREE, 11.0)
    fix = Place(48.0 + second / METRES_PER_DEGREE, 11.0) if gnss else None
    return TrackRow(int(second * NS), state, aided, place, fix, None, 500.0, 1.5, 3.0)


def drive(track: Track, seconds: range, speed_m_s: float = 10.0, **more: object) -> None:
    for second in seconds:
        track.add(row(second, second * speed_m_s, **more))  # type: ignore[arg-type]


def test_a_standing_vehicle_adds_one_row_and_a_change_of_verdict_another() -> None:
    track = Track()
    for second in range(100):
        track.add(row(second, 0.1, state="safe" if second < 50 else "caution"))
    assert [(r.time_ns // NS, r.state) for r in track.rows] == [(0, "safe"), (50, "caution")]


def test_nothing_is_kept_before_the_first_position() -> None:
    track = Track()
    track.add(row(0.0, None))
    assert track.rows == []


def test_the_rows_stay_within_their_bound_and_cover_the_whole_drive() -> None:
    track = Track(maximum=100)
    drive(track, range(5000))
    assert len(track.rows) <= 100 and track.generation > 0
    assert track.rows[0].time_ns == 0 and track.rows[-1].time_ns > 4900 * NS
    gaps = [distance_m(a.fused, b.fused) for a, b in pairwise(track.rows) if a.fused and b.fused]
    assert max(gaps) < 2.0 * track.spacing_m, "evenly spaced"
    assert length_m(track.rows) == pytest.approx(track.rows[-1].time_ns / NS * 10.0)


def test_thinning_keeps_every_change_of_verdict_and_every_gap() -> None:
    track = Track(maximum=100)
    drive(track, range(40))
    track.add(row(40, 400.0, state="unsafe"))
    track.add(row(41, None))
    drive(track, range(42, 400))
    states = [r.state for r in track.rows]
    assert track.generation > 0 and states.count("unsafe") == 1
    assert [r.fused is None for r in track.rows].count(True) == 1


def test_a_verdict_that_changes_with_every_row_cannot_exceed_the_bound() -> None:
    track = Track(maximum=100)
    for second in range(2000):
        track.add(row(second, 0.0, state="safe" if second % 2 else "caution"))
    assert len(track.rows) <= 100


def test_rows_after_a_time_are_those_that_a_reader_lacks() -> None:
    track = Track()
    drive(track, range(10))
    assert [r.time_ns // NS for r in track.after(7 * NS)] == [8, 9]
    assert track.after(9 * NS) == []
    assert len(track.after(-1)) == 10


def test_a_gap_splits_the_segments_of_its_source_only() -> None:
    rows = [row(0, 0.0, gnss=True), row(1, None, gnss=True), row(2, 20.0, aided=False, gnss=True)]
    fused = list(segments(rows, "fused"))
    assert [len(part) for part in fused] == [1, 1]
    assert fused[1][0].extras == {
        "trust": "safe", "gnss_used": 0, "radius_95_m": 1.5, "protection_level_horizontal_m": 3.0,
    }  # fmt: skip
    gnss = list(segments(rows, "gnss"))
    assert [len(part) for part in gnss] == [3]
    assert gnss[0][0].extras == {}, "what the solution says of itself is not said of GNSS alone"
    assert list(segments(rows, "truth")) == []


def test_the_columns_have_one_value_a_row_and_none_where_a_source_was_silent() -> None:
    table = columns([row(0, 0.0), row(1, None)])
    assert {len(values) for values in cast(Mapping[str, Sized], table).values()} == {2}
    assert table["fused_latitude_deg"] == [48.0, None]
    assert table["gnss_longitude_deg"] == [None, None]


def lines(rows: list[TrackRow]) -> list[bytes]:
    return [to_json(each._asdict()) for each in rows]


def test_a_later_life_continues_the_track_of_this_drive_after_a_gap() -> None:
    first = Track()
    drive(first, range(10))
    kept = lines(first.unsaved())
    assert first.unsaved() == [], "handed over once"
    second = Track()
    assert second.restore([*kept, b"no row", b"[1, 2]"], 60 * NS) == 2
    assert second.rows[:10] == first.rows
    second.add(row(61, 700.0))
    assert [len(part) for part in segments(second.rows, "fused")] == [10, 1], "no line across the restart"
    assert [r.time_ns // NS for r in second.unsaved()] == [61], "what is restored is not saved again"


def test_the_track_of_an_earlier_drive_is_not_taken_over() -> None:
    early, late = Track(), Track()
    drive(early, range(10))
    drive(late, range(8000, 8005))
    kept = [*lines(early.rows), *lines(late.rows)]
    found = Track()
    found.restore(kept, 8010 * NS)
    assert found.rows[:5] == late.rows
    found = Track()
    found.restore(kept, 20_000 * NS)
    assert found.rows == []


def test_a_replay_that_goes_back_adds_nothing_that_is_known() -> None:
    track = Track()
    drive(track, range(10))
    track.interrupt()
    drive(track, range(3, 8))
    assert [len(part) for part in segments(track.rows, "fused")] == [10]
    drive(track, range(50, 55))
    assert [len(part) for part in segments(track.rows, "fused")] == [10, 5]
