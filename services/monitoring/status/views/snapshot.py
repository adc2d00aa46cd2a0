"""The state as JSON for the dashboard: stamps instead of ages, and nothing that a browser would have to derive."""

from math import hypot
from typing import cast

from shared.messages.base import Message
from shared.messages.explanation import Explanation
from shared.messages.gnss import GnssFix, GnssSatellites
from shared.messages.navigation import NavigationSolution, NavigationState, SetUpState, TruthState
from shared.messages.operation import (
    Crossing,
    Freshness,
    ModeState,
    Origin,
    OriginKind,
    Outage,
    ProcessStatus,
    RecordingState,
)
from shared.messages.tachograph import TachographRecords
from shared.messages.trust import TrustState
from shared.messages.uplink import UplinkState
from shared.page.answers import Object
from shared.processes import LAYERS, PROCESSES
from shared.runtime.freshness import limits_of
from shared.topics import TOPICS
from shared.words.words import translated, words

from ..flow import TopicFlow
from ..state import State
from . import hypotheses as hypothesis_views
from . import simulation as simulation_views
from . import toll
from . import trust as trust_views
from .banner import WORDS
from .geometry import ellipse_95, horizontal_sd, offset_m, vertical_sd
from .height import above_sea
from .models.dashboard import (
    Banner,
    Chain,
    Contract,
    Dashboard,
    OdometerShown,
    OriginShown,
    ProcessContract,
    ProcessShown,
    SatelliteCount,
    SolutionShown,
    TopicContract,
    TopicShown,
    TruthShown,
)
from .models.dashboard import State as StateShown
from .models.trust import TrustShown
from .models.unit import OutageRow, ProblemRow, Traffic

SENSORS = tuple(topic.name for topic in TOPICS if topic.name.endswith("/raw"))
RUNNING = (ProcessStatus.READY, ProcessStatus.LATE, ProcessStatus.RESTARTING)
OUTAGES_SHOWN = 50


def contract() -> Contract:
    """The constant part: layers, processes, topics with their limits."""
    topics: dict[str, TopicContract] = {}
    for topic in TOPICS:
        limits = limits_of(topic)
        topics[topic.name] = {
            "type": topic.message.__name__,
            "purpose": topic.purpose,
            "producers": () if topic.per_process else topic.producers,
            "consumers": topic.consumers,
            "rate_hz": topic.rate_hz,
            "late_after_s": limits.late_after_s if limits else None,
            "stale_after_s": limits.stale_after_s if limits else None,
            "qos": topic.qos,
            "retain": topic.retain,
        }
    processes: dict[str, ProcessContract] = {
        row.name: {"layer": row.layer, "purpose": row.purpose, "observes_all": row.observes_all} for row in PROCESSES
    }
    return {"layers": tuple(LAYERS), "processes": processes, "topics": topics}


def dashboard(state: State, now_ns: int) -> Dashboard:
    """Draw up what the dashboard shows; every value with the stamp from which its age follows."""
    topics = {name: _topic(state, flow) for name, flow in state.topics.items()}
    return {**common(state, now_ns), "topics": topics}


