"""What the centre's pages say of events and alarms: by codes, and of what has none its own text."""

import pytest

from fleet.alarms.codes import Code, code_of
from fleet.web.told import alarm_with_languages, with_languages
from services.monitoring.uplink.sampling import event_of
from shared.fleet.receipts import REASONS
from shared.messages.explanation import explain, process
from shared.messages.operation import Outage
from shared.words.words import stated, words


def event(**content: object) -> dict[str, dict[str, object]]:
    found: dict[str, dict[str, object]] = with_languages({"name": "x", "content": content})["languages"]
    return found


def test_an_outage_that_a_vehicle_reports_is_told_in_the_language_of_who_looks() -> None:
    lost = stated(explain("health.lost", process("core.fusion")))
    sent = event_of(
        Outage(what="core.fusion", since_ns=1, cause=lost.text, cause_code=lost.code), "outage/event", 5, places=True
    )
    assert sent is not None
    languages = event(**sent.content)
    assert languages["en"]["cause"] == lost.text
    assert languages["de"]["cause"] == "core.fusion ist ausgefallen: abgestürzt, beendet oder ohne Verbindung"


@pytest.mark.parametrize(
    "code",
    [
        None,
        "x",
        {"code": "no_owner"},
        {"code": "future.code", "values": {}},
        {"code": "health.lost", "values": {}},
        [1],
    ],
    ids=str,
)
def test_the_text_of_a_vehicle_is_shown_uncut_where_its_code_has_no_words(code: object) -> None:
    text = "x" * 400
    for language, said in event(cause=text, cause_code=code).items():
        assert said["cause"] == text, language
    assert event(reasons=[text], reason_codes=[code])["de"]["reasons"] == [text]
    monitors = event(monitors=[{"monitor": "motion", "reason": text, "reason_code": code}, 3])["de"]["monitors"]
    assert isinstance(monitors, list) and monitors[0]["reason"] == text and monitors[1] == 3


def test_content_of_an_earlier_release_or_of_another_form_stays_as_it_is() -> None:
    assert event(reasons=["a"], cause="b")["en"] == {}
    assert event(reasons="a", reason_codes=3, monitors={"a": 1})["en"] == {}
    assert with_languages({"content": [1]}) == {"content": [1]}
    assert event(reasons=["a", "b"], reason_codes=[])["en"]["reasons"] == ["a", "b"]


@pytest.mark.parametrize(
    ("kind", "detail", "code", "said"),
    [
        ("unsafe", {}, Code.UNSAFE, "Its verdict is UNSAFE."),
        ("silent", {"after_s": 300}, Code.SILENT, "No report for 300 s."),
        ("gap", {"missing": 4}, Code.MISSING, "4 reports are missing."),
        ("gap", {"dropped": 8}, Code.DROPPED, "8 reports were dropped by a full outbox."),
        ("signature", {"reason": "signature", "count": 3, "last_ms": 1}, Code.SIGNATURE,
         "3 batches were not signed by it (the signature does not fit)."),
        ("flood", {"budget": "tenant", "withheld": 2}, Code.FLOOD,
         "2 batches have no receipt: the budget of the tenant is used up."),
    ],
)  # fmt: skip
def test_an_alarm_is_a_code_with_values(kind: str, detail: dict[str, object], code: Code, said: str) -> None:
    row = alarm_with_languages({"kind": kind, "detail": detail})
    assert row["code"]["code"] == code
    assert row["languages"]["en"] == {"sentence": said}


@pytest.mark.parametrize(
    ("kind", "detail"), [("later", {}), ("silent", {}), ("signature", {"count": 1, "reason": "Free Text"})]
)
def test_an_alarm_of_another_release_has_no_code(kind: str, detail: dict[str, object]) -> None:
    assert code_of(kind, detail) is None
    assert alarm_with_languages({"kind": kind, "detail": detail})["languages"] == {}


def test_every_refusal_has_a_name() -> None:
    assert words().names["refusal"].keys() == {*REASONS, "future", "past"}
