"""The state as JSON for programs: health against the deadlines, everything at once, one topic, the outages."""

from shared.errors import BadPayload
from shared.messages.base import Message, RawBytes
from shared.messages.operation import ProcessStatus
from shared.messages.trust import TrustState
from shared.page.answers import Object

from ..flow import TopicFlow
from ..state import State
from . import hypotheses as hypothesis_views
from . import snapshot as views
from .banner import WORDS, Trust
from .models.dashboard import DashboardState
from .models.trust import HypothesesReport, TrustReport
from .models.unit import Health, Outages, Topic
from .snapshot import common, rounded, traffic

BYTES_SHOWN = 512


def health(state: State, now_ns: int) -> Health:
    """Give the judgement of `monitoring.health`, or why there is none."""
    judgement = state.judgement
    lost = any(problem.what == "broker" for problem in judgement.problems) and not judgement.complete
    verdict = state.verdict
    degraded = judgement.problems or verdict.state not in (Trust.SAFE, Trust.CAUTION)
    return {
        "state": "failed" if lost else "degraded" if degraded else "ok",
        "now_ns": now_ns,
        "broker": state.broker,
        "position": {
            "state": verdict.state,
            "word": WORDS[verdict.state],
            "sentence": verdict.sentence,
            "since_ns": verdict.since_ns,
        },
        "problems": views.problems(state),
        "processes": {
            name: {
                "status": status,
                "ok": not status.down and status is not ProcessStatus.UNKNOWN,
                "heartbeat_age_s": rounded(_age_s(state.processes[name].heartbeat_ns, now_ns), 3),
            }
            for name, status in judgement.statuses.items()
            if status is not ProcessStatus.ABSENT
        },
        "topics": {
            name: {"freshness": row.freshness, "age_s": rounded(row.age_s, 3), "cause": row.cause}
            for name, row in judgement.topics.items()
        },
    }


def snapshot(state: State, now_ns: int) -> DashboardState:
    """Give everything at once: the dashboard's view and the newest message of every topic."""
    topics = {name: topic(flow, now_ns) for name, flow in state.topics.items()}
    return {**common(state, now_ns), "topics": topics}


def topic(flow: TopicFlow, now_ns: int) -> Topic:
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
        "producer": flow.producer or None,
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


def _readable(message: Message) -> Object:
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


def trust(state: State, now_ns: int, seconds: float) -> TrustReport:
    """Give verdict, monitors, events, and the history of the last seconds."""
    return {
        "state": state.verdict.state,
        "sentence": state.verdict.sentence,
        **views.trust(state, now_ns),
        "history": state.trust_history.columns(now_ns, seconds),
    }


def hypotheses(state: State, now_ns: int) -> HypothesesReport:
    """Give every hypothesis, the solutions without satellites, and the tracks of the alternatives."""
    message = state.newest(TrustState, "trust/state", now_ns)
    stated = state.hypotheses(now_ns)
    return {
        "now_ns": now_ns,
        "hypotheses": hypothesis_views.table(message.beliefs if message else (), stated),
        "satellites": hypothesis_views.satellites(stated),
        "tracks": hypothesis_views.tracks(state.alternatives.lines(now_ns)),
    }


def outages(state: State) -> Outages:
    """List the outages that are open, and those that are over."""
    rows = [views.outage_row(outage) for outage in views.outages(state)]
    return {
        "open": [row for row in rows if row["until_ns"] is None],
        "closed": [row for row in rows if row["until_ns"] is not None],
    }


def _age_s(stamp_ns: int | None, now_ns: int) -> float | None:
    return None if stamp_ns is None else (now_ns - stamp_ns) * 1e-9
