"""A date that cannot be, in any message that tells one, costs this date: the messages before and behind it count."""

import struct
from typing import Any

from pyubx2.ubxmessage import UBXMessage

from services.parsers.gnss.process import Config, Process
from shared.faults import FAULT
from shared.maths.dates import is_plausible
from shared.messages.base import Message
from shared.messages.gnss import GnssFix, GnssRaw
from tests.support.cases import each
from tests.support.gnss.frames import ubx as frame
from tests.unit.parsers.gnss.test_gnss_parser import ITOW_MS, START_NS, eoe, gga, nmea, pvt, rmc

NS = 1_000_000_000
OUTSIDE = [1979, 2101, 2300, 9999, 65535]  # 65535 is the largest that two bytes hold


def nav(name: str, **fields: Any) -> bytes:
    return bytes(UBXMessage("NAV", name, 0, **fields).serialize())


def pvat(year: int) -> bytes:
    payload = bytearray(116)
    struct.pack_into("<IBBHBBBBBB", payload, 0, ITOW_MS, 0, 7, year, 1, 1, 0, 0, 0, 0)
    return frame(0x01, 0x17, bytes(payload))


def legacy(time: bytes) -> bytes:
    """An epoch of a receiver before generation 9, with its time in a message of its own."""
    position = nav("NAV-POSLLH", iTOW=ITOW_MS, lat=42.5, lon=13.25, height=700_000, hMSL=650_000, hAcc=1_414, vAcc=2000)
    return position + nav("NAV-SOL", iTOW=ITOW_MS, gpsFix=3, gpsfixOK=1, numSV=9) + time


def rawx(week: int) -> bytes:
    return frame(0x02, 0x15, struct.pack("<dHbBBB2x", ITOW_MS / 1000, week, 18, 0, 1, 1))


KINDS = {
    "NAV-PVT": lambda year: pvt(year=year) + eoe(),
    "NAV-PVAT": lambda year: pvat(year) + eoe(),
    "NAV-TIMEUTC": lambda year: legacy(
        nav("NAV-TIMEUTC", iTOW=ITOW_MS, year=year, month=1, day=1, validTOW=1, validWKN=1, validUTC=1)
    ),
    "NAV-TIMEGPS": lambda year: legacy(
        nav("NAV-TIMEGPS", iTOW=ITOW_MS, week=min((year - 1980) * 52, 32767), leapS=18, towValid=1, weekValid=1,
            leapSValid=1)
    ),
    "RXM-RAWX": lambda year: rawx(min(max(year - 1980, 0) * 52, 65535)),
    "RMC": lambda year: nmea(f"GNRMC,000000.00,A,4230.0,N,01315.0,E,10.0,90.0,0101{year % 100:02},,,A,V") + gga(),
    "ZDA": lambda year: nmea(f"GNZDA,000000.00,01,01,{year},00,00") + gga() + rmc(),
}  # fmt: skip


@each("recorded", [False, True])
@each("year", OUTSIDE)
@each("kind", KINDS)
def test_a_date_outside_the_rule_ends_nothing(kind: str, year: int, recorded: bool) -> None:
    process = Process(Config())

    def feed(data: bytes, second: int) -> list[Message]:
        message = GnssRaw(received_ns=START_NS + second * NS, source="gnss0", data=data, recorded=recorded)
        return list(process.handle(message))

    messages = feed(pvt() + eoe(), 0) + feed(KINDS[kind](year), 1)
    good = feed(pvt(2) + eoe(2) + pvt(3) + eoe(3), 2)
    assert not [name for name in process.rejects if name.startswith(FAULT)], process.rejects
    for message in messages + good:
        utc_ns, stamp_ns = getattr(message, "utc_ns", None), getattr(message, "sampled_ns", None)
        assert utc_ns is None or is_plausible(utc_ns)
        assert stamp_ns is None or is_plausible(stamp_ns)
        assert type(message).model_validate_json(message.model_dump_json()) == message
    assert [fix.utc_ns for fix in good if isinstance(fix, GnssFix)][-1] == START_NS + 3 * NS
