"""The words of codes: complete in every language, short enough, data alone, and what is shown where they do not fit."""

from datetime import timedelta, timezone
from enum import StrEnum
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from cli.import_drive import codes as importing
from cli.solve import codes as solve
from fleet.alarms import codes as fleet
from services.core.toll import codes as toll
from services.core.trust.codes import Code
from services.core.trust.facts import Monitor
from services.monitoring.health import codes as health
from services.monitoring.ledger import codes as ledger
from services.monitoring.recorder import codes as recorder
from services.monitoring.status.views import codes as banner
from services.monitoring.status.views.banner import Trust
from shared.bus import codes as broker
from shared.messages.explanation import Explanation, Quoted, Reference, ReferenceKind, Value, explain, process
from shared.messages.navigation import NavigationPhase
from shared.messages.trust import Hypothesis
from shared.rejects import PARTS, reason_of
from shared.words import words as words_module
from shared.words.words import (
    CLAUSE,
    INSTANT,
    INSTANT_ENDING,
    LANGUAGES,
    OWNERS,
    PLACEHOLDER,
    QUANTITIES,
    REASON_LENGTH,
    REPOSITORY,
    SUBJECT,
    Row,
    Told,
    Words,
    reason,
    stated,
    words,
)
from tests.support.words import FIELDS, FILE, lines, texts

ENGLISH = words()
CODES: dict[str, set[StrEnum]] = {
    "trust": set(Code),
    "banner": set(banner.Code),
    "broker": set(broker.Code),
    "health": set(health.Code),
    "toll": set(toll.Code),
    "ledger": set(ledger.Code),
    "fleet": set(fleet.Code),
    "import": set(importing.Code),
    "solve": set(solve.Code),
    "recorder": set(recorder.Code),
}
SENTENCE_MAXIMUM = {"en": 90}  # and 110 in all others: two lines on a phone
ROWS = [(language, code) for language in LANGUAGES for code in ENGLISH.rows]


def test_every_file_of_words_has_a_registered_owner() -> None:
    found = {
        path.parent.relative_to(REPOSITORY).as_posix()
        for part in ("services", "shared", "cli", "fleet")
        for path in (REPOSITORY / part).rglob("words.toml")
    }
    assert found == set(OWNERS.values()), "add the folder to OWNERS of shared/words/words.py"
    assert CODES.keys() == OWNERS.keys(), "add the codes to CODES of this file"


@pytest.mark.parametrize("owner", CODES)
def test_every_code_has_a_row_and_every_row_is_of_a_code(owner: str) -> None:
    rows = {code for code in ENGLISH.rows if code.startswith(f"{owner}.")}
    assert rows == {str(code) for code in CODES[owner]}, f"see {OWNERS[owner]}/words.toml and its codes"


@pytest.mark.parametrize("language", [one for one in LANGUAGES if one != "en"])
def test_a_language_has_what_a_driver_reads_and_the_causes_that_an_installer_reads(language: str) -> None:
    here = words(language)
    for code, row in ENGLISH.rows.items():
        for field in ("sentence", "clause", "action", *(["detail"] if row.clause else [])):
            said, there = bool(getattr(here.row(code), field)), bool(getattr(row, field))
            assert said == there, f"{language}.toml and {code}: {field}"
    assert set(here.rows) <= set(ENGLISH.rows)
    assert here.format.keys() == ENGLISH.format.keys()
    tables = {
        match[2] for row in here.rows.values() for match in PLACEHOLDER.finditer(row.sentence)
        if match[2] not in ("", *QUANTITIES, CLAUSE, INSTANT)
    }  # fmt: skip
    for table in tables:
        assert here.names[table].keys() == ENGLISH.names[table].keys(), f"names.{table} of {language}.toml"


@pytest.mark.parametrize(("language", "code"), ROWS)
def test_a_sentence_is_one_line_without_figures_and_short_with_its_longest_values(language: str, code: str) -> None:
    spoken = words(language)
    said = texts(code, spoken)
    if text := said["sentence"]:
        assert len(text) <= SENTENCE_MAXIMUM.get(language, 110), text
        assert text.endswith(".") and "\n" not in text and "{" not in text
    detail = said["detail"]
    assert detail is None or (len(detail) <= REASON_LENGTH and "{" not in detail)
    assert said["sentence"] or detail, "it says something"


