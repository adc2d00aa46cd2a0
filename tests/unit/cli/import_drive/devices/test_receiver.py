"""Bytes of a receiver are stamped by the times that its messages tell."""

import struct
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import reduce
from operator import xor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.import_drive.devices.receiver import read_receiver
from cli.import_drive.devices.stamped import WITHOUT_DATE_NS, ClockKind, FileKind, StampedFile
from services.parsers.gnss.process import Config, Process
from shared.maths.crc import crc24q, fletcher
from shared.messages.gnss import GnssFix, GnssRaw
from tests.support.data import recording

NS = 1_000_000_000
NOON = datetime(2024, 5, 4, 12, 0, 0, tzinfo=UTC)
NOON_NS = round(NOON.timestamp()) * NS
TOW_MS = (6 * 86_400 + 12 * 3600 + 18) * 1000  # of that noon, a Saturday, 18 leap seconds ahead


def ubx(kind: int, number: int, payload: bytes) -> bytes:
    body = struct.pack("<BBH", kind, number, len(payload)) + payload
    return b"\xb5\x62" + body + fletcher(body)


def pvt(seconds: int, valid: int = 3, year: int = 2024, nano: int = -123) -> bytes:
    payload = struct.pack("<IHBBBBBBIi", TOW_MS + seconds * 1000, year, 5, 4, 12, 0, seconds, valid, 0, nano)
    return ubx(1, 7, payload.ljust(92, b"\0"))


def dop(seconds: float) -> bytes:
    return ubx(1, 4, struct.pack("<I", TOW_MS + round(seconds * 1000)).ljust(18, b"\0"))


def sentence(body: str) -> bytes:
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


def times(stamped: StampedFile) -> list[float]:
    return [(portion.time_ns - NOON_NS) / NS for portion in stamped.portions]


def test_times_of_week_before_the_first_date_are_known_afterwards() -> None:
    found = read_receiver([dop(0.0), dop(0.5), pvt(1), dop(1.5)])
    assert (found.kind, found.clock, found.rows) == (FileKind.RECEIVER, ClockKind.UTC, 4)
    assert times(found) == [0.0, 0.5, 1.0, 1.5]


def test_a_frame_without_a_time_has_that_of_the_frame_before_it_and_no_byte_is_lost() -> None:
    data = pvt(1) + ubx(2, 0x13, b"\0" * 24) + pvt(2)
    found = read_receiver([data[:50], data[50:]])
    assert times(found) == [1.0, 2.0]
    assert b"".join(portion.data for portion in found.portions) == data


def test_raw_measurements_tell_their_week() -> None:
    payload = struct.pack("<dHbBB", TOW_MS / 1000.0, 2312, 18, 0, 1).ljust(16, b"\0")
    assert times(read_receiver([ubx(2, 0x15, payload)])) == [0.0]


def test_without_leap_seconds_of_the_receiver_they_are_those_of_the_date() -> None:
    payload = struct.pack("<IihBB", TOW_MS, 0, 2312, 3, 0x0F).ljust(52, b"\0")
    assert times(read_receiver([ubx(1, 6, payload)])) == [0.0]


def test_a_week_ends_within_a_file() -> None:
    """NAV-DOP alone goes on over the end of the week after one date."""
    week_ms = 604_800_000
    before, after = (
        ubx(1, 4, struct.pack("<I", tow).ljust(18, b"\0")) for tow in (week_ms - 500, 500)
    )  # fmt: skip
    end = struct.pack("<IHBBBBBBIi", week_ms - 1000, 2024, 5, 4, 23, 59, 41, 3, 0, 0).ljust(92, b"\0")
    found = read_receiver([ubx(1, 7, end), before, after])
    assert [times(found)[i] - times(found)[0] for i in range(3)] == [0.0, 0.5, 1.5]


@pytest.mark.parametrize("first", [pvt(0, valid=0), pvt(0, year=2300), pvt(0, year=1970)])
def test_a_date_that_is_not_valid_is_no_date(first: bytes) -> None:
    assert times(read_receiver([first, pvt(1)]))[-1] == 1.0


def test_sentences_take_the_date_of_rmc_or_zda() -> None:
    rmc = sentence("GNRMC,120001.00,A,4807.0,N,01131.0,E,0.0,0.0,040524,,,A")
    zda = sentence("GNZDA,120001.00,04,05,2024,00,00")
    gga = sentence("GNGGA,120000.00,4807.0,N,01131.0,E,1,08,0.9,500.0,M,46.0,M,,")
    for dated in (rmc, zda):
        assert times(read_receiver([gga + dated])) == [0.0, 1.0]


def test_midnight_within_sentences() -> None:
    rmc = sentence("GNRMC,235959.00,A,4807.0,N,01131.0,E,0.0,0.0,040524,,,A")
    gga = sentence("GNGGA,000000.50,4807.0,N,01131.0,E,1,08,0.9,500.0,M,46.0,M,,")
    found = times(read_receiver([rmc + gga]))
    assert found[1] - found[0] == 1.5


