"""The words of codes: complete in every language, short enough, data alone, and what is shown where they do not fit."""

import ast
from collections.abc import Iterable, Iterator
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
from services.controller.settings import codes as settings
from services.core.cooperative.codes import Code as SatelliteCode
from services.core.evidence.codes import Code as EvidenceCode
from services.core.evidence.monitor import EvidenceMonitor, Part
from services.core.fusion.codes import Code as FusionCode
from services.core.fusion.codes import Direction, HeadingMethod
from services.core.motion_conflict.codes import Code as MotionCode
from services.core.spoofing.codes import Code as InertialCode
from services.core.spoofing.drift.monitor import NAMES
from services.core.spoofing.drift.monitor import Part as Axes
from services.core.spoofing.gyroscope.vote import Source
from services.core.spoofing.profile import ProfileCondition
from services.core.toll import codes as toll
from services.core.trust.codes import Code
from services.core.trust.facts import Monitor
from services.monitoring.health import codes as health
from services.monitoring.ledger import codes as ledger
from services.monitoring.recorder import codes as recorder
from services.monitoring.status.views import codes as banner
from services.monitoring.status.views.banner import Trust
from shared.bus import codes as broker
from shared.messages.explanation import Explanation, QuotedText, Reference, ReferenceKind, Value, explain, process
from shared.messages.gnss import InterferenceState
from shared.messages.navigation import NavigationPhase
from shared.messages.trust import Hypothesis
from shared.rejects import PARTS, reason_of
from shared.settings import check
from shared.trust.inputs import Input
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
    CodedText,
    Row,
    Words,
    reason,
    said,
    stated,
    words,
)
from tests.support.cases import each
from tests.support.words import FIELDS, FILE, lines, texts

ENGLISH = words()
CODES: dict[str, type[StrEnum]] = {
    "trust": Code,
    "fusion": FusionCode,
    "spoofing": InertialCode,
    "motion": MotionCode,
    "evidence": EvidenceCode,
    "cooperative": SatelliteCode,
    "banner": banner.Code,
    "broker": broker.Code,
    "health": health.Code,
    "toll": toll.Code,
    "ledger": ledger.Code,
    "fleet": fleet.Code,
    "import": importing.Code,
    "solve": solve.Code,
    "recorder": recorder.Code,
    "settings": settings.Code,
    "setting": check.Code,
}
FIGURES = {"statistic", "threshold", "window_s"}  # of the test that an explanation belongs to, in its unit
MONITORS = ("spoofing", "motion", "evidence", "cooperative")
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


@each("owner", CODES)
def test_every_code_has_a_row_and_every_row_is_of_a_code(owner: str) -> None:
    rows = {code for code in ENGLISH.rows if code.startswith(f"{owner}.")}
    assert rows == {str(code) for code in CODES[owner]}, f"see {OWNERS[owner]}/words.toml and its codes"


@pytest.mark.parametrize("language", [name for name in LANGUAGES if name != "en"])
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


@each(("language", "code"), ROWS)
def test_a_sentence_is_one_line_without_figures_and_short_with_its_longest_values(language: str, code: str) -> None:
    spoken = words(language)
    said = texts(code, spoken)
    if text := said["sentence"]:
        assert len(text) <= SENTENCE_MAXIMUM.get(language, 110), text
        assert text.endswith(".") and "\n" not in text and "{" not in text
    detail = said["detail"]
    assert detail is None or (len(detail) <= REASON_LENGTH and "{" not in detail)
    assert said["sentence"] or detail, "it says something"


@each(("language", "code"), ROWS)
def test_a_placeholder_names_a_quantity_that_fits_its_value_or_a_table_that_exists(language: str, code: str) -> None:
    spoken = words(language)
    for field in FIELDS:
        for name, kind, _ in PLACEHOLDER.findall(getattr(spoken.row(code), field)):
            if kind in QUANTITIES:
                assert name in FIGURES or name.endswith(QUANTITIES[kind][0]), f"{code}: {name} is not {kind}"
            elif kind == INSTANT:
                assert name.endswith(INSTANT_ENDING)
            elif kind and kind != CLAUSE:
                assert kind in ENGLISH.names, f"{code}: there is no quantity and no table {kind}"
            assert field != "sentence" or kind not in ("distance", "speed", "number", "share"), (
                "no figures for a driver"
            )


@pytest.mark.parametrize("owner", MONITORS)
def test_every_code_is_made_with_the_values_that_its_words_name(owner: str) -> None:
    made = {str(CODES[owner][name]): values for name, values in explained(REPOSITORY / OWNERS[owner])}
    assert made.keys() == {str(code) for code in CODES[owner]}, "a code that nothing makes"
    for name, values in explained(REPOSITORY / OWNERS[owner]):
        row = ENGLISH.row(CODES[owner][name])
        named = {match[1] for field in FIELDS for match in PLACEHOLDER.finditer(getattr(row, field))}
        assert values is None or named <= values | FIGURES, f"{CODES[owner][name]}: {named - values} are not given"


