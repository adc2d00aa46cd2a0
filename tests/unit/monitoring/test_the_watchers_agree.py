"""`monitoring.health` and `monitoring.status` look at the same bus, and must say the same of it."""

import pytest

from services.monitoring.health.topic_watch import TopicWatch
from services.monitoring.status.flow import TopicFlow
from shared.runtime.freshness import limits_of
from shared.topics import BY_NAME, TOPICS, Topic
from tests.support.envelopes import sent
from tests.support.status_world import START_NS, solution

SOLUTIONS = BY_NAME["navigation/solution"]


def both(topic: Topic, latencies_s: list[float]) -> tuple[TopicWatch, TopicFlow]:
    watch, flow = TopicWatch(topic), TopicFlow(topic.name, topic)
    for number, latency_s in enumerate(latencies_s):
        envelope = sent(solution(START_NS), START_NS + round(latency_s * 1e9), "x", 1, number)
        flow.note(envelope)
        watch.take("x", envelope.payload, envelope.received_ns, retained=False)
    flow.roll()
    return watch, flow


@pytest.mark.parametrize("latencies_s", [[], [0.1], [0.1, 0.2], [0.1, 0.2, 0.3, 0.4], [k / 100 for k in range(200)]])
def test_they_measure_the_same_latencies(latencies_s: list[float]) -> None:
    watch, flow = both(SOLUTIONS, latencies_s)

    assert watch.latencies_s() == (flow.latency_p50_s, flow.latency_p99_s)


@pytest.mark.parametrize("topic", [topic for topic in TOPICS if topic.rate_hz], ids=lambda topic: topic.name)
def test_they_call_the_same_age_late_and_stale(topic: Topic) -> None:
    watch, flow, limits = TopicWatch(topic), TopicFlow(topic.name, topic), limits_of(topic)
    assert limits is not None
    watch.newest_ns = flow.updated_ns = START_NS
    for age_s in (0.0, limits.late_after_s, limits.stale_after_s):
        for off_ns in (-1000, 0, 1000):
            now_ns = START_NS + round(age_s * 1e9) + off_ns
            assert watch.freshness(now_ns) is flow.freshness(now_ns)
