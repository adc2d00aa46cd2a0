"""Which messages a replay publishes."""

from services.sensors.replay.selection import MAX_RATE_HZ, Thinning, playable, shown

S = 1_000_000_000


def kept(topic: str, rate_hz: float, speed: float, seconds: int = 10) -> int:
    thinning = Thinning()
    return sum(thinning.keeps(topic, round(k / rate_hz * S), speed) for k in range(round(seconds * rate_hz)))


def test_at_ordinary_speed_every_message_is_published() -> None:
    assert kept("imu/sample", 100.0, 2.0) == 1000


def test_a_fast_replay_publishes_a_bounded_rate() -> None:
    assert kept("imu/sample", 100.0, 10.0) <= 10 * MAX_RATE_HZ / 10.0 + 1
    assert kept("navigation/solution", 10.0, 10.0) in range(15, 22)


def test_states_and_events_are_published_at_any_speed() -> None:
    assert kept("trust/event", 10.0, 100.0) == 100
    assert kept("trust/state", 1.0, 100.0) == 10


def test_a_replay_publishes_its_own_origin_and_nothing_outside_the_contract() -> None:
    topics = {"gnss/fix", "origin/state", "replay/state", "imu/raw", "consumed/core.fusion", "foxglove/location_fix"}
    assert playable(topics) == {"gnss/fix", "imu/raw", "consumed/core.fusion"}
    assert shown(topics) == {"gnss/fix"}
