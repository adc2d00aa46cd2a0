"""What is measured: drives, the runs over each, and the rows of the table with their goals and peers.

Numbers in the column of the peers were published or measured by others, on the same data by the same protocol where
nothing else is said; none of them comes from the run that prints the table.
"""

from dataclasses import dataclass
from itertools import product

PHASES = (650, 710, 770)  # [s] three outages of 60 s of every 180 s, shifted by 60 s: no stretch is left out
SETTLING_TIME_S = 350.0  # 50 s of standstill before the protocol's start, and the 300 s after it that are not judged


@dataclass(frozen=True)
class Drive:
    """A recording: mapping, and folder below that of all recordings."""

    mapping: str
    folder: str


DRIVES = {
    "rtk": Drive("rtk_drive_57min", "rtk_drive_57min/mems_rtk_200hz"),
    "spp": Drive("rtk_drive_57min", "rtk_drive_57min/mems_spp_100hz"),
    "navmatlab": Drive("navmatlab_car", "navmatlab_car"),
    "navmatlab 0327": Drive("navmatlab_car_0327", "navmatlab_car_0327"),
    "navmatlab 0327 rtk": Drive("navmatlab_car_0327_rtk", "navmatlab_car_0327"),
    "comma": Drive("comma_segment", "comma_segment"),
    "rtkexp": Drive("rtkexp_drive", "rtkexp_drive"),
    **{f"wid{trial}": Drive("wid_car", f"wid_car/trial{trial}") for trial in ("02", "08", "10")},
    "truck": Drive("auburn_truck", "auburn_truck/turn"),
    "balzer": Drive("balzer82_car", "balzer82_car"),
}


@dataclass(frozen=True)
class Case:
    """A drive solved in one way: one run, or one an outage pattern, whose outages are then judged together."""

    drive: str
    aiding: str | None = None
    outages: tuple[str, ...] = ()
    most: int | None = None  # outages of each run that count, where a protocol says how many
    score_from: float = 0.0


def _shifted(pattern: str, *first: int) -> tuple[str, ...]:
    return tuple(f"{pattern}@{start}" for start in first)


CASES: dict[str, Case] = {
    **{
        f"{drive} {aiding}": Case(drive, aiding, score_from=SETTLING_TIME_S)
        for drive, aiding in product(("rtk", "spp"), ("free", "odometer"))
    },
    **{
        f"{drive} {aiding} 60 s": Case(drive, aiding, _shifted("60/180", *PHASES), most=15)
        for drive, aiding in product(("rtk", "spp"), ("free", "odometer"))
    },
    "navmatlab": Case("navmatlab", "nhc"),
    **{
        f"navmatlab {aiding} 60 s": Case("navmatlab", aiding, _shifted("60/180", 240, 300, 360))
        for aiding in ("free", "nhc", "odometer")
    },
    "navmatlab 0327": Case("navmatlab 0327"),
    "navmatlab 0327 rtk": Case("navmatlab 0327 rtk"),
    "comma": Case("comma"),
    "comma wheel 10 s": Case("comma", "odometer", ("10/20",)),
    "rtkexp": Case("rtkexp"),
    **{f"rtkexp {aiding} 15 s": Case("rtkexp", aiding, _shifted("15/45", 60, 75, 90)) for aiding in ("free", "nhc")},
    "rtkexp nhc 15 s, one run": Case("rtkexp", "nhc", ("15/45",)),
    "rtkexp nhc 10 s": Case("rtkexp", "nhc", ("10/30",)),
    **{f"wid{trial}": Case(f"wid{trial}") for trial in ("02", "08", "10")},
    **{f"wid{trial} nhc 10 s": Case(f"wid{trial}", "nhc", ("10/30",)) for trial in ("02", "08", "10")},
    **{f"wid{trial} wheel 10 s": Case(f"wid{trial}", "odometer", ("10/30",)) for trial in ("02", "08")},
    **{f"wid{trial} nhc 60 s": Case(f"wid{trial}", "nhc", ("60/1000@60",)) for trial in ("02", "08", "10")},
    **{f"wid{trial} wheel 60 s": Case(f"wid{trial}", "odometer", ("60/1000@60",)) for trial in ("02", "08")},
    "truck": Case("truck"),
    "balzer": Case("balzer"),
}


H, V = "horizontal_rmse_m", "vertical_rmse_m"
YAW, VELOCITY = "yaw_rmse_rad", "velocity_horizontal_rmse_m_s"
WORST, MEDIAN, SHARE = "outage_largest_error_rms_m", "outage_end_error_median_m", "outage_end_error_share_median"
INNOVATION, STILL = "innovation_horizontal_rms_m", "standstill_horizontal_rmse_m"
# The metrics of the receiver only, and of the solution at the same fixes, that stand beside one of ours.
GNSS_ALONE = {
    H: ("gnss_alone_horizontal_rmse_m", "at_fixes_horizontal_rmse_m"),
    V: ("gnss_alone_vertical_rmse_m", "at_fixes_vertical_rmse_m"),
}


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    case: str
    quantity: str
    metric: str
    unit: str  # m, m/s, deg, %
    goal: float | None = None
    peers: str = ""
    at_most_gnss: bool = False  # whether the goal is also that of the receiver only


