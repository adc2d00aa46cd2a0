"""What the dashboard has a word, an icon or a unit for: every value that the contract of the bus can carry.

The tables of the pages are JavaScript; their keys are read from the text, each table by its name.
"""

import re
from collections.abc import Mapping
from enum import StrEnum

import pytest

from services.core.trust.facts import Monitor
from services.monitoring.status.page import DASHBOARD
from services.monitoring.status.series.fields import parse, unit_of
from services.monitoring.status.views.banner import OF_STATE, WORDS, Trust
from services.monitoring.status.views.gnss import LETTERS
from services.monitoring.status.views.plain_words import LABELS
from shared.messages.gnss import CarrierSolution, Constellation, FixType, InterferenceState
from shared.messages.navigation import AidingKind, NavigationPhase, SetUpVerdict
from shared.messages.operation import DeviceFound, Freshness, MessageUse, OriginKind, ProcessStatus
from shared.messages.toll import GateMode, PassageState
from shared.messages.trust import Hypothesis, Outcome, TrustLevel
from shared.words.words import words
from tests.support.cases import each

CHARTS, GNSS, TRUST = "charts/chart_words.js", "gnss/gnss_words.js", "trust/hypothesis_words.js"

TABLES: tuple[tuple[str, str, type[StrEnum], set[str]], ...] = (  # file, table, values, and those that are not shown
    (CHARTS, "aiding", AidingKind, set()),
    (CHARTS, "constellation", Constellation, set()),
    (GNSS, "constellation", Constellation, set()),
    (GNSS, "flags", InterferenceState, set()),
    (GNSS, "found", DeviceFound, set()),
    ("gnss/gnss.js", "FLAG", InterferenceState, set()),
    ("gnss/gnss.js", "OUTCOME", Outcome, set()),
    ("gnss/gnss.js", "PORT_STATE", DeviceFound, set()),
    ("map/style.js", "ALTERNATIVE_DASHES", Hypothesis, set()),
    ("map/style.js", "VERDICTS", Trust, {"off"}),  # the state of a check, never of a position
    ("parts.js", "FRESH_STATE", Freshness, set()),
    ("parts.js", "SHAPES", Trust, set()),
    ("parts.js", "STATUS_STATE", ProcessStatus, set()),
    ("toll/toll.js", "STATE_ICON", PassageState, set()),
    ("trust/hypotheses.js", "KEYS", Hypothesis, set()),
    ("trust/trust.js", "OUTCOME_STATE", Outcome, set()),
    ("words.js", "carrier", CarrierSolution, set()),
    ("words.js", "fixType", FixType, set()),
    ("words.js", "monitors", Monitor, set()),
    ("toll/toll_words.js", "modes", GateMode, set()),
    ("words.js", "origin", OriginKind, set()),
    ("words.js", "outcome", Outcome, set()),
    ("words.js", "phases", NavigationPhase, set()),
    ("toll/toll_words.js", "states", PassageState, set()),
    ("words.js", "status", ProcessStatus, set()),
    ("system/system_words.js", "statusWhy", ProcessStatus, set()),
    ("words.js", "trust", Trust, set()),
    ("words.js", "uses", MessageUse, set()),
    ("system/system_words.js", "verdicts", SetUpVerdict, {"unknown"}),  # those checks are listed without one
)


def keys_of(text: str, name: str) -> set[str]:
    """Give the keys of a table of objects, or the texts of a list, in the text of a module."""
    found = re.search(rf"\b{name}(?: =|:) ([{{\[])", text)
    assert found, f"there is no table {name}"
    body = text[found.end() :]
    if found[1] == "[":
        return set(re.findall(r'"([^"]*)"', body[: body.index("]")]))
    without_texts = re.sub(r'"(?:[^"\\]|\\.)*"|`[^`]*`|//[^\n]*', '""', body)
    keys, depth = set[str](), 0
    for part in re.finditer(r"(\w+):|[{\[(]|[}\])]", without_texts):
        if part[1] is None:
            depth += 1 if part[0] in "{[(" else -1
        elif depth == 0:
            keys.add(part[1])
        if depth < 0:
            break
    return keys


def read(file: str) -> str:
    return (DASHBOARD / file).read_text(encoding="utf-8")


@each(("file", "table", "values", "left_out"), TABLES)
def test_every_value_is_in_the_tables_of_the_pages(
    file: str, table: str, values: type[StrEnum], left_out: set[str]
) -> None:
    missing = sorted(set(values) - keys_of(read(file), table) - left_out)
    assert not missing, f"add {missing} of {values.__name__} to {table} in dashboard/{file}"


@pytest.mark.parametrize(("file", "table"), [(file, table) for file, table, *_ in TABLES if "STATE" in table])
def test_every_icon_that_a_table_names_exists(file: str, table: str) -> None:
    found = re.search(rf"\b{table} = {{(.*?)}};", read(file), re.DOTALL)
    assert found
    missing = set(re.findall(r': "(\w+)"', found[1])) - keys_of(read("parts.js"), "SHAPES")
    assert not missing, f"{table} in dashboard/{file} names {missing}, which SHAPES of parts.js has not"


@each("kind", AidingKind)
def test_the_innovations_of_every_aid_have_a_unit(kind: AidingKind) -> None:
    unit = unit_of(parse(f"navigation/aiding[{kind}]:innovation.0"))
    assert unit or kind is AidingKind.EXTERNAL, (
        f"add AidingKind.{kind.name} with its unit to _KIND_UNITS in series/fields.py"
    )


def test_an_aid_without_a_unit_is_plotted_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.monitoring.status.series.fields._KIND_UNITS", {})
    assert unit_of(parse("navigation/aiding[odometer]:innovation.0")) == ""


@each(
    ("table", "values"),
    [
        (LABELS, Monitor),
        (words().names["belief"], Hypothesis),
        (words().names["condition"], Hypothesis),
        (words().names["fix_type"], FixType),
        (words().names["filter_phase"], NavigationPhase),
        ({name.removeprefix("gate_"): label for name, label in words().names["check"].items()}, AidingKind),
        (WORDS, Trust),
        (OF_STATE, TrustLevel),
        (LETTERS, Constellation),
    ],
)
def test_every_value_is_in_the_tables_of_the_server(table: Mapping[str, object], values: type[StrEnum]) -> None:
    missing = [value.value for value in values if value not in table]
    assert not missing, f"add {missing} of {values.__name__} to that table of services/monitoring/status/views"


def test_keys_are_read_from_a_table_as_javascript_has_it() -> None:
    text = 'const T = { a: "x: {y: 1}", b: (n) => `${n} c: 1`, d: { e: 1 }, // f: 2\n g: [1], }; const L = ["h", "i"];'
    assert keys_of(text, "T") == {"a", "b", "d", "g"}
    assert keys_of(text, "L") == {"h", "i"}