def test_all_rendered_sentences_are_those_that_were_reviewed() -> None:
    assert FILE.read_text(encoding="utf-8").splitlines() == list(lines()), "`make golden`, and review the difference"


ENUMERATIONS: dict[str, Iterable[str]] = {
    "monitor": Monitor,
    "source": [Hypothesi for Hypothesi in Hypothesis if Hypothesi is not Hypothesis.NOTHING],
    "hypothesis": [Hypothesi for Hypothesi in Hypothesis if Hypothesi is not Hypothesis.NOTHING],
    "phase": NavigationPhase,
    "state": Trust,
    "direction": Direction,
    "heading_method": HeadingMethod,
    "input": Input,
    "origin": ProfileCondition,
    "yaw_source": Source,
    "axes": [Axes.NORTH_AND_EAST, Axes.ALONG_AND_ACROSS],
    "innovation": NAMES.values(),
    "evidence_test": EvidenceMonitor().tests,
    "receiver_part": Part,
    "interference": [
        interference_state
        for interference_state in InterferenceState
        if interference_state is not InterferenceState.UNKNOWN
    ],
}


@each("table", ENUMERATIONS)
def test_every_word_of_an_enumeration_has_a_name(table: str) -> None:
    assert set(ENGLISH.names[table]) == {str(word) for word in ENUMERATIONS[table]}


def explained(folder: Path) -> Iterator[tuple[str, set[str] | None]]:
    """Yield each code that the processes of a folder make, with the names of its values; None where others give them.

    A code is an argument of `explain`, of what makes the message of a missing input, or chosen before by a name.
    """
    for path in sorted(folder.rglob("*.py")):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(function, ast.FunctionDef):
                continue
            given = [call for call in ast.walk(function) if isinstance(call, ast.Call) and name_of(call) == "explain"]
            of_calls = set()
            for call in given:
                codes = codes_in(call.args[0]) or {
                    code
                    for item in ast.walk(function)
                    if isinstance(item, ast.Assign)
                    and ast.dump(call.args[0]) in ast.dump(item).replace("Store", "Load")
                    for code in codes_in(item.value)
                }
                values = {word.arg for word in call.keywords if word.arg} | ({SUBJECT} if len(call.args) > 1 else set())
                of_calls |= codes
                yield from ((code, None if any(not word.arg for word in call.keywords) else values) for code in codes)
            yield from ((code, None) for code in codes_in(function) - of_calls)