def common(state: State, now_ns: int) -> StateShown:
    """Draw up what dashboards and programs see alike: all but the topics."""
    return {
        "now_ns": now_ns,
        "vehicle": state.vehicle,
        "toll": toll.plaza(state, now_ns),
        "started_ns": state.started_ns,
        "origin": origin(state, now_ns),
        "banner": banner(state),
        "trust": trust(state, now_ns),
        "timeline": [{"since_ns": ns, "state": shown} for ns, shown in state.trust_history.changes],
        "chain": chain(state, now_ns),
        "solution": _solution(state, now_ns),
        "fix": _fix(state, now_ns),
        "satellites": _satellites(state, now_ns),
        "odometer": _odometer(state, now_ns),
        "truth": _truth(state, now_ns),
        "simulation": simulation_views.simulation(state, now_ns),
        "navigation": _dated(state, "navigation/state", NavigationState, now_ns),
        "set_up": _dated(state, "navigation/set_up", SetUpState, now_ns),
        "mode": _dated(state, "mode/state", ModeState, now_ns),
        "tachograph": _dated(state, "tachograph/records", TachographRecords, now_ns),
        "crossing": _dated(state, "mode/crossing", Crossing, now_ns),
        "recording": _dated(state, "recording/state", RecordingState, now_ns),
        "uplink": _dated(state, "uplink/state", UplinkState, now_ns),
        "processes": processes(state, now_ns),
        "problems": problems(state),
        "outages": [outage_row(outage) for outage in outages(state)[:OUTAGES_SHOWN]],
        "bus": {
            "messages_hz": round(sum(flow.rate_hz for flow in state.topics.values()), 1),
            "delay_p95_s": rounded(state.bus_delay_p95_s, 5),
            "cpu_share": round(sum(p.cpu_share or 0.0 for p in state.processes.values()), 2),
            "memory_bytes": sum(p.memory_bytes or 0 for p in state.processes.values()),
        },
    }


def banner(state: State) -> Banner:
    """Show the verdict, since when, and the checks behind it."""
    verdict = state.verdict
    return {
        "state": verdict.state,
        "word": WORDS[verdict.state],
        "sentence": verdict.sentence,
        "action": verdict.action,
        "languages": {name: {"sentence": line.sentence, "action": line.action} for name, line in verdict.lines.items()},
        "reasons": list(verdict.reasons),
        "since_ns": verdict.since_ns,
        "row": verdict.row,
        "checks": [
            {
                "name": c.name,
                "label": c.label,
                "state": c.state,
                "text": c.text,
                "ratio": c.ratio,
                "link": c.link,
                "kind": c.kind,
            }
            for c in verdict.checks
        ],
    }


def trust(state: State, now_ns: int) -> TrustShown:
    """Show the newest verdict, monitors, hypotheses, and the changes since this process started, newest first."""
    message = state.newest(TrustState, "trust/state", now_ns)
    beliefs = () if message is None else message.beliefs
    return {
        "verdict": None if message is None else trust_views.verdict(message, state.topics["trust/state"].updated_ns),
        "monitors": {} if message is None else trust_views.monitors(message),
        "hypotheses": hypothesis_views.table(beliefs, state.hypotheses(now_ns)),
        "events": [trust_views.event(change) for change in reversed(state.trust_events)],
    }


def origin(state: State, now_ns: int) -> OriginShown | None:
    """Origin of the data; with one simulated source among live ones it is simulated."""
    order = (OriginKind.SIMULATED, OriginKind.REPLAY, OriginKind.LIVE)
    known = [(order.index(message.kind), message, ns) for message, ns in state.live_origins(now_ns)]
    if not known:
        return None
    message: Origin = min(known, key=lambda entry: entry[0])[1]
    return {"kind": message.kind, "name": message.name, "seed": message.seed, "speed": message.speed}


def chain(state: State, now_ns: int) -> Chain:
    """Show the links behind the server, each with how much of it works: broker, services, sensors; None is unknown."""
    judgement = state.judgement
    expected = [name for name, status in judgement.statuses.items() if status is not ProcessStatus.ABSENT]
    up = [name for name in expected if judgement.statuses[name] in RUNNING]
    sensors = {name: judgement.topics[name].freshness for name in SENSORS if name in judgement.topics}
    flowing = [name for name, freshness in sensors.items() if freshness in (Freshness.FRESH, Freshness.LATE)]
    silent = [name for name, freshness in sensors.items() if freshness is Freshness.STALE]
    known = judgement.complete or not judgement.problems
    return {
        "broker": {"ok": state.broker, "text": "connected" if state.broker else "does not answer"},
        "services": {
            "ok": not judgement.down if known else None,
            "up": len(up),
            "of": len(expected),
            "worst": judgement.down[0] if judgement.down else None,
        },
        "sensors": {
            "ok": bool(flowing) and not silent if known else None,
            "up": len(flowing),
            "of": len(flowing) + len(silent),
            "worst": silent[0].removesuffix("/raw") if silent else None,
        },
    }


