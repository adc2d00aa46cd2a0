"""Watch sessions; time is an argument."""

import json

import pytest

from services.monitoring.uplink.watching import MAX_LIVE_BYTES, BadWatch, Watch
from shared.fleet.topics import WATCHABLE
from tests.support.cases import each

NS = 1_000_000_000


def request(*topics: str, for_s: float = 30.0, watchers: int = 1) -> bytes:
    return json.dumps({"topics": topics, "for_s": for_s, "watchers": watchers}).encode()


@pytest.mark.parametrize("rate_hz", [6, 10, 20, 100])
def test_a_fast_topic_is_thinned_to_five_messages_a_second_whatever_its_rate(rate_hz: int) -> None:
    watch = Watch()
    watch.take(request("navigation/solution"), NS)
    passed = sum(watch.wants("navigation/solution", b"{}", NS + n * NS // rate_hz) for n in range(10 * rate_hz))
    assert passed <= 52 and (passed >= 48 or rate_hz == 6)


def test_what_every_monitor_publishes_at_the_same_time_is_passed_on_and_a_flood_is_not() -> None:
    watch = Watch()
    watch.take(request("trust/monitor", for_s=60), 100 * NS)
    for second in range(100, 120):
        assert all(watch.wants("trust/monitor", b"{}", second * NS + n) for n in range(5))
    flood = sum(watch.wants("trust/monitor", b"{}", 121 * NS + n * NS // 1000) for n in range(10_000))
    assert flood <= 10 * 5 + 12


def test_a_session_ends_by_its_time_or_by_the_last_watcher_and_is_prolonged() -> None:
    watch = Watch()
    watch.take(request("gnss/fix", for_s=10), NS)
    watch.take(request("gnss/fix", for_s=10), 8 * NS)
    assert watch.is_on(17 * NS) and not watch.is_on(18 * NS)
    assert not watch.wants("gnss/fix", b"", 18 * NS)
    watch.take(request("gnss/fix"), 20 * NS)
    watch.take(request("gnss/fix", watchers=0), 21 * NS)
    assert not watch.is_on(21 * NS)


def test_only_what_may_be_watched_and_is_not_too_large_is_passed_on() -> None:
    watch = Watch()
    watch.take(request("gnss/fix", "toll/transaction", "gnss/raw", "#", "../x"), NS)
    assert watch.topics == {"gnss/fix"} and "gnss/raw" not in WATCHABLE
    assert not watch.wants("gnss/fix", bytes(MAX_LIVE_BYTES + 1), NS)
    assert not watch.wants("gnss/raw", b"", NS)


@each(
    "payload",
    [
        b"", b"[]", b"{}", b"\xff", b"[" * 4000, b"1" * 5000, request(for_s=61), request(for_s=-1),
        request(watchers=-1), request(watchers=10**9), b'{"topics": "gnss/fix", "for_s": 1, "watchers": 1}',
        b'{"topics": [], "for_s": NaN, "watchers": 1}',
    ],
)  # fmt: skip
def test_a_request_that_is_none_is_refused_and_changes_nothing(payload: bytes) -> None:
    watch = Watch()
    watch.take(request("gnss/fix"), NS)
    with pytest.raises(BadWatch):
        watch.take(payload, 2 * NS)
    assert watch.is_on(3 * NS) and watch.topics == {"gnss/fix"}
