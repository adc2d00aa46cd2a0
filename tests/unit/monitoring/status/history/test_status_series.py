"""Series of numeric fields: names, units, the time grid, and its bounds."""

import re
from pathlib import Path

import pytest

from services.monitoring.status.page import DASHBOARD
from services.monitoring.status.series import fields, past, rings, store
from services.monitoring.status.series.store import Series, SeriesFull
from shared.messages.gnss import CarrierDisplacement, Constellation, FixType, GnssFix, GnssSatellites, Satellite
from shared.messages.navigation import AidingKind, AidingUpdate, TruthState
from tests.support.cases import each
from tests.support.dashboard.status_world import solution

NS = 1_000_000_000
NOW_NS = 1_795_000_000 * NS


def fix(time_ns: int, hdop: float) -> GnssFix:
    return GnssFix(sampled_ns=time_ns, received_ns=time_ns, source="gnss0", fix_type=FixType.THREE_D, hdop=hdop)


def aiding(kind: AidingKind, ratio: float) -> AidingUpdate:
    return AidingUpdate(sampled_ns=NOW_NS, source="gnss0", kind=kind, innovation=(0.5,), innovation_sd=(1.0,),
                        test_ratio=ratio, used=True)  # fmt: skip


def test_a_ring_holds_the_newest_value_of_each_period_and_forgets_what_is_older_than_its_span() -> None:
    ring = rings.Ring(NS, 10)
    for second in range(25):
        ring.put(second * NS, second)
        ring.put(second * NS + NS // 2, second + 0.5)
    assert ring.values(13, 26) == [None, None, *(n + 0.5 for n in range(15, 25)), None, None]


def test_a_pause_longer_than_the_ring_leaves_nothing_of_before() -> None:
    ring = rings.Ring(NS, 10)
    ring.put(3 * NS, 3.0)
    ring.put(1000 * NS, 1.0)
    assert ring.values(990, 1000) == [None] * 10 + [1.0]
    assert ring.values(3, 3) == [None]


def test_a_late_value_goes_to_its_own_period_and_filling_overwrites_nothing() -> None:
    ring = rings.Ring(NS, 10)
    ring.put(9 * NS, 9.0)
    ring.put(7 * NS, 7.0)
    ring.put(7 * NS, 70.0, fill=True)
    ring.put(8 * NS, 8.0, fill=True)
    ring.put(-5 * NS, 1.0)
    assert ring.values(6, 9) == [None, 7.0, 8.0, 9.0]


@each(
    ("name", "unit", "axis"),
    [
        ("gnss/fix:velocity_ned_m_s.1", "m/s", "east"),
        ("gnss/fix:hdop", "", ""),
        ("navigation/solution:accelerometer_bias_m_s2.2", "m/s²", "down"),
        ("navigation/solution:position_cov_ned_m2.3", "m²", ""),
        ("gnss/raw_epoch:measurements.gps12-1C.carrier_phase_cycles", "cycles", ""),
        ("gnss/satellites:satellites.galileo3.cn0_db_hz", "dBHz", ""),
        ("navigation/aiding[gnss_velocity]:innovation.0", "m/s", ""),
        ("computed:error_horizontal_m", "m", ""),
        ("imu/sample:@latency_s", "s", ""),
    ],
)
def test_units_follow_from_the_name_or_the_schema_of_a_field(name: str, unit: str, axis: str) -> None:
    field = fields.parse(name)
    assert (fields.unit_of(field), fields.axis_of(field)) == (unit, axis)


@pytest.mark.parametrize("name", ["", "hdop", "no/topic:x", "gnss/fix:", "gnss/fix:a,b", "gnss/fix[a:b]:x", "x" * 300])
def test_what_cannot_be_a_field_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"field|topic"):
        fields.parse(name)


def test_each_listed_number_is_found_again_at_its_path() -> None:
    sky = GnssSatellites(
        sampled_ns=NOW_NS, received_ns=NOW_NS, source="gnss0",
        satellites=tuple(
            Satellite(constellation=Constellation.GPS, number=n, cn0_db_hz=40.0 + n, used=True) for n in (3, 12)
        ),
    )  # fmt: skip
    for message in (sky, aiding(AidingKind.ODOMETER, 0.3), solution(NOW_NS)):
        listed = dict(fields.numbers(message))
        assert listed
        assert listed == {path: fields.value_at(message, tuple(path.split("."))) for path in listed}
    assert dict(fields.numbers(sky))["satellites.gps12.cn0_db_hz"] == 52.0


def test_a_selector_separates_what_shares_a_topic() -> None:
    series = Series(())
    names = ["navigation/aiding[odometer]:test_ratio", "navigation/aiding[gnss_position]:test_ratio"]
    series.want(names, NOW_NS)
    series.take("navigation/aiding", aiding(AidingKind.ODOMETER, 0.3), NOW_NS)
    series.take("navigation/aiding", aiding(AidingKind.GNSS_POSITION, 0.7), NOW_NS)
    columns = series.columns(names, NOW_NS, NOW_NS, fine=False)
    assert columns["values"] == {names[0]: [0.3], names[1]: [0.7]}