def name_of(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else ""


def codes_in(tree: ast.AST) -> set[str]:
    """Find the members of an enumeration `Code`."""
    return {
        item.attr
        for item in ast.walk(tree)
        if isinstance(item, ast.Attribute) and isinstance(item.value, ast.Name) and item.value.id == "Code"
    }


def row(**changes: str) -> Words:
    return Words("en", {"trust.x": Row(**changes)}, ENGLISH.names, ENGLISH.format)


@each(
    ("template", "values", "said"),
    [
        ("{a_m:distance}", {"a_m": 12.34}, "12.3 m"),
        ("{a_m_s:speed}", {"a_m_s": -3.25}, "-3.2 m/s"),
        ("{a_m_s:speed}", {"a_m_s": -0.034}, "-0.03 m/s"),
        ("{a_m_s:speed}", {"a_m_s": -0.0004}, "0.00 m/s"),
        ("{a_m_s2:acceleration}", {"a_m_s2": 0.0123}, "0.012 m/s²"),
        ("{a_m:length}", {"a_m": 0.123}, "0.12 m"),
        ("{a_deg_s:turn_rate}", {"a_deg_s": -0.317}, "-0.32°/s"),
        ("{a_s:time_offset}", {"a_s": -0.00125}, "-0.001 s"),
        ("{a_s:clock_offset}", {"a_s": 2e-7}, "200 ns"),
        ("{a_ratio:clock_drift}", {"a_ratio": -1e-10}, "0 ns/s"),
        ("{a_ratio:ratio}", {"a_ratio": 1.0123}, "1.012"),
        ("{a_db_hz:carrier_to_noise}", {"a_db_hz": 44.06}, "44.1 dB-Hz"),
        ("{a_db:level_difference}", {"a_db": 2.04}, "2.0 dB"),
        ("{path_number:number}", {"path_number": 1}, "1"),
        ("{a_rad:angle}", {"a_rad": 0.5}, "28.6°"),
        ("{a_deg:angle}", {"a_deg": 0.5}, "0.5°"),
        ("{a_s:duration}", {"a_s": 6.24}, "6.2 s"),
        ("{a_s:duration}", {"a_s": 412.4}, "412 s"),
        ("{a_s:duration}", {"a_s": 612.4}, "10 min"),
        ("{a_s:duration}", {"a_s": 86400}, "24 h"),
        ("{share:share}", {"share": 25.0}, "2500 %"),
        ("{count:number}", {"count": 999.6}, "1000"),
        ("{a_ratio:factor}", {"a_ratio": 0.98765}, "0.988"),
        ("{a_s:duration}", {"a_s": 6}, "6 s"),
        ("{a_s:duration}", {"a_s": 5.0}, "5 s"),
        ("{probability:share}", {"probability": 0.625}, "62.5 %"),
        ("{a_ns:instant}", {"a_ns": 1_795_000_000_500_000_000}, "11:06:40 UTC"),
        ("{a:monitor}", {"a": "motion"}, "Motion conflict"),
        ("{a:monitor}", {"a": "of_a_newer_release"}, "of a newer release"),
        ("{a:source}", {"a": ("gnss", "imu", "odometer")}, "GNSS, the inertial sensors or the odometer"),
        ("{a:source:and}", {"a": ("gnss", "imu")}, "GNSS and the inertial sensors"),
        ("{a}", {"a": (Reference(kind=ReferenceKind.NEIGHBOUR, name="17"),)}, "neighbour 17"),
        (
            "{a:and}",
            {
                "a": (
                    Reference(kind=ReferenceKind.SATELLITE, name="G05"),
                    Reference(kind=ReferenceKind.SATELLITE, name="E11"),
                )
            },
            "G05 and E11",
        ),
        ("{a}", {"a": Reference(kind=ReferenceKind.LANE, name="n1")}, "lane n1"),
        ("{a}", {"a": Reference(kind=ReferenceKind.PROCESS, name="core.trust")}, "core.trust"),
        ("{a}", {"a": ()}, "no source by name"),
        ("{a:and}", {"a": (Reference(kind=ReferenceKind.TOPIC, name="gnss/raw"),) * 2}, "gnss/raw and gnss/raw"),
        ("{a_bytes:size}", {"a_bytes": 512_000}, "512 kB"),
        ("{a_bytes:size}", {"a_bytes": 300_000_000}, "300 MB"),
        ("{a}", {"a": QuotedText(quoted="{b}")}, "“{b}”"),
    ],
)
def test_values_are_written_by_their_quantity(template: str, values: dict[str, Value], said: str) -> None:
    assert row(detail=template).detail(Explanation(code="trust.x", values=values)) == said


def test_the_meaning_of_a_reject_is_that_of_the_registry() -> None:
    for reasons in PARTS.values():
        for kind in reasons:
            if "*" not in kind:
                assert reason_of(kind) is not None and words("de").name("reject", kind)
                assert ENGLISH.name("reject", kind) in {
                    mapping[kind].meaning for mapping in PARTS.values() if kind in mapping
                }
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
    for told in (CodedText("of 0.1.0"), CodedText("of 0.1.0", explain("future.code"))):
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


@each(
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
)  # fmt: skip
def test_the_contract_checks_the_form_of_codes_and_values(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Explanation.model_validate({"values": {}, **wrong}, strict=True)


VALUES = st.one_of(
    st.integers(-(2**63), 2**63 - 1),
    st.floats(-1e30, 1e30),
    st.sampled_from(["gnss", "motion", "x"]),
    st.builds(QuotedText, quoted=st.text(max_size=80)),
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
        for text in (words(language).sentence(made, cause=CodedText("c")), words(language).detail(made)):
            assert text is None or "{" not in PLACEHOLDER.sub("", text) or "“" in text


def test_a_file_with_an_unknown_owner_or_field_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text, error in (("[other.x]\ndetail = ''\n", "owner is not in OWNERS"), ("[trust.x]\nicon = ''\n", "has icon")):
        file = tmp_path / "xx.toml"
        file.write_text(text)
        with pytest.raises(ValueError, match=error):
            words_module._read(file, ENGLISH)


@pytest.mark.parametrize(
    ("code", "shown"),
    [
        (None, "statistic since 1795000000.5 s of gnss"),
        (explain(Code.CONFLICT), "GNSS has not agreed for long enough after a conflict"),
        (explain("future.code", a=1), "statistic since 1795000000.5 s of gnss"),
    ],
    ids=["without a code", "with one", "with one that has no row"],
)
def test_a_message_is_shown_by_its_code_else_by_its_text_as_it_is(code: Explanation | None, shown: str) -> None:
    assert said("statistic since 1795000000.5 s of gnss", code) == shown


def test_a_code_without_row_and_text_is_shown_itself() -> None:
    assert said("", explain("future.code")) == "future.code"