def processes(state: State, now_ns: int) -> dict[str, ProcessShown]:
    """Show each process with its state, its load, and the latency of what it says most often.

    Of what it says regularly, if there is any: a topic of events may tell of data that waited on purpose.
    """
    rows: dict[str, ProcessShown] = {}
    for name, flow in state.processes.items():
        said = [t for t in state.topics.values() if t.producer == name and not t.topic.per_process]
        main = max(said, key=lambda t: (t.limits is not None, t.rate_hz), default=None)
        health = flow.health
        rows[name] = {
            "status": state.judgement.statuses[name],
            "heartbeat_ns": flow.heartbeat_ns,
            "since_ns": health.incarnation if health else None,
            "restarts": state.judgement.restarts.get(name, 0),
            "in_hz": rounded(flow.in_hz, 1),
            "out_hz": rounded(flow.out_hz, 1),
            "latency_of": main.name if main else None,
            "latency_p50_s": rounded(main.latency_p50_s, 4) if main else None,
            "latency_p99_s": rounded(main.latency_p99_s, 4) if main else None,
            "cpu_share": rounded(flow.cpu_share, 3),
            "memory_bytes": flow.memory_bytes,
            "dropped": health.dropped if health else 0,
            "rejects": dict(health.rejects) if health else {},
            "reject_names": {kind: words().name("reject", kind) for kind in health.rejects} if health else {},
            "kinds": [kind.model_dump(mode="json") for kind in flow.kinds],
            "reconnections": health.reconnections if health else 0,
            "last_error": flow.last_error,
        }
    return rows


def problems(state: State) -> list[ProblemRow]:
    """List what is wrong now, each with the topics that it silences."""
    return [
        {
            "what": problem.what,
            "text": problem.text,
            "text_code": _plain(problem.text_code),
            "since_ns": problem.since_ns,
            "affected": list(problem.affected),
            "languages": translated(problem.text, problem.text_code),
        }
        for problem in state.judgement.problems
    ]


def outages(state: State) -> list[Outage]:
    """List the outages: open ones first, then the newest."""
    open_ = [problem.outage for problem in state.judgement.problems if problem.outage is not None]
    return [*open_, *(outage for outage in state.outages.closed() if not _same(outage, open_))]


def outage_row(outage: Outage) -> OutageRow:
    """Show an outage, with its cause in every language."""
    return {
        "what": outage.what,
        "since_ns": outage.since_ns,
        "until_ns": outage.until_ns,
        "cause": outage.cause,
        "cause_code": _plain(outage.cause_code),
        "affected": list(outage.affected),
        "languages": translated(outage.cause, outage.cause_code),
    }


def _plain(code: Explanation | None) -> Object | None:
    return None if code is None else code.model_dump(mode="json")


def _topic(state: State, flow: TopicFlow) -> TopicShown:
    """Show how one topic flows; marked where its newest message is from before a restart, and not live."""
    shown = cast("TopicShown", traffic(flow))
    if state.is_earlier(flow.name):
        shown["earlier"] = True
    return shown


def traffic(flow: TopicFlow) -> Traffic:
    """Show how one topic flows."""
    return {
        "updated_ns": flow.updated_ns,
        "rate_hz": round(flow.rate_hz, 2),
        "latency_p50_s": rounded(flow.latency_p50_s, 4),
        "latency_p99_s": rounded(flow.latency_p99_s, 4),
    }


def _dated(state: State, name: str, kind: type[Message], now_ns: int) -> Object | None:
    message = state.newest(kind, name, now_ns)
    if message is None:
        return None
    return {**message.model_dump(mode="json"), "updated_ns": state.topics[name].updated_ns}