def test_errors_against_the_truth_are_computed_at_the_moment_of_the_solution() -> None:
    series = Series()
    solved = solution(NOW_NS)
    truth = TruthState(
        sampled_ns=solved.sampled_ns - NS // 2, latitude_deg=solved.latitude_deg, longitude_deg=solved.longitude_deg,
        height_ellipsoid_m=solved.height_ellipsoid_m + 2.0, velocity_ned_m_s=(3.0, 4.0, 1.0), roll_rad=0.0,
        pitch_rad=0.0, yaw_rad=0.0,
    )  # fmt: skip
    series.take("truth/state", truth, solved.sampled_ns)
    series.take("navigation/solution", solved, solved.sampled_ns)
    names = ["computed:error_horizontal_m", "computed:error_vertical_m"]
    values = series.columns(names, solved.sampled_ns, solved.sampled_ns, fine=False)["values"]
    assert isinstance(values, dict)
    assert values[names[0]] == [pytest.approx(2.5, rel=1e-6)]  # half a second at 5 m/s
    assert values[names[1]] == [pytest.approx(1.5, rel=1e-6)]  # 2 m above, less half a second of falling


def test_the_speed_by_carrier_phases_is_the_displacement_over_its_time() -> None:
    series = Series()
    message = CarrierDisplacement(
        sampled_ns=NOW_NS, received_ns=NOW_NS, source="gnss0", since_ns=NOW_NS - NS // 5,
        displacement_ned_m=(0.6, -0.8, 0.1), displacement_cov_ned_m2=(1e-5, 0.0, 0.0, 1e-5, 0.0, 1e-5),
        slow_cov_ned_m2=(1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), satellites_used=9, redundancy=5, checked=True,
    )  # fmt: skip
    series.take("gnss/carrier_displacement", message, NOW_NS)
    name = "computed:speed_carrier_m_s"
    assert series.columns([name], NOW_NS, NOW_NS, fine=False)["values"] == {name: [pytest.approx(5.0)]}


def test_the_number_of_fields_and_their_memory_are_bounded_and_a_refusal_is_counted() -> None:
    series = Series()
    room = store.FIELDS_MAXIMUM - len(series)
    names = [f"gnss/satellites:satellites.gps{n}.cn0_db_hz" for n in range(room)]
    series.want(names, NOW_NS)
    assert series.bytes <= store.BYTES_MAXIMUM <= 6_000_000
    with pytest.raises(SeriesFull, match="close charts"):
        series.want(["gnss/fix:vdop", "gnss/fix:velocity_ned_m_s.0"], NOW_NS + NS)
    assert series.refused == 1
    assert len(series) == store.FIELDS_MAXIMUM
    series.want(names[1:], NOW_NS + 3000 * NS)
    series.want(["gnss/fix:velocity_ned_m_s.0"], NOW_NS + 4000 * NS)
    assert len(series) == store.FIELDS_MAXIMUM
    with pytest.raises(KeyError):
        series.columns(names[:1], NOW_NS, NOW_NS, fine=False)
    series.columns(store.STANDARD, NOW_NS, NOW_NS, fine=False)


def test_a_stamp_of_another_time_line_does_not_move_the_ring() -> None:
    series = Series()
    series.take("gnss/fix", fix(NOW_NS, 0.8), NOW_NS)
    series.take("gnss/fix", fix(NOW_NS + 86_400 * NS, 0.9), NOW_NS + NS)
    values = series.columns(["gnss/fix:hdop"], NOW_NS, NOW_NS + NS, fine=False)["values"]
    assert values == {"gnss/fix:hdop": [0.8, 0.9]}


def test_the_page_draws_only_fields_that_are_kept_from_the_start() -> None:
    text = (DASHBOARD / "charts" / "charts.js").read_text()
    listed = set(re.findall(r'"((?:computed|[a-z_]+/[a-z_]+):[a-z0-9_.]+)"', text))
    [latencies] = re.findall(r"const LATENCIES = \[(.*?)\];", text)
    # Aids and constellations of the page are those of its words, which another test holds to these enums.
    listed |= {f"navigation/aiding[{kind}]:test_ratio" for kind in AidingKind}
    listed |= {f"computed:cn0_{name}_db_hz" for name in Constellation if name is not Constellation.UNKNOWN}
    listed |= {f"{topic}:@latency_s" for topic in re.findall(r'"([a-z_/]+)"', latencies)}
    listed = {f"{name}.0" if name.endswith(("bias_m_s2", "bias_rad_s")) else name for name in listed}
    assert len(listed) > 30
    assert listed <= set(store.STANDARD)


def test_a_reader_that_ends_within_a_line_is_an_error_that_its_caller_expects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = '{"name": "a", "values": [1.0, null]}\n{"name": "b", "values": [1.0,'
    (tmp_path / "reader.py").write_text(f"import sys\nsys.stdin.read()\nsys.stdout.write({lines!r})")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(past, "READER", "reader")
    found = past.fill_from_recordings(["a", "b"], tmp_path, NOW_NS)
    assert next(found) == ("a", [1.0, None])
    with pytest.raises(OSError, match="was ended"):
        next(found)
