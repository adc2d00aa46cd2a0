"""The toll plaza as JSON for the dashboard: everything in metres north and east of the antenna, with its stamps."""

from typing import TYPE_CHECKING

from shared.messages.explanation import explain
from shared.messages.toll import (
    LedgerState,
    PlazaDescription,
    Position,
    TollDelta,
    TollTrack,
    TollTracks,
)
from shared.messages.v2x import Authentication
from shared.page.answers import Object
from shared.words.words import said, translated

from .banner import Check, Trust, Verdict
from .geometry import ground_offset
from .models.toll import AuthenticationShown, Plaza, PlazaShown, TrackShown

if TYPE_CHECKING:
    from ..state import State


def plaza(state: "State", now_ns: int) -> Plaza | None:
    """Show the plaza, its vehicles and its charges; None in a unit that is no road-side unit."""
    if "core.toll" not in state.expected:
        return None
    description = state.newest(PlazaDescription, "plaza/description", now_ns)
    ledger = state.newest(LedgerState, "ledger/state", now_ns)
    delta = state.newest(TollDelta, "toll/delta", now_ns)
    tracks = state.newest(TollTracks, "toll/tracks", now_ns)
    parser = state.processes["parsers.v2x"].health
    return {
        "plaza": _description(description) if description else None,
        "delta": _dated(delta, state, "toll/delta"),
        "tracks": _tracks(tracks, description) if tracks and description else [],
        "tracks_ns": state.topics["toll/tracks"].updated_ns,
        "cams": tracks.cams if tracks else 0,
        "cam_rejects": sum(parser.rejects.values()) if parser else 0,
        "cam_batches_hz": round(state.topics["v2x/cam"].rate_hz, 1),
        "trust": tracks.trust if tracks else None,
        "gates": {lane: gate.model_dump(mode="json") for lane, gate in state.gates.items()},
        "pulses": dict(state.pulses),
        "ledger": _dated(ledger, state, "ledger/state"),
    }


def verdict(state: "State", now_ns: int, *, broker: bool) -> Verdict:
    """Sentence on whether lanes are decided and passages charged, and if not, why and what to do."""
    ledger = state.newest(LedgerState, "ledger/state", now_ns, live=True)
    delta = state.newest(TollDelta, "toll/delta", now_ns, live=True)
    checks = (_ledger_check(ledger), _delta_check(delta), _accounts_check(ledger), _alarm_check(ledger))
    if not broker:
        return Verdict(Trust.BROKER_LOST, "Nothing is known: the broker does not answer.", "Check the broker.", checks)
    if ledger is None and state.is_awaited("ledger/state", now_ns):
        sentence = "Nothing is known yet: waiting for the first state of the ledger."
        return Verdict(Trust.STARTING, sentence, "If it lasts, the page System shows what does not publish.", checks)
    # What is not closed yet is normal, and decides nothing.
    worst = min((check for check in checks if check.state in _ORDER), key=lambda check: _ORDER.index(check.state))
    sentence, action = _SENTENCES[worst.name, worst.state is Trust.SAFE]
    text = "" if worst.state is Trust.SAFE else f": {worst.text}"
    return Verdict(worst.state, sentence + text, action, checks)


_ORDER = (Trust.UNSAFE, Trust.STALE, Trust.CAUTION, Trust.SAFE)
_SENTENCES = {
    ("ledger", True): ("Passages are charged, and lanes are decided with a valid delta position", "Nothing to do."),
    ("ledger", False): ("Nothing is charged", "See the state of monitoring.ledger; passages wait until it is usable."),
    ("delta", False): (
        "Lanes are decided without a valid delta position",
        "More vehicles stay undecided. Check the unit's own receiver and its antenna.",
    ),
    ("alarms", False): (
        "The plaza is under attack, or a ticket misbehaves",
        "See the alarms on the page Toll, and what toll/alarm has published.",
    ),
    ("accounts", False): (
        "The account of a lane does not agree",
        "Compare the lane's detector with its passages on the page Toll.",
    ),
}


def _ledger_check(ledger: LedgerState | None) -> Check:
    if ledger is None:
        return Check("ledger", "Ledger", Trust.STALE, "no state of the ledger is received", link="toll")
    if ledger.problem:
        return Check("ledger", "Ledger", Trust.UNSAFE, ledger.problem, link="toll")
    waiting = f", {ledger.held} held" if ledger.held else ""
    waiting += f", {ledger.in_review} in review" if ledger.in_review else ""
    waiting += f", {ledger.unconfirmed} not confirmed by a detector" if ledger.unconfirmed else ""
    waiting += f", {ledger.not_authenticated} not authenticated" if ledger.not_authenticated else ""
    text = f"{ledger.transactions} charges, {ledger.outbox} without receipt{waiting}"
    return Check("ledger", "Ledger", Trust.SAFE, text)


