"""RINEX navigation and observation text."""

import pytest

from services.core.cooperative.broadcast.rinex import read_rinex_navigation
from services.core.cooperative.broadcast.rinex_observation import read_rinex_observations
from services.core.cooperative.measurements import WEEK_NS, Constellation, SatelliteId

HEAD_2 = "     2.10           N: GPS NAV DATA                         RINEX VERSION / TYPE\n"
HEAD_3 = "     3.04           N: GNSS NAV DATA    M: MIXED            RINEX VERSION / TYPE\n"
END = " " * 60 + "END OF HEADER\n"
ORBIT = [float(k) * 1e-3 for k in range(1, 29)]
TOE, WEEK = 518400.0, 1316.0


def record(first: str, margin: int, **special: float) -> str:
    values = list(ORBIT)
    values[8], values[18] = TOE, WEEK
    for name, value in special.items():
        values[int(name[1:])] = value
    rows = [" " * margin + "".join(f"{value:19.12E}" for value in values[k : k + 4]) for k in range(0, 28, 4)]
    return "\n".join([first, *rows]).replace("E", "D") + "\n"


GPS_2 = record(" 3 05  4  2  0  0  0.0" + "".join(f"{value:19.12E}" for value in (9.67e-5, 3e-12, 0.0)), 3, _21=0.0)
GPS_3 = record("G03 2005 04 02 00 00 00" + "".join(f"{value:19.12E}" for value in (9.67e-5, 3e-12, 0.0)), 4, _21=0.0)


@pytest.mark.parametrize("text", [HEAD_2 + END + GPS_2, HEAD_3 + END + GPS_3])
def test_both_versions_give_the_same_gps_ephemeris(text: str) -> None:
    (found,), ionosphere = read_rinex_navigation(text)
    assert ionosphere is None
    assert found.satellite == SatelliteId(Constellation.GPS, 3) and found.healthy
    assert found.toe_ns == found.toc_ns == 1316 * WEEK_NS + 518400 * 10**9
    assert found.clock == (9.67e-5, 3e-12, 0.0)
    assert (found.issue, found.crs, found.sqrt_a, found.group_delay_s) == (0, 0.002, 0.008, 0.023)


@pytest.mark.parametrize(("source", "number"), [(0b10_0000_0001, 1), (0b1_0000_0010, 0)])
def test_galileo_ephemerides_are_those_of_inav(source: int, number: int) -> None:
    text = record("E11 2005 04 02 00 00 00" + f"{1e-4:19.12E}" * 3, 4, _17=float(source), _21=0.0).replace("E11", "E11")
    text = text.replace("D11", "E11")
    found, _ = read_rinex_navigation(HEAD_3 + END + text)
    assert len(found) == number
    if found:
        assert found[0].satellite == SatelliteId(Constellation.GALILEO, 11) and found[0].group_delay_s == 0.024


def test_other_systems_are_passed_over() -> None:
    glonass = "R01 2005 04 02 00 00 00" + f"{1e-4:19.12E}" * 3 + "\n" + ("    " + f"{1.0:19.12E}" * 4 + "\n") * 3
    found, _ = read_rinex_navigation(HEAD_3 + END + glonass + GPS_3)
    assert [str(ephemeris.satellite) for ephemeris in found] == ["G03"]


def test_the_ionosphere_is_read_from_either_header() -> None:
    two = "    1.1180D-08  1.4900D-08 -5.9600D-08 -5.9600D-08          ION ALPHA\n"
    two += "    8.8060D+04  1.6380D+04 -1.9660D+05 -1.3110D+05          ION BETA\n"
    three = "GPSA   1.1180E-08  1.4900E-08 -5.9600E-08 -5.9600E-08       IONOSPHERIC CORR\n"
    three += "GPSB   8.8060E+04  1.6380E+04 -1.9660E+05 -1.3110E+05       IONOSPHERIC CORR\n"
    for text in (HEAD_2 + two + END, HEAD_3 + three + END):
        _, found = read_rinex_navigation(text)
        assert found is not None and found.alpha[0] == 1.118e-8 and found.beta[2] == -196600.0


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "no RINEX navigation"), ("nonsense", "no RINEX navigation"), (HEAD_2, "END OF HEADER"),
     (HEAD_2 + END + GPS_2[:200], "line 3: the file is cut"), (HEAD_2.replace("2.10", "4.00") + END, "convert"),
     (HEAD_2 + END + GPS_2.replace("05  4", "05 xx"), "line 3")],
)  # fmt: skip
def test_broken_navigation_files_are_errors_that_say_where(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_rinex_navigation(text)


OBSERVATION = (
    "     2.10           OBSERVATION DATA    M                   RINEX VERSION / TYPE\n"
    " -3976219.5082  3382372.5671  3652512.9849                  APPROX POSITION XYZ\n"
    "     3    L1    C1    D1                                    # / TYPES OF OBSERV\n" + END +
    " 05  4  2  0  0 30.0040000  0  2G 3R 7\n"
    "  55923622.160    24767686.375        -1234.500  \n"
    "  55923622.160    24767686.375        -1234.500  \n"
    "                            4  1\n"
    "RINEX FILE SPLICE; other post-header comments skipped       COMMENT\n"
    " 05  4  2  0  1  0.0040000  0  1G 3\n"
    "  55923622.160                    \n"
)  # fmt: skip


def test_observations_are_read_past_events_and_without_what_is_not_there() -> None:
    (first, second), position = read_rinex_observations(OBSERVATION)
    assert position == (-3976219.5082, 3382372.5671, 3652512.9849)
    assert first.gps_time_ns == 1316 * WEEK_NS + 518430 * 10**9 + 4_000_000
    (one,) = first.measurements
    assert (str(one.satellite), one.pseudorange_m, one.doppler_hz, one.cn0_db_hz) == (
        "G03",
        24767686.375,
        -1234.5,
        None,
    )
    assert second.measurements == ()


def test_phases_have_the_flags_of_a_lost_lock_and_of_a_half_cycle() -> None:
    for flag, slipped, resolved in ((" ", False, True), ("1", True, True), ("2", False, False), ("3", True, False)):
        text = OBSERVATION.replace("  55923622.160    24767686.375", f"  55923622.160{flag}   24767686.375")
        (one,) = read_rinex_observations(text)[0][0].measurements
        assert (one.carrier_cycles, one.slipped, one.half_cycle_resolved) == (55923622.16, slipped, resolved)


@pytest.mark.parametrize(
    "text", ["", "nonsense", OBSERVATION.replace("END OF HEADER", ""), OBSERVATION.replace("0  2G", "0 xxG")]
)
def test_broken_observation_files_are_errors(text: str) -> None:
    with pytest.raises(ValueError, match=r"RINEX|line"):
        read_rinex_observations(text)
