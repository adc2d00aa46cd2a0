import csv
import math

import pytest

from cli.import_drive.conversion.convert import Conversion, convert, wanted_columns
from cli.import_drive.mapping.mapping import parse_mapping
from cli.import_drive.readers.table import read_table
from shared.errors import UserError
from shared.messages.gnss import CarrierSolution, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import TruthState
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

STANDARD_GRAVITY = 9.80665


def converted(mapping: str, text: str) -> Conversion:
    spec = parse_mapping('name = "drive"\n' + mapping, "m.toml")
    table = next(spec.files())
    rows = csv.reader(text.strip().splitlines())
    return convert(table, read_table(rows, next(rows), wanted_columns(table), table.file), start_s=spec.start_utc_s)


IMU = """
[imu]
file = "imu.csv"
time = { column = "t" }
stamps_late_s = 0.25
latency_s = 0.5
specific_force = { columns = ["ax", "ay", "az"], unit = "g" }
angular_rate = { columns = ["gx", "gy", "gz"], unit = "deg/s" }
axes = ["forward", "left", "up"]
"""


def test_an_imu_row_is_converted_to_body_axes_and_si_units() -> None:
    (sample,) = converted("start_utc_s = 1000.0\n" + IMU, "t,ax,ay,az,gx,gy,gz\n2.0,0.5,0.25,1.0,10,20,30").messages
    assert isinstance(sample, ImuSamples)
    assert sample.specific_force_body_m_s2[0] == pytest.approx(
        (0.5 * STANDARD_GRAVITY, -0.25 * STANDARD_GRAVITY, -STANDARD_GRAVITY)
    )
    assert sample.angular_rate_body_rad_s[0] == pytest.approx([math.radians(a) for a in (10, -20, -30)])
    assert sample.sampled_ns == (1_001_750_000_000,), "the stamp is later than the truth by 0.25 s"
    assert sample.received_ns == 1_002_250_000_000


def test_samples_of_a_fast_imu_are_batched_to_10_ms() -> None:
    text = "t,ax,ay,az,gx,gy,gz\n" + "\n".join(f"{k * 0.0025:.4f},0,0,1,0,0,0" for k in range(10))
    messages = converted(IMU, text).messages
    assert [len(m.sampled_ns) for m in messages if isinstance(m, ImuSamples)] == [4, 4, 2]


def test_invalid_rows_are_omitted_and_counted_by_reason() -> None:
    rows = ["0,0,0,1,0,0,0", "1,0,0,nan,0,0,0", "2,0,0,x,0,0,0", "3,0", "4,0,inf,1,0,0,0", *["3.5,0,0,1,0,0,0"] * 2]
    found = converted(IMU, "\n".join(["t,ax,ay,az,gx,gy,gz", *rows]))
    assert found.rejects == {"not finite": 2, "not a number": 1, "too short": 1, "not later than the previous row": 1}
    assert found.rows == 7 and len(found.messages) == 2


def test_a_missing_column_is_named_with_a_suggestion() -> None:
    with pytest.raises(UserError, match=r"imu.csv has no column 'az'; did you mean 'a_z'\?"):
        converted(IMU, "t,ax,ay,a_z,gx,gy,gz\n0,0,0,1,0,0,0")


def test_a_file_without_a_row_of_numbers_is_an_error() -> None:
    with pytest.raises(UserError, match=r"row 1 \(line 1\), column 't': 'a' is not a number"):
        converted(IMU, "t,ax,ay,az,gx,gy,gz\na,b,c,d,e,f,g")


GNSS = """
[gnss]
file = "gnss.csv"
time = { column = "t", unit = "ms" }
latency_s = 0.1
latitude = { column = "lat", unit = "1e-7 deg" }
longitude = { column = "lon", unit = "1e-7 deg" }
height = { column = "h", unit = "mm", kind = "msl", geoid_separation_m = 40.0 }
velocity = { columns = ["ve", "vn", "vu"], unit = "km/h", axes = "enu" }
position_sd = { columns = ["sn", "se", "su"], axes = "neu" }
velocity_sd = { constant_ned = [0.1, 0.2, 0.3] }
quality = { column = "q", values = { 1 = "fixed", 2 = "float" } }
satellites_used = "ns"
"""
HEADER = "t,lat,lon,h,ve,vn,vu,sn,se,su,q,ns\n"