def _solution(state: State, now_ns: int) -> SolutionShown | None:
    s = state.newest(NavigationSolution, "navigation/solution", now_ns)
    if s is None:
        return None
    ellipse, sea = ellipse_95(s.position_cov_ned_m2), above_sea(state, s)
    return {
        "updated_ns": state.topics["navigation/solution"].updated_ns,
        "sampled_ns": s.sampled_ns,
        "phase": s.phase,
        "latitude_deg": round(s.latitude_deg, 9),
        "longitude_deg": round(s.longitude_deg, 9),
        "height_ellipsoid_m": round(s.height_ellipsoid_m, 3),
        "height_msl_m": sea.height_m,
        "geoid": sea.geoid,
        "geoid_sd_m": sea.geoid_sd_m,
        "height_sd_m": round(vertical_sd(s.position_cov_ned_m2), 3),
        "speed_m_s": round(hypot(*s.velocity_ned_m_s[:2]), 3),
        "speed_sd_m_s": round(horizontal_sd(s.velocity_cov_ned_m2_s2), 3),
        "heading_rad": round(s.yaw_rad, 5),
        "heading_sd_rad": round(vertical_sd(s.attitude_cov_ned_rad2), 5),
        "stationary": s.stationary,
        "gnss_age_s": rounded(s.gnss_age_s, 2),
        "protection_level_horizontal_m": rounded(s.protection_level_horizontal_m, 3),
        "protection_level_vertical_m": rounded(s.protection_level_vertical_m, 3),
        "integrity_risk": s.integrity_risk,
        "ellipse": {
            "semi_major_m": round(ellipse.semi_major_m, 3),
            "semi_minor_m": round(ellipse.semi_minor_m, 3),
            "orientation_rad": round(ellipse.orientation_rad, 4),
        },
    }


def _fix(state: State, now_ns: int) -> Object | None:
    """Show the newest fix, and how far it is from the solution when moved to the same moment."""
    fields = _dated(state, "gnss/fix", GnssFix, now_ns)
    solution = state.newest(NavigationSolution, "navigation/solution", now_ns, live=True)
    fix = state.newest(GnssFix, "gnss/fix", now_ns, live=True)
    offset = offset_m(solution, fix) if solution and fix else None
    if fields is None:
        return None
    shown = {key: value for key, value in fields.items() if "cov" not in key}
    return {
        **shown,
        "north_m": round(-offset[0], 3) if offset else None,
        "east_m": round(-offset[1], 3) if offset else None,
    }


def _satellites(state: State, now_ns: int) -> SatelliteCount | None:
    message = state.newest(GnssSatellites, "gnss/satellites", now_ns)
    if message is None:
        return None
    return {
        "in_view": len(message.satellites),
        "used": sum(satellite.used for satellite in message.satellites),
        "updated_ns": state.topics["gnss/satellites"].updated_ns,
    }


def _odometer(state: State, now_ns: int) -> OdometerShown | None:
    found = state.odometer(now_ns)
    if found is None:
        return None
    return {"speed_m_s": round(found[0], 3), "topic": found[1], "updated_ns": state.topics[found[1]].updated_ns}


def _truth(state: State, now_ns: int) -> TruthShown | None:
    truth = state.newest(TruthState, "truth/state", now_ns, live=True)
    if truth is None:
        return None
    solution = state.newest(NavigationSolution, "navigation/solution", now_ns, live=True)
    error = offset_m(solution, truth) if solution else None
    return {
        "updated_ns": state.topics["truth/state"].updated_ns,
        "latitude_deg": round(truth.latitude_deg, 9),
        "longitude_deg": round(truth.longitude_deg, 9),
        "speed_m_s": round(hypot(*truth.velocity_ned_m_s[:2]), 3) if truth.velocity_ned_m_s else None,
        "error_north_m": round(error[0], 3) if error else None,
        "error_east_m": round(error[1], 3) if error else None,
    }


def _same(outage: Outage, others: list[Outage]) -> bool:
    return any((outage.what, outage.since_ns) == (other.what, other.since_ns) for other in others)


def rounded(value: float | None, digits: int) -> float | None:
    """Round what is there."""
    return None if value is None else round(value, digits)