def test_without_any_date_a_file_keeps_its_time_of_day() -> None:
    gga = sentence("GNGGA,000010.00,4807.0,N,01131.0,E,1,08,0.9,500.0,M,46.0,M,,")
    found = read_receiver([gga])
    assert found.clock is ClockKind.DAY
    assert found.portions[0].time_ns == WITHOUT_DATE_NS + 10 * NS


def pvat(seconds: int, valid: int = 7) -> bytes:
    head = struct.pack("<IBBHBBBBB", TOW_MS + seconds * 1000, 0, valid, 2024, 5, 4, 12, 0, seconds)
    return ubx(1, 0x17, head.ljust(116, b"\0"))


def time_utc(seconds: int, valid: int = 7) -> bytes:
    calendar = struct.pack("<IIiHBBBBBB", TOW_MS + seconds * 1000, 0, 0, 2024, 5, 4, 12, 0, seconds, valid)
    return ubx(1, 0x21, calendar)


def of_week(number: int, week: int, leap_s: int, valid: int = 7) -> bytes:
    return ubx(1, number, struct.pack("<IIihbBI", TOW_MS, 0, 0, week, leap_s, valid, 0))


@pytest.mark.parametrize(
    "dated",
    [pvat(0), time_utc(0), of_week(0x25, 2312 - 1024, 18), of_week(0x24, 2312 - 1356, 4)],
    ids=["NAV-PVAT", "NAV-TIMEUTC", "NAV-TIMEGAL", "NAV-TIMEBDS"],
)
def test_every_message_with_a_date_tells_it(dated: bytes) -> None:
    found = read_receiver([dated + dop(1.0)])
    assert (found.clock, times(found)) == (ClockKind.UTC, [0.0, 1.0])


@pytest.mark.parametrize(
    "message", [dop, lambda second: pvat(second, valid=0), lambda second: time_utc(second, valid=0)]
)
def test_times_of_week_without_a_date_are_times_of_day(message: Callable[[int], bytes]) -> None:
    """Also over the end of a week."""
    found = read_receiver([b"".join(message(second) for second in range(4))])
    assert found.clock is ClockKind.DAY
    assert [portion.time_ns - WITHOUT_DATE_NS - 12 * 3600 * NS for portion in found.portions] == [
        second * NS for second in range(4)
    ]
    last_ms = 7 * 86_400_000 - 500
    week_end = b"".join(ubx(1, 4, struct.pack("<I", at).ljust(18, b"\0")) for at in (last_ms, last_ms + 250, 0, 250))
    stamps = [portion.time_ns for portion in read_receiver([week_end]).portions]
    assert [later - stamps[0] for later in stamps] == [0, 250_000_000, 500_000_000, 750_000_000]


def epoch(second: int, *, valid: bool = True, day: str = "040524", start_s: int = 43_200, ahead_s: int = 0) -> bytes:
    """RMC and GGA of a second, by a clock that may be ahead."""
    hours, rest = divmod((start_s + second + ahead_s) % 86_400, 3600)
    clock, place = f"{hours:02d}{rest // 60:02d}{rest % 60:02d}.00", f"4807.0,N,011{second:02d}.0,E"
    if not valid:
        return sentence(f"GNRMC,{clock},V,,,,,,,{day},,,N") + sentence(f"GNGGA,{clock},,,,,0,00,99.99,,,,,,")
    return sentence(f"GNRMC,{clock},A,{place},0.0,0.0,{day},,,A") + sentence(
        f"GNGGA,{clock},{place},1,08,0.9,500.0,M,46.0,M,,"
    )


@pytest.mark.parametrize(("day", "start_s"), [("", 43_200), ("060180", 43_200), ("060180", 86_387), ("220826", 3600)])
def test_dates_and_times_without_a_fix_are_arbitrary(day: str, start_s: int) -> None:
    """NMEA 0183, RMC: its fields are valid with the status A alone."""
    cold = b"".join(epoch(k, valid=False, day=day, start_s=start_s) for k in range(8))
    found = read_receiver([cold + b"".join(epoch(k) for k in range(8, 30))])
    assert times(found) == [float(k) for k in range(30)] and not found.rejects


def test_a_receiver_that_starts_again_does_not_move_the_clock() -> None:
    before = b"".join(epoch(k) for k in range(10))
    cold = b"".join(epoch(k, valid=False, day="060180", start_s=0) for k in range(5))
    found = read_receiver([before + cold + b"".join(epoch(k) for k in range(15, 30))])
    assert times(found) == [float(k) for k in range(30)] and not found.rejects
    found = read_receiver([before + cold])
    assert times(found) == [float(k) for k in range(15)]


def test_zda_is_as_valid_as_the_sentences_around_it() -> None:
    zda = [sentence(f"GNZDA,2359{k:02d}.00,06,01,1980,00,00") for k in range(4)]
    cold = b"".join(epoch(k, valid=False, start_s=86_340) + zda[k] for k in range(4))
    found = read_receiver([cold + b"".join(epoch(k) for k in range(4, 20))])
    assert times(found) == [float(k) for k in range(20)]