def test_a_gnss_row_is_converted_to_a_fix() -> None:
    (fix,) = converted(GNSS, HEADER + "1500,494000000,-27000000,250000,3.6,7.2,-1.8,0.01,0.02,0.03,1,17").messages
    assert isinstance(fix, GnssFix)
    assert (fix.sampled_ns, fix.received_ns) == (1_500_000_000, 1_600_000_000)
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((49.4, -2.7))
    assert (fix.height_ellipsoid_m, fix.height_msl_m) == pytest.approx((290.0, 250.0))
    assert fix.velocity_ned_m_s == pytest.approx((2.0, 1.0, 0.5))
    assert fix.position_sd_ned_m == pytest.approx((0.01, 0.02, 0.03))
    assert fix.velocity_sd_ned_m_s == pytest.approx((0.1, 0.2, 0.3))
    assert fix.carrier_solution is CarrierSolution.FIXED and fix.differential and fix.satellites_used == 17


def test_rows_of_an_unlisted_quality_are_omitted() -> None:
    row = ",494000000,-27000000,250000,0,0,0,0.01,0.02,0.03,"
    found = converted(GNSS, f"{HEADER}0{row}1,17\n1{row}2,17\n2{row}5,17")
    words = [m.carrier_solution for m in found.messages if isinstance(m, GnssFix)]
    assert words == [CarrierSolution.FIXED, CarrierSolution.FLOAT]
    assert found.rejects == {"quality not listed": 1}


def test_rows_with_an_invalid_position_are_omitted() -> None:
    row = ",-27000000,250000,0,0,0,0.01,0.02,0.03,1,17"
    found = converted(GNSS, f"{HEADER}0,494000000{row}\n1,944000000{row}")
    assert found.rejects == {"invalid position (latitude)": 1}


def test_longitudes_from_0_to_360_are_those_from_minus_180_to_180() -> None:
    columns = ",-27000000,250000,0,0,0,0.01,0.02,0.03,1,17"
    told = [0, 10, 179.9, 180, 180.1, 359.999, 360, -0.001, -180, 361, -181]
    rows = "\n".join(
        f"{k},494000000,{round(east * 1e7)}{columns.partition(',-27000000')[2]}" for k, east in enumerate(told)
    )
    found = converted(GNSS, f"{HEADER}{rows}")
    longitudes = [fix.longitude_deg for fix in found.messages if isinstance(fix, GnssFix)]
    assert longitudes == pytest.approx([0, 10, 179.9, 180, -179.9, -0.001, 0, -0.001, -180])
    assert found.rejects == {"invalid position (longitude)": 2}


REPEATED = """
[gnss]
file = "gnss.csv"
time = { period_s = 0.01 }
only_changes_of = ["lat", "lon"]
latitude = { column = "lat", unit = "deg" }
longitude = { column = "lon", unit = "deg" }
height = { column = "h", kind = "ellipsoid" }
"""


def test_rows_with_a_changed_position_are_epochs_with_the_time_of_their_row() -> None:
    found = converted(REPEATED, "lat,lon,h\n1,1,5\n1,1,5\n1,2,5\n1,2,6\n2,2,6\n2,2,6")
    assert [m.sampled_ns for m in found.messages if isinstance(m, GnssFix)] == [20_000_000, 40_000_000]
    assert found.rejects == {"unchanged": 4}


ARRIVAL = """
[gnss]
file = "gnss.csv"
time = { column = "tow", arrival_column = "t", least_latency_s = 0.05 }
latitude = { column = "lat", unit = "deg" }
longitude = { column = "lon", unit = "deg" }
height = { column = "h", kind = "ellipsoid" }
"""


def test_the_device_clock_is_mapped_to_the_arrival_clock_by_the_row_of_least_latency() -> None:
    found = converted(ARRIVAL, "tow,t,lat,lon,h\n100.0,7.4,1,1,5\n100.1,7.45,1,1,5\n100.2,7.5,1,1,5\n100.3,7.7,1,1,5")
    fixes = [m for m in found.messages if isinstance(m, GnssFix)]
    assert [fix.sampled_ns for fix in fixes] == [7_250_000_000, 7_350_000_000, 7_450_000_000, 7_550_000_000]
    assert [fix.received_ns for fix in fixes] == [7_400_000_000, 7_450_000_000, 7_500_000_000, 7_700_000_000]


def test_wheel_and_vehicle_speeds_are_converted_to_metres_per_second() -> None:
    wheels = '[wheels]\nfile = "w.csv"\ntime = { column = "t" }\nunit = "km/h"\nfront_left = "fl"\nrear_right = "rr"\n'
    (found,) = converted(wheels, "t,fl,rr\n0,36,18").messages
    assert isinstance(found, WheelSpeeds)
    assert found.front_left_m_s == pytest.approx(10.0)
    assert found.front_right_m_s is None
    assert found.rear_right_m_s == pytest.approx(5.0)
    speed = '[speed]\nfile = "s.csv"\ntime = { column = "t" }\ncolumn = "v"\nunit = "km/h"\nresolution_m_s = 0.278\n'
    (single,) = converted(speed, "t,v\n0,72").messages
    assert isinstance(single, VehicleSpeed) and single.speed_m_s == pytest.approx(20.0)