RMS_OF_WORST = "60 s outages, RMS of the largest error"
RTK = "KF-GINS {}, pyins {}, OB_GINS {}, 15 states {}"
ROWS = (
    Row("rtk free", "horizontal RMSE", H, "m", 0.0137, RTK.format(0.0134, 0.0134, 0.0148, 0.0139), True),
    Row("rtk free", "vertical RMSE", V, "m", 0.0176, "KF-GINS 0.0149, pyins 0.0175, 15 states 0.0176", True),
    Row("rtk free", "heading RMSE", YAW, "deg", 0.065, RTK.format(0.061, 0.062, 0.096, 0.090)),
    Row("rtk free", "horizontal velocity RMSE", VELOCITY, "m/s", 0.0068, RTK.format(0.0068, 0.0069, 0.0079, 0.0074)),
    Row("rtk odometer", "horizontal RMSE", H, "m", 0.0137, "OB_GINS 0.0146", True),
    Row("rtk odometer", "heading RMSE", YAW, "deg", 0.065, "OB_GINS 0.084, 15 states 0.067"),
    Row("rtk free 60 s", RMS_OF_WORST, WORST, "m", 9.8, RTK.format(9.75, 9.71, 9.77, 9.78)),
    Row("rtk odometer 60 s", RMS_OF_WORST, WORST, "m", 1.0, "OB_GINS 1.07, 15 states 2.18 (scale not estimated)"),
    Row(
        "spp free", "horizontal RMSE", H, "m", 1.65, "KF-GINS 1.99 (position only), 15 states 1.65, PX4 EKF2 1.74", True
    ),
    Row("spp free", "vertical RMSE", V, "m", None, "", True),
    Row("spp free", "heading RMSE", YAW, "deg", 0.168, "KF-GINS 0.425 (position only), 15 states 0.168, PX4 EKF2 2.8"),
    Row("spp odometer", "horizontal RMSE", H, "m", None, "", True),
    Row("spp odometer", "vertical RMSE", V, "m", None, "", True),
    Row("spp odometer", "horizontal velocity RMSE", VELOCITY, "m/s", 0.022, "15 states 0.022, PX4 EKF2 0.062"),
    Row("spp odometer", "heading RMSE", YAW, "deg", 0.09, "15 states 0.092"),
    Row("spp free 60 s", RMS_OF_WORST, WORST, "m", 13.6, "15 states 13.6, KF-GINS 30.8 (position only)"),
    Row("spp odometer 60 s", RMS_OF_WORST, WORST, "m", 3.0, "15 states 3.1"),
    Row("navmatlab", "horizontal RMSE", H, "m", 0.65, "", True),
    Row("navmatlab", "vertical RMSE", V, "m", None, "", True),
    Row("navmatlab", "heading RMSE without the mounting", "yaw_rmse_mounted_rad", "deg", 2.5),
    Row("navmatlab free 60 s", RMS_OF_WORST, WORST, "m", 155.0, "138 to 155"),
    Row("navmatlab nhc 60 s", RMS_OF_WORST, WORST, "m", 24.0, "28.5 (mount given), 188 (mount ignored)"),
    Row("navmatlab odometer 60 s", RMS_OF_WORST, WORST, "m", 5.0, "5.0"),
    Row("navmatlab odometer 60 s", "error at the end, share of the way, median", SHARE, "%", 1.0, "0.74"),
    Row("navmatlab 0327", "horizontal RMSE", H, "m", None, "", True),
    Row("navmatlab 0327", "vertical RMSE", V, "m", None, "", True),
    Row("navmatlab 0327 rtk", "horizontal RMSE at standstill, against RTK", STILL, "m", 1.5),
    Row("comma", "horizontal RMSE", H, "m", 0.44, "", True),
    Row("comma", "vertical RMSE", V, "m", None, "", True),
    Row("comma", "heading RMSE", YAW, "deg", 3.0),
    Row("comma wheel 10 s", "10 s outages, median at the end", MEDIAN, "m", 1.0),
    Row("rtkexp", "horizontal RMSE against its own fixes", H, "m", 0.02),
    Row("rtkexp", "horizontal innovation, RMS", INNOVATION, "m", 0.12, "15 states 0.10 to 0.12"),
    Row("rtkexp free 15 s", "15 s outages, RMS of the largest error", WORST, "m", 7.16, "GNSS_IMU 7.16, 15 states 6.3"),
    Row("rtkexp nhc 15 s", "15 s outages, RMS of the largest error", WORST, "m", 3.5, "GNSS_IMU 5.46, 15 states 3.3"),
    Row("rtkexp nhc 15 s, one run", "the same, outages counted from the alignment", WORST, "m", 3.5, "as above"),
    Row("rtkexp nhc 10 s", "10 s outages, median at the end", MEDIAN, "m", 2.5, "15 states 4.4 (free)"),
    *(Row(f"wid{trial}", "horizontal RMSE against its own fixes", H, "m", 0.05) for trial in ("02", "08", "10")),
    *(Row(f"wid{trial}", "horizontal innovation, RMS", INNOVATION, "m", 0.04) for trial in ("02", "08", "10")),
    *(
        Row(f"wid{trial} nhc 10 s", "10 s outages, median at the end", MEDIAN, "m", 1.0, "15 states 0.3 to 1.4 (free)")
        for trial in ("02", "08", "10")
    ),
    *(Row(f"wid{trial} wheel 10 s", "10 s outages, median at the end", MEDIAN, "m", 0.5) for trial in ("02", "08")),
    *(
        Row(f"wid{trial} nhc 60 s", "one outage of 60 s, error at the end", MEDIAN, "m", 20.0)
        for trial in ("02", "08", "10")
    ),
    *(
        Row(f"wid{trial} wheel 60 s", "one outage of 60 s, error at the end", MEDIAN, "m", 0.5)
        for trial in ("02", "08")
    ),
    Row("truck", "heading, standard deviation about its mean", "yaw_sd_rad", "deg", 1.0, "15 states 1.3"),
    Row("balzer", "positions rejected", "fixes_rejected", ""),
    Row("balzer", "filter resets", "filter_resets", "", 0.0),
)