def test_without_any_fix_the_time_of_day_is_kept_without_a_date() -> None:
    found = read_receiver([b"".join(epoch(k, valid=False, day="060180") for k in range(5))])
    assert found.clock is ClockKind.DAY and len(found.portions) == 5


def test_times_of_week_before_the_first_fix_are_arbitrary() -> None:
    cold = b"".join(
        ubx(1, 7, struct.pack("<IHBBBBBBIi", 1000 * k, 2015, 1, 1, 0, 0, 0, 0, 0, 0).ljust(92, b"\0")) for k in range(5)
    )
    assert times(read_receiver([cold + b"".join(pvt(k) for k in range(5, 20))])) == [float(k) for k in range(20)]


@pytest.mark.parametrize("step_s", [1, 2, 3, 5, 17, 18])
def test_epochs_before_a_step_of_utc_are_as_far_apart_as_they_were(step_s: int) -> None:
    ahead = b"".join(epoch(k, ahead_s=step_s) for k in range(25))
    found = read_receiver([ahead + b"".join(epoch(k) for k in range(25, 60))])
    assert times(found) == [float(k) for k in range(60)] and not found.rejects


@pytest.mark.parametrize("step_s", [-18, -2, -1, 1, 2, 16])
def test_a_step_of_utc_against_the_time_of_week_is_known_in_both_directions(step_s: int) -> None:
    def off(k: int) -> bytes:
        when = NOON + timedelta(seconds=k + step_s)
        payload = struct.pack("<IHBBBBBBIi", TOW_MS + k * 1000, *when.timetuple()[:6], 3, 0, 0)
        return ubx(1, 7, payload.ljust(92, b"\0"))

    found = read_receiver([b"".join(off(k) for k in range(25)) + b"".join(pvt(k) for k in range(25, 60))])
    assert times(found) == [float(k) for k in range(60)] and not found.rejects


def test_repeated_sentences_and_pauses_are_no_steps() -> None:
    twice = b"".join(epoch(k) + epoch(k) for k in range(20))
    assert times(read_receiver([twice])) == [float(k) for k in range(20)]
    once = b"".join(epoch(k) * (2 if k == 7 else 1) for k in range(20))
    assert times(read_receiver([once])) == [float(k) for k in range(20)]
    pause = b"".join(epoch(k) for k in (*range(10), *range(30, 40)))
    assert times(read_receiver([pause])) == [float(k) for k in (*range(10), *range(30, 40))]
    wrong = b"".join(epoch(k if k != 12 else 5) for k in range(20))
    assert times(read_receiver([wrong]))[-1] == 19.0


def test_one_wrong_time_costs_itself_and_a_clock_that_is_set_costs_what_was_before() -> None:
    good = b"".join(pvt(second) for second in range(20))
    found = read_receiver([good + pvt(21) + pvt(2, year=2023) + pvt(22)])
    assert found.rejects["time_goes_back"] == 1 and times(found)[-1] == 22.0
    late = b"".join(pvt(second, year=2031) for second in range(3))
    found = read_receiver([late + b"".join(pvt(second) for second in range(30))])
    assert found.rejects["before_the_clock_was_set"] > 0
    assert times(found)[0] > 0.0 and times(found)[-1] == 29.0


def rtcm(number: int, tow_ms: int) -> bytes:
    bits = number << 148 | 7 << 136 | tow_ms << 106
    body = bits.to_bytes(20, "big")
    frame = b"\xd3\x00" + bytes([len(body)]) + body
    return frame + crc24q(frame).to_bytes(3, "big")


def test_corrections_take_the_week_of_another_file() -> None:
    found = read_receiver([rtcm(1077, TOW_MS) + rtcm(1097, TOW_MS + 1000)], week_of_ns=NOON_NS - 3600 * NS)
    assert (found.kind, times(found)) == (FileKind.CORRECTIONS, [0.0, 1.0])
    assert times(read_receiver([rtcm(1127, TOW_MS - 14_000)], week_of_ns=NOON_NS)) == [0.0]


@given(st.lists(st.one_of(st.binary(max_size=60), st.sampled_from([pvt(1), pvt(5), dop(3.0), pvt(0, 0)])), max_size=30))
def test_whatever_bytes_come_times_never_go_back(parts: list[bytes]) -> None:
    found = read_receiver(parts)
    stamps = [portion.time_ns for portion in found.portions]
    assert stamps == sorted(stamps)


def test_the_parser_of_the_unit_finds_the_times_of_a_recorded_file() -> None:
    config = Config()
    parser = Process(config)
    found = read_receiver([(recording("gpsd_receiver_logs/ublox-zed-f9p-hp.log")).read_bytes()])
    fixes = [
        message
        for portion in found.portions
        for message in parser.handle(
            GnssRaw(received_ns=portion.time_ns + round(config.minimum_delay_s * NS), source="gnss0", data=portion.data,
                    recorded=True)
        )
        if isinstance(message, GnssFix)
    ]  # fmt: skip
    assert len(fixes) >= 25
    assert max(abs(fix.sampled_ns - (fix.utc_ns or 0)) for fix in fixes) < 1_000_000