@pytest.mark.parametrize(("language", "code"), ROWS)
def test_a_placeholder_names_a_quantity_that_fits_its_value_or_a_table_that_exists(language: str, code: str) -> None:
    spoken = words(language)
    for field in FIELDS:
        for name, kind, _ in PLACEHOLDER.findall(getattr(spoken.row(code), field)):
            if kind in QUANTITIES:
                assert name.endswith(QUANTITIES[kind][0]), f"{code}: {name} is not {kind}"
            elif kind == INSTANT:
                assert name.endswith(INSTANT_ENDING)
            elif kind and kind != CLAUSE:
                assert kind in ENGLISH.names, f"{code}: there is no quantity and no table {kind}"
            assert field != "sentence" or kind not in ("distance", "speed", "number", "share"), (
                "no figures for a driver"
            )


def test_all_rendered_sentences_are_those_that_were_reviewed() -> None:
    assert FILE.read_text(encoding="utf-8").splitlines() == list(lines()), "`make golden`, and review the difference"


@pytest.mark.parametrize(
    ("table", "words_of"),
    [("monitor", Monitor), ("source", [one for one in Hypothesis if one is not Hypothesis.NOTHING]),
     ("hypothesis", [one for one in Hypothesis if one is not Hypothesis.NOTHING]), ("phase", NavigationPhase),
     ("state", Trust)],
    ids=["monitor", "source", "hypothesis", "phase", "state"],
)  # fmt: skip
def test_every_word_of_an_enumeration_has_a_name(table: str, words_of: list[str]) -> None:
    assert set(ENGLISH.names[table]) == {str(word) for word in words_of}


def row(**changes: str) -> Words:
    return Words("en", {"trust.x": Row(**changes)}, ENGLISH.names, ENGLISH.format)


@pytest.mark.parametrize(
    ("template", "values", "said"),
    [
        ("{a_m:distance}", {"a_m": 12.34}, "12.3 m"),
        ("{a_m_s:speed}", {"a_m_s": -3.25}, "-3.2 m/s"),
        ("{a_rad:angle}", {"a_rad": 0.5}, "28.6°"),
        ("{a_deg:angle}", {"a_deg": 0.5}, "0.5°"),
        ("{a_s:duration}", {"a_s": 6.24}, "6.2 s"),
        ("{a_s:duration}", {"a_s": 612.4}, "612 s"),
        ("{a_s:duration}", {"a_s": 6}, "6 s"),
        ("{probability:share}", {"probability": 0.625}, "62.5 %"),
        ("{a_ns:instant}", {"a_ns": 1_795_000_000_500_000_000}, "11:06:40 UTC"),
        ("{a:monitor}", {"a": "motion"}, "Motion conflict"),
        ("{a:monitor}", {"a": "of_a_newer_release"}, "of a newer release"),
        ("{a:source}", {"a": ("gnss", "imu", "odometer")}, "GNSS, the inertial sensors or the odometer"),
        ("{a:source:and}", {"a": ("gnss", "imu")}, "GNSS and the inertial sensors"),
        ("{a}", {"a": (Reference(kind=ReferenceKind.NEIGHBOUR, name="17"),)}, "neighbour 17"),
        ("{a}", {"a": Reference(kind=ReferenceKind.LANE, name="n1")}, "lane n1"),
        ("{a}", {"a": Reference(kind=ReferenceKind.PROCESS, name="core.trust")}, "core.trust"),
        ("{a}", {"a": ()}, "no source by name"),
        ("{a::and}", {"a": (Reference(kind=ReferenceKind.TOPIC, name="gnss/raw"),) * 2}, "gnss/raw and gnss/raw"),
        ("{a_bytes:size}", {"a_bytes": 512_000}, "512 kB"),
        ("{a_bytes:size}", {"a_bytes": 300_000_000}, "300 MB"),
        ("{a}", {"a": Quoted(quoted="{b}")}, "“{b}”"),
    ],
)
def test_values_are_written_by_their_quantity(template: str, values: dict[str, Value], said: str) -> None:
    assert row(detail=template).detail(Explanation(code="trust.x", values=values)) == said


def test_the_meaning_of_a_reject_is_that_of_the_registry() -> None:
    for reasons in PARTS.values():
        for kind in reasons:
            if "*" not in kind:
                assert reason_of(kind) is not None and words("de").name("reject", kind)
                assert ENGLISH.name("reject", kind) in {one[kind].meaning for one in PARTS.values() if kind in one}
    assert ENGLISH.name("reject", "receipt of nothing") == "a receipt without its batch, or one that cannot be read"
    assert ENGLISH.name("reject", "of_a_newer_release") == "of a newer release"