def test_a_reference_with_ecef_position_and_body_velocity_is_converted_to_a_true_state() -> None:
    imu = IMU.replace('"imu.csv"', '"none.csv"')
    truth = """
    [truth]
    file = "truth.csv"
    time = { column = "t" }
    position_ecef = { columns = ["x", "y", "z"] }
    velocity = { columns = ["vf", "vr", "vd"], unit = "m/s", axes = "body" }
    attitude = { columns = ["roll", "pitch", "yaw"], unit = "deg" }
    angular_rate = { columns = ["wx", "wy", "wz"], unit = "rad/s" }
    """
    spec = parse_mapping('name = "drive"\n' + imu + truth, "m.toml")
    assert spec.truth is not None
    text = "t,x,y,z,vf,vr,vd,roll,pitch,yaw,wx,wy,wz\n0,6378137.0,0,0,3,0,0,0,0,90,0,0,0.1"
    rows = csv.reader(text.splitlines())
    table = read_table(rows, next(rows), wanted_columns(spec.truth), "truth.csv")
    (state,) = convert(spec.truth, table).messages
    assert isinstance(state, TruthState)
    assert (state.latitude_deg, state.longitude_deg, state.height_ellipsoid_m) == pytest.approx(
        (0.0, 0.0, 0.0), abs=1e-6
    )
    assert state.velocity_ned_m_s == pytest.approx((0.0, 3.0, 0.0), abs=1e-12), (
        "forward is east at a heading of 90 degrees"
    )
    assert state.yaw_rad == pytest.approx(math.pi / 2)


INCREMENTS = """
[imu]
file = "imu.txt"
time = { column = "t" }
specific_force = { columns = ["x", "y", "z"], unit = "m/s" }
angular_rate = { columns = ["gx", "gy", "gz"], unit = "deg" }
axes = ["forward", "right", "down"]
"""


def test_increments_are_divided_by_the_sample_interval() -> None:
    # 100 Hz; one sample is lost between 0.02 and 0.04 s; the next one is a mean over 10 ms as well.
    rows = "\n".join(f"{t},0.02,0,-0.0981,0,0,0.05" for t in ("0.00", "0.01", "0.02", "0.04", "0.05"))
    messages = converted(INCREMENTS, "t,x,y,z,gx,gy,gz\n" + rows).messages
    forces = [force for m in messages if isinstance(m, ImuSamples) for force in m.specific_force_body_m_s2]
    rates = [rate for m in messages if isinstance(m, ImuSamples) for rate in m.angular_rate_body_rad_s]
    assert forces == [pytest.approx((2.0, 0.0, -9.81))] * 5
    assert rates == [pytest.approx((0.0, 0.0, math.radians(5.0)))] * 5


def test_a_mean_times_its_stamp_interval_is_the_increment() -> None:
    stamps = (0.0, 0.0051, 0.0099, 0.0150)
    rows = "\n".join(f"{t},0,0,{-9.81 * 0.005},0,0,{0.01 * k}" for k, t in enumerate(stamps))
    messages = converted(INCREMENTS, "t,x,y,z,gx,gy,gz\n" + rows).messages
    times = [stamp * 1e-9 for m in messages if isinstance(m, ImuSamples) for stamp in m.sampled_ns]
    rates = [rate[2] for m in messages if isinstance(m, ImuSamples) for rate in m.angular_rate_body_rad_s]
    turned = [rate * (last - first) for rate, first, last in zip(rates[1:], times, times[1:], strict=False)]
    assert turned == pytest.approx([math.radians(0.01 * k) for k in (1, 2, 3)], rel=1e-12)


def test_a_unit_inconsistent_with_gravity_is_rejected() -> None:
    wrong = INCREMENTS.replace('"m/s"', '"m/s2"')
    with pytest.raises(UserError, match=r"specific force of 0\.0981 m/s2 .* check the unit 'm/s2' .* increments: m/s"):
        converted(wrong, "t,x,y,z,gx,gy,gz\n0,0,0,-0.0981,0,0,0\n0.01,0,0,-0.0981,0,0,0")


