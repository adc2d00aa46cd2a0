"""The state as JSON for programs: health against the deadlines, everything at once, one topic, the outages."""

from shared.errors import BadPayload
from shared.messages.base import Message, RawBytes

from ..flow import TopicFlow
from ..problems import DOWN, Status
from ..state import State
from .snapshot import Json, dashboard, rounded, traffic

BYTES_SHOWN = 512


def health(state: State, now_ns: int) -> Json:
    """Hold every topic and process against its deadline."""
    if state.broker_lost(now_ns):
        overall = "failed"
    else:
        overall = "degraded" if state.problems or state.verdict.state == "stale" else "ok"
    return {
        "state": overall,
        "now_ns": now_ns,
        "broker": state.broker,
        "position": {"state": state.verdict.state, "sentence": state.verdict.sentence},
        "problems": [{"what": p.what, "text": p.text, "since_ns": p.since_ns} for p in state.problems],
        "processes": {
            name: {
                "status": status,
                "ok": status not in DOWN,
                "heartbeat_age_s": rounded(_age_s(state.processes[name].heartbeat_ns, now_ns), 3),
            }
            for name, status in state.statuses.items()
            if status is not Status.ABSENT
        },
        "topics": {
            name: {"freshness": flow.freshness(now_ns), "age_s": rounded(flow.age_s(now_ns), 3)}
            for name, flow in state.topics.items()
        },
    }


def snapshot(state: State, now_ns: int) -> Json:
    """Give everything at once: the dashboard's view and the newest message of every topic."""
    topics = {name: topic(flow, now_ns) for name, flow in state.topics.items()}
    return {**dashboard(state, now_ns), "topics": topics}


def topic(flow: TopicFlow, now_ns: int) -> Json:
    """Show one topic: its newest message, rate, jitter, size and age; or why that message cannot be read."""
    message, unreadable = None, None
    try:
        message = _readable(flow.decoded()) if flow.newest else None
    except BadPayload as error:  # a fast topic is decoded only here
        unreadable = str(error)
    return {
        "topic": flow.name,
        "type": flow.topic.message.__name__,
        "purpose": flow.topic.purpose,
        "producer": flow.newest.producer if flow.newest else None,
        "freshness": flow.freshness(now_ns),
        "age_s": rounded(flow.age_s(now_ns), 3),
        **traffic(flow),
        "jitter_s": rounded(flow.jitter_s, 5),
        "bytes": len(flow.newest.payload) if flow.newest else None,
        "sequence": flow.newest.sequence if flow.newest else None,
        "retained": flow.topic.retain,
        "qos": flow.topic.qos,
        "unreadable": unreadable,
        "message": message,
    }


def _readable(message: Message) -> Json:
    """Show a message as JSON, and the bytes of a device as hexadecimal and text."""
    if not isinstance(message, RawBytes):
        return message.model_dump(mode="json")
    head = message.data[:BYTES_SHOWN]
    return {
        "received_ns": message.received_ns,
        "source": message.source,
        "bytes": len(message.data),
        "hexadecimal": head.hex(" "),
        "text": "".join(chr(b) if 32 <= b < 127 else "." for b in head),
    }


def outages(state: State) -> Json:
    """List what is lost now, and what was lost and is back."""
    return {
        "open": [outage.model_dump(mode="json") for outage in state.outages.open()],
        "closed": [outage.model_dump(mode="json") for outage in state.outages.closed()],
    }


def _age_s(stamp_ns: int | None, now_ns: int) -> float | None:
    return None if stamp_ns is None else (now_ns - stamp_ns) * 1e-9