def _delta_check(delta: TollDelta | None) -> Check:
    if delta is None:
        return Check("delta", "Delta position", Trust.CAUTION, "none is received", link="toll")
    if not delta.valid:
        return Check("delta", "Delta position", Trust.CAUTION, delta.reason, link="toll")
    return Check("delta", "Delta position", Trust.SAFE, f"{delta.fixes} fixes, ± {delta.sd_m or 0.0:.2f} m per axis")


def _accounts_check(ledger: LedgerState | None) -> Check:
    if ledger is None:
        return Check("accounts", "Reconciliation", Trust.STALE, "no state of the ledger is received", link="toll")
    wrong = [lane.lane for lane in ledger.lanes if not lane.agrees]
    if wrong:
        return Check("accounts", "Reconciliation", Trust.CAUTION, f"lane {', '.join(wrong)}", link="toll")
    open_ = sum(lane.pending + lane.provisional for lane in ledger.lanes)
    if open_:
        text = f"every closed detection has one outcome; {open_} not closed yet"
        return Check("accounts", "Reconciliation", Trust.INITIALISING, text, link="toll")
    return Check("accounts", "Reconciliation", Trust.SAFE, "every detection has one outcome")


def _alarm_check(ledger: LedgerState | None) -> Check:
    if ledger is None or ledger.problem:
        return Check("alarms", "Attacks", Trust.STALE, "no state of the ledger is received", link="toll")
    if ledger.alarms:
        return Check("alarms", "Attacks", Trust.CAUTION, f"{ledger.alarms} within two hours", link="toll")
    return Check("alarms", "Attacks", Trust.SAFE, "no alarm within two hours")


def _dated(message: TollDelta | LedgerState | None, state: "State", topic: str) -> Object | None:
    if message is None:
        return None
    return {**message.model_dump(mode="json"), "updated_ns": state.topics[topic].updated_ns}


def _description(message: PlazaDescription) -> PlazaShown:
    return {
        "name": message.plaza,
        "digest": message.plaza_digest,
        "lanes": [
            {
                "lane": lane.lane,
                "direction": lane.direction,
                "mode": lane.mode,
                "detector": lane.detector,
                "width_m": lane.width_m,
                "centre": [_plane(point, message) for point in lane.centre],
                "approach": [_plane(point, message) for point in lane.approach_line],
                "gate": [_plane(point, message) for point in lane.gate_line],
                "exit": [_plane(point, message) for point in lane.exit_line],
            }
            for lane in message.lanes
        ],
    }


def _tracks(message: TollTracks, description: PlazaDescription) -> list[TrackShown]:
    return [
        {
            "track": track.track,
            "at": _plane(track, description),
            "heading_rad": round(track.heading_rad, 3),
            "speed_m_s": round(track.speed_m_s, 1),
            "ellipse": (
                round(track.ellipse_major_m, 2), round(track.ellipse_minor_m, 2),
                round(track.ellipse_orientation_rad, 3),
            ),
            "lanes": {lane.lane: round(lane.probability, 3) for lane in track.lanes},
            "lane": track.lane,
            "delta": track.delta_applied,
            "registered": track.registered,
            **_authentication(track),
            "passage": track.passage_id[:8] if track.passage_id else None,
            "age_s": round((message.sampled_ns - track.updated_ns) * 1e-9, 1),
        }
        for track in message.tracks
    ]  # fmt: skip


def _authentication(track: TollTrack) -> AuthenticationShown:
    """Say what was checked of the sender of a track, by the code of `core.toll` for it."""
    why = track.unverified if track.authentication is Authentication.SIGNED_NOT_VERIFIED else None
    code = explain(f"toll.{why or track.authentication}")
    verified = track.authentication is Authentication.AUTHENTICATED
    return {"authentication": said("", code), "verified": verified, "languages": translated("", code)}


def _plane(point: Position | TollTrack, description: PlazaDescription) -> tuple[float, float]:
    """Metres north and east of the antenna, by the radii of curvature there."""
    antenna = description.antenna
    north, east = ground_offset(
        (point.latitude_deg, point.longitude_deg), (antenna.latitude_deg, antenna.longitude_deg)
    )
    return round(north, 2), round(east, 2)
