import pytest

from services.monitoring.status.history.columns import CHANGES_MAXIMUM, FINE_HZ, FINE_S, History, TrustHistory

S = 10**9


def filled(seconds: int) -> History:
    history = History(900.0)
    for i in range(int(seconds * FINE_HZ)):
        history.add(int(i / FINE_HZ * S), {"speed_fused_m_s": float(i)})
    return history


def test_the_last_minute_has_five_values_a_second() -> None:
    columns = filled(100).columns(100 * S, 60.0, ["speed_fused_m_s"])
    assert len(columns["time_ns"]) == FINE_S * FINE_HZ


def test_longer_spans_have_one_value_a_second() -> None:
    columns = filled(300).columns(300 * S, 250.0, ["speed_fused_m_s"])
    assert len(columns["time_ns"]) == pytest.approx(250, abs=1)


def test_the_history_is_no_longer_than_asked_for_in_the_settings() -> None:
    history = History(10.0)
    for i in range(500):
        history.add(i * S // 5, {})
    assert len(history.columns(100 * S, 900.0, [])["time_ns"]) == 10


def test_what_was_missing_is_none_and_not_the_last_value() -> None:
    history = History(900.0)
    history.add(0, {"speed_fused_m_s": 3.0})
    history.add(S // 5, {})
    assert history.columns(S, 60.0, ["speed_fused_m_s"])["fields"] == {"speed_fused_m_s": [3.0, None]}


def test_an_unknown_field_is_an_error() -> None:
    with pytest.raises(KeyError, match="colour"):
        History(900.0).columns(0, 60.0, ["colour"])


def test_the_history_of_trust_keeps_changes_and_one_ratio_a_second_and_is_bounded() -> None:
    history = TrustHistory(10.0)
    for i in range(200):
        history.add(i * S // 5, "safe" if i < 100 else "unsafe", {"motion": None if i < 50 else 0.5, "evidence": 0.0})
    columns = history.columns(40 * S, 900.0)
    assert columns["changes"] == [{"since_ns": 0, "state": "safe"}, {"since_ns": 20 * S, "state": "unsafe"}]
    assert len(columns["time_ns"]) == 10
    assert columns["ratios"] == {"motion": [0.5] * 10, "evidence": [0.0] * 10}
    for i in range(2 * CHANGES_MAXIMUM):
        history.add(i, str(i), {})
    assert len(history.changes) == CHANGES_MAXIMUM


def test_a_monitor_that_was_not_evaluated_leaves_a_gap() -> None:
    history = TrustHistory(900.0)
    history.add(0, "safe", {"motion": 0.2})
    history.add(S, "caution", {"motion": None})
    assert history.columns(S, 60.0)["ratios"] == {"motion": [0.2, None]}