def test_the_viewer_decides_language_and_time_zone() -> None:
    silent = explain(Code.MONITOR_SILENT, monitor="motion", since_ns=1_795_000_000 * 10**9)
    assert ENGLISH.detail(silent, timezone(timedelta(hours=2), "EET")) == (
        "no message of Motion conflict since 13:06:40 EET"
    )
    slow = explain("banner.no_fix_slow", lag_s=1.5)
    assert words("de").sentence(slow) == "Keine Position: dieser Rechner ist zu langsam und 1,5 s hinter den Sensoren."
    assert words("de").detail(silent) == ENGLISH.detail(silent), "what a language lacks is said in English as a whole"
    with pytest.raises(ValueError, match="there are en, de, fr"):
        words("xx")


def test_a_sentence_names_a_cause_by_its_clause_and_one_without_a_code_by_its_text() -> None:
    lost = explain(health.Code.LOST, process("core.fusion"))
    no_fix = explain(banner.Code.NO_FIX_CAUSE)
    assert words("de").sentence(no_fix, cause=stated(lost)) == "Keine Position: core.fusion ist ausgefallen."
    assert ENGLISH.sentence(no_fix, cause=stated(lost)) == "No position: core.fusion was lost."
    for told in (Told("of 0.1.0"), Told("of 0.1.0", explain("future.code"))):
        assert words("de").sentence(no_fix, cause=told) == "Keine Position: of 0.1.0."
        assert words("de").told(told) == "of 0.1.0"
    assert ENGLISH.sentence(no_fix) is None, "no cause is given"


@pytest.mark.parametrize(
    "explanation",
    [
        explain("future.code", a=1),
        explain(Code.LEVEL_ABOVE_LIMIT, axis="horizontal"),
        explain(Code.LEVEL_ABOVE_LIMIT, axis=3, level_m="high", limit_m=1.0),
        explain(Code.ACCUSED),
    ],
    ids=["no row", "a value is missing", "values of other types", "no subject"],
)
def test_what_does_not_fit_its_row_has_no_words(explanation: Explanation) -> None:
    assert ENGLISH.detail(explanation) is None
    assert reason(explanation) == explanation.code


@pytest.mark.parametrize(
    "wrong",
    [
        {"code": "no_owner"}, {"code": "Trust.x"}, {"code": "trust."}, {"code": "trust.x y"}, {"code": f"a.{'x' * 64}"},
        {"code": "trust.x", "values": {"A": 1}}, {"code": "trust.x", "values": {"a": "free text"}},
        {"code": "trust.x", "values": {"a": float("nan")}}, {"code": "trust.x", "values": {"a": 1e31}},
        {"code": "trust.x", "values": {"a": True}},
        {"code": "trust.x", "values": {"a": {"quoted": "x" * 81}}},
        {"code": "trust.x", "values": {f"a{k}": k for k in range(13)}},
        {"code": "trust.x", "values": {"a": ("x",) * 33}},
    ],
    ids=str,
)  # fmt: skip
def test_the_contract_checks_the_form_of_codes_and_values(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Explanation.model_validate({"values": {}, **wrong}, strict=True)


VALUES = st.one_of(
    st.integers(-(2**63), 2**63 - 1),
    st.floats(-1e30, 1e30),
    st.sampled_from(["gnss", "motion", "x"]),
    st.builds(Quoted, quoted=st.text(max_size=80)),
    st.builds(Reference, kind=st.sampled_from(ReferenceKind), name=st.text(max_size=64)),
    st.lists(st.sampled_from(["gnss", "x"]), max_size=5).map(tuple),
)


@given(st.sampled_from(sorted(ENGLISH.rows)), st.data())
def test_whatever_the_values_are_rendering_ends_in_text_or_in_none(code: str, data: st.DataObject) -> None:
    names = {match[1] for field in FIELDS for match in PLACEHOLDER.finditer(getattr(ENGLISH.row(code), field))}
    values = {name: data.draw(VALUES) for name in sorted(names - {SUBJECT})}
    made = Explanation(code=code, values=values)
    assert Explanation.model_validate_json(made.model_dump_json()) == made
    for language in LANGUAGES:
        for said in (words(language).sentence(made, cause=Told("c")), words(language).detail(made)):
            assert said is None or "{" not in PLACEHOLDER.sub("", said) or "“" in said


def test_a_file_with_an_unknown_owner_or_field_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text, error in (("[other.x]\ndetail = ''\n", "owner is not in OWNERS"), ("[trust.x]\nicon = ''\n", "has icon")):
        file = tmp_path / "xx.toml"
        file.write_text(text)
        with pytest.raises(ValueError, match=error):
            words_module._read(file, ENGLISH)