def test_an_opposite_specific_force_is_negated() -> None:
    up = IMU.replace('unit = "g"', 'unit = "g", opposite = true')
    (sample,) = converted(up, "t,ax,ay,az,gx,gy,gz\n0,0.2,0,-1,0,0,5").messages
    assert isinstance(sample, ImuSamples)
    assert sample.specific_force_body_m_s2[0] == pytest.approx((-0.2 * STANDARD_GRAVITY, 0.0, -STANDARD_GRAVITY))
    assert sample.angular_rate_body_rad_s[0][2] == pytest.approx(-math.radians(5.0)), "rates stay as they are"


def test_ground_speed_and_course_are_accepted_instead_of_a_velocity() -> None:
    mapping = (
        REPEATED
        + """
ground_speed = { column = "v", unit = "km/h" }
course = { column = "c", unit = "deg" }
hdop = "hd"
vdop = "vd"
"""
    )
    (fix,) = converted(mapping, "lat,lon,h,v,c,hd,vd\n49,6,0,0,0,1,2\n49.1,6,0,36,90,1.5,2.5").messages
    assert isinstance(fix, GnssFix)
    assert fix.velocity_ned_m_s is None and fix.ground_speed_m_s == pytest.approx(10.0)
    assert fix.course_rad == pytest.approx(math.pi / 2) and (fix.hdop, fix.vdop) == (1.5, 2.5)
    with pytest.raises(UserError, match="`course` must be given together"):
        converted(mapping.replace('course = { column = "c", unit = "deg" }', ""), "lat,lon,h,v\n49,6,0,36")


MADE = """
[speed]
file = "reference.csv"
time = { column = "t" }
made_from = { columns = ["vn", "ve", "vd"], unit = "m/s", axes = "ned" }
noise_sd_m_s = 0.1
"""


def test_a_speed_computed_from_a_reference_is_reported_as_computed() -> None:
    text = "t,vn,ve,vd\n" + "\n".join(f"{0.05 * k:.2f},3,4,0" for k in range(2000))
    found = [m.speed_m_s for m in converted(MADE, text).messages if isinstance(m, VehicleSpeed)]
    assert found == [m.speed_m_s for m in converted(MADE, text).messages if isinstance(m, VehicleSpeed)]
    mean = sum(found) / len(found)
    sd = math.sqrt(sum((v - mean) ** 2 for v in found) / len(found))
    # Of 2000 values the mean is known to 0.1/sqrt(2000) and the deviation to 0.1/sqrt(4000); four times that.
    assert mean == pytest.approx(5.0, abs=0.009) and sd == pytest.approx(0.1, abs=0.0064)
    (sentence,) = parse_mapping('name = "drive"\n' + MADE, "m.toml").made()
    assert sentence.startswith("The speed is not measured: it is that of the reference in reference.csv")


def test_a_speed_is_either_measured_or_computed() -> None:
    with pytest.raises(UserError, match="either a `column` or `made_from`"):
        converted(MADE + 'column = "v"\n', "t,v\n0,1")
    with pytest.raises(UserError, match="a measured speed has its own noise"):
        converted('[speed]\nfile = "s.csv"\ntime = { column = "t" }\ncolumn = "v"\nnoise_sd_m_s = 0.1', "t,v\n0,1")


def test_only_changes_of_applies_to_every_table() -> None:
    spec = '[speed]\nfile = "s.csv"\ntime = { column = "t" }\ncolumn = "v"\nonly_changes_of = ["v"]'
    found = converted(spec, "t,v\n0,1\n1,1\n2,2\n3,2\n4,3")
    assert [m.speed_m_s for m in found.messages if isinstance(m, VehicleSpeed)] == [2.0, 3.0]
    assert found.rejects == {"unchanged": 3}


def test_a_wheel_rotation_rate_is_converted_to_a_speed() -> None:
    spec = """[speed]
file = "w.csv"
time = { column = "t" }
column = "w"
unit = "deg/s"
wheel_radius_m = 0.3
opposite = true
"""
    (message,) = converted(spec, "t,w\n0,-180").messages
    assert isinstance(message, VehicleSpeed) and message.speed_m_s == pytest.approx(0.3 * math.pi)


def test_a_date_after_2100_costs_its_row_and_not_those_behind_it() -> None:
    rows = "t,ax,ay,az,gx,gy,gz\n1.0,0,0,1,0,0,0\n1e300,0,0,1,0,0,0\n5e9,0,0,1,0,0,0\n2.0,0,0,1,0,0,0"
    found = converted("start_utc_s = 1700000000.0\n" + IMU, rows)
    stamps = [stamp for message in found.messages if isinstance(message, ImuSamples) for stamp in message.sampled_ns]
    assert [stamp // 10**9 for stamp in stamps] == [1_700_000_000, 1_700_000_001], "of 1 and 2 s, told 0.25 s late"
    assert found.rejects["date after 2100"] == 2
