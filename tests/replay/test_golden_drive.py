"""Stored device bytes through the whole unit give the stored result; `make golden` rewrites it for review.

The tolerances are far below what a user could see and far above what another processor's rounding makes of the same
program: the filter amplifies the last bits of its inputs to some 1e-9 of its outputs in these 30 s.
"""

from collections.abc import Iterator
from math import isclose

import pytest
from pydantic_core import to_json

from services.parsers.gnss.protocols import FRAMINGS
from shared.messages.base import Message
from shared.messages.trust import MonitorTest, TrustMonitor
from shared.protocols.framing.framer import Framer
from shared.runtime.offline import OfflineUnit
from shared.trust.result import complete
from shared.words.words import words
from tests.support.drives.golden import FILES, FOLDER, Row, device_bytes, results, rows, stored_rows
from tests.support.gnss.ublox import parse_nmea, parse_ubx

RELATIVE = 1e-6
# [unit of the field] below which two values are the same, by the end of the field's name.
ABSOLUTE = {"_deg": 1e-9, "_m": 1e-4, "_m_s": 1e-5, "_rad": 1e-6}


@pytest.fixture(scope="module")
def computed() -> list[Row]:
    return list(rows(results()))


def differences(name: str, computed: object, stored: object) -> list[str]:
    """Name every field that differs by more than its tolerance."""
    if isinstance(stored, dict) and isinstance(computed, dict) and computed.keys() == stored.keys():
        return [text for key in stored for text in differences(key, computed[key], stored[key])]
    if isinstance(stored, list) and isinstance(computed, list) and len(computed) == len(stored):
        return [text for pair in zip(computed, stored, strict=True) for text in differences(name, *pair)]
    if isinstance(stored, float) and isinstance(computed, float | int):
        absolute = next((limit for end, limit in ABSOLUTE.items() if name.endswith(end)), 1e-9)
        same = isclose(computed, stored, rel_tol=RELATIVE, abs_tol=absolute)
    else:
        same = computed == stored
    return [] if same else [f"{name}: {computed} instead of {stored}"]


@pytest.mark.parametrize(
    "kinds",
    [("GnssFix", "GnssSatellites"), ("ImuSamples",), ("VehicleSpeed", "WheelSpeeds")],
    ids=["gnss", "imu", "can"],
)
def test_the_bytes_of_each_device_parse_to_the_stored_messages(computed: list[Row], kinds: tuple[str, ...]) -> None:
    of_kinds = [[row for row in table if row["type"] in kinds] for table in (computed, stored_rows())]
    assert len(of_kinds[1]) >= 20
    assert not differences("", *of_kinds)


def test_fusion_and_controller_publish_the_stored_solutions_and_states(computed: list[Row]) -> None:
    kinds = {"NavigationSolution", "NavigationState", "AidingUpdate", "ModeState"}
    here, there = ([row for row in table if row["type"] in kinds] for table in (computed, stored_rows()))
    assert [row["type"] for row in here] == [row["type"] for row in there]
    found = [text for pair in zip(here, there, strict=True) for text in differences("", *pair)]
    assert not found, found[:10]


def test_as_many_messages_of_each_type_are_published_as_stored(computed: list[Row]) -> None:
    assert computed[-1] == stored_rows()[-1]


def test_independent_readers_find_as_many_epochs_in_the_stored_bytes_as_the_unit() -> None:
    frames = list(Framer(FRAMINGS).feed((FOLDER / "gnss.ubx").read_bytes()))
    ubx = [parse_ubx(frame.data) for frame in frames if frame.protocol == "UBX"]
    nmea = [parse_nmea(frame.data) for frame in frames if frame.protocol == "NMEA"]
    epochs = sum(message.identity == "NAV-PVT" for message in ubx)
    assert epochs == sum(sentence.sentence_type == "RMC" for sentence in nmea) == 29
    assert epochs == sum(row["type"] == "GnssFix" for row in stored_rows())


def test_every_stored_byte_is_replayed() -> None:
    replayed = dict.fromkeys(FILES.values(), 0)
    for message in device_bytes():
        replayed[type(message)] += len(message.data)
    assert replayed == {kind: (FOLDER / name).stat().st_size for name, kind in FILES.items()}


def test_every_explanation_of_a_monitor_has_words(computed: list[Row]) -> None:
    monitors = [
        TrustMonitor.model_validate_json(to_json({name: value for name, value in row.items() if name != "type"}))
        for row in computed
        if row["type"] == "TrustMonitor"
    ]
    explained: list[TrustMonitor | MonitorTest] = [*monitors, *(test for monitor in monitors for test in monitor.tests)]
    assert len(explained) > 60
    for item in explained:
        assert item.reason_code is not None
        assert words().detail(complete(item.reason_code, item)), item.reason_code


TEXTS = frozenset(("reason", "reasons", "findings", "missing", "exclusion_declined", "held_reason", "sentence"))


class UnitWithoutTexts(OfflineUnit):
    """The unit, with every text that explains something replaced by "x" before another process reads it."""

    def _handled(self, name: str, message: Message) -> Iterator[Message]:
        return (wordless(item) for item in super()._handled(name, message))


def wordless(message: Message) -> Message:
    changes = {name: blank(value, text=name in TEXTS) for name, value in message if type(value) in (str, tuple)}
    return message.model_copy(update=changes)


def blank(value: object, *, text: bool) -> object:
    if isinstance(value, Message):
        return wordless(value)
    if type(value) is tuple:  # named tuples hold no texts
        return tuple(blank(item, text=text) for item in value)
    return "x" if text and type(value) is str else value  # words of enumerations are not texts


def decisions(table: list[Row]) -> list[object]:
    def kept(value: object) -> object:
        if isinstance(value, dict):
            return {name: kept(item) for name, item in value.items() if name not in TEXTS}
        return [kept(item) for item in value] if isinstance(value, list) else value

    return [kept(row) for row in table]


def test_with_every_text_replaced_by_x_all_decisions_are_the_same(computed: list[Row]) -> None:
    table = list(rows(results(UnitWithoutTexts)))
    assert {"x"} == {text for row in table if row["type"] == "TrustState" for text in row["reasons"]}  # type: ignore[attr-defined]
    assert decisions(table) == decisions(computed)
