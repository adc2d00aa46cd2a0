"""Everything that core.toll does with a message, without a bus or a clock: also what derives a charge again."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.dates import END_DATE_NS
from shared.maths.earth import FloatArray
from shared.messages.explanation import Explanation, explain
from shared.messages.fitting import fitting, size
from shared.messages.gnss import CarrierSolution, FixType, GnssFix
from shared.messages.toll import (
    DELTAS,
    MAX_USED,
    STATION_IDS,
    AlarmKind,
    CrossingMode,
    EvidenceFrame,
    GateCommand,
    GateMode,
    LanePosterior,
    LaneProbability,
    OpenPassages,
    PassageEvidence,
    PassageState,
    RegisteredStation,
    TollAlarm,
    TollDelta,
    TollPassage,
    TollRegistration,
    TollTrack,
    TollTracks,
    UsedCam,
)
from shared.messages.v2x import Authentication, Cam, StationType
from shared.toll.plaza import Plaza, along
from shared.toll.registration import fault_of, identity_of
from shared.words.words import CodedText, reason

from .codes import Code
from .delta import DeltaEstimator
from .gates import Arrival, is_near, refusal
from .lanes import LaneGeometry
from .location import COMMON, Fixes, Location, locate
from .measurement import ELLIPSE_95, ticket_of
from .passages import Crossing, Here, Mode, Passage, TimeMode, can_reach, crossing_between, overlap, passage_id
from .settings import Settings
from .tracks import REMEMBERED_NS, Received, Track, TrackTable, Update, away_from_prediction

# Of the algorithms, for evidence. 2 states the crossing time of slow and silent vehicles wider; 3 learns how vehicles
# err from their innovations, and states a crossing for each way in which a receiver may err.
VERSION = "3"
SECOND_NS = 10**9
ALIGNED = 0.5  # cosine between heading and lane above which a vehicle drives along it
ON_ROAD = 0.5  # probability of all lanes together above which a vehicle may open a passage
MAX_REGISTRATIONS = 20_000
MAX_UNSETTLED = 2000  # final statements that wait for the ledger
TAKEN_BYTES = 40_000_000  # of frames that the ledger has got
REPEATED = 50  # of them a second
ALARM_NS = 60 * SECOND_NS  # period of the alarm that the table is full
GATE_VALID_S = 5  # after the predicted crossing
LONGEST_M = 25.25  # [m] longest road train that Directive 96/53/EC admits, as modules; a CAM may state 102.2 m
MIN_PROBABILITY = 1e-9  # that is published
# Bytes in one message (`Topic.most_bytes`); UsedCams holds so many deltas of at most 700 bytes as well.
EVIDENCE_BYTES, TRACKS_BYTES, USED_BYTES, USED_OVERHEAD, DELTAS_AT_ONCE = 200_000, 240_000, 120_000, 240, 150
DELTA_ROUNDING = 4  # decimals of metres
NO_VEHICLE = {StationType.ROAD_SIDE_UNIT, StationType.PEDESTRIAN, StationType.CYCLIST, StationType.TRAM}

WITH_EVIDENCE = {PassageState.CROSSED, PassageState.CHARGED, PassageState.UNDECIDED}

BoolArray = npt.NDArray[np.bool_]
Statement = TollPassage | GateCommand

Command = tuple[int, bool, Explanation | None]  # lane, whether it opens, and why not


@dataclass
class Journey:
    """What is known of a track besides its estimate."""

    here: Here | None = None
    before: Here | None = None  # the newest position before the gate line
    crossing: Crossing | None = None
    passage: Passage | None = None


class Core:
    """Tracks, delta position, passages and gates of one plaza.

    The statements on a vehicle follow from its CAM, the deltas and the settings alone: a CAM is corrected by
    the newest delta that is older than `delta.latency_s` when the CAM arrives, and a passage begins with a new track.
    """

    def __init__(self, plaza: Plaza, settings: Settings, *, on_time: bool = False) -> None:
        self._plaza, self._settings = plaza, settings
        self._model, self._agreement = settings.errors.model, settings.delta.agreement
        self._table = TrackTable(settings, plaza, on_time=on_time)
        delta = settings.delta
        self._estimator = DeltaEstimator(
            self._model, window_s=delta.window_s, least_s=delta.least_s, max_age_s=delta.max_age_s
        )
        self._geometry = _geometry(plaza)
        self._directions = np.array([lane.direction for lane in plaza.lanes])
        self._deltas: deque[TollDelta] = deque(maxlen=DELTAS)
        self._journeys: dict[int, Journey] = {}
        self._passages: dict[str, Passage] = {}  # of a track, or continued from the ledger
        self._unsettled: dict[str, TollPassage] = {}  # last statements of ended passages
        self._contracts: dict[str, int] = {}  # ticket or station ID: end of its registration
        self._gates: dict[str, tuple[Command, int]] = {}  # passage: content and time of its newest gate command
        self._taken: deque[tuple[int, Received]] = deque()  # clock offset and CAM, as `used` has returned them
        self._taken_bytes = 0
        self._rejected: Counter[str] = Counter()
        self._cams = 0
        self._first_cam_ns: int | None = None
        self._newest_cam_ns = 0
        self._alarm_ns: int | None = None  # time of the newest alarm
        self._ready_ns: int | None = None  # from then on passages are opened
        self._source: str | None = settings.source

    @property
    def rejected(self) -> Counter[str]:
        """Rejected messages by reason."""
        return self._rejected + self._table.rejected

    def register(self, message: TollRegistration) -> None:
        """Note that a contract covers a ticket, or a station ID where the plaza allows it; bad signatures are counted.

        A repetition of what is known is not verified again: the ledger verifies each.
        """
        identity = identity_of(message)
        if self._contracts.get(identity, 0) >= message.valid_until_ns:
            return
        fault = fault_of(
            message, plaza=self._plaza.name, operator_keys=self._plaza.operator_keys,
            require_ticket=self._plaza.require_authenticated,
        )  # fmt: skip
        if fault:
            self._rejected[fault] += 1
        else:
            self._cover(identity, message.valid_until_ns)

    def cover_all(self, cams: Sequence[Cam]) -> None:
        """Take every station of some CAM as registered, to derive a charge from its evidence."""
        for cam in cams:
            ticket = ticket_of(cam)
            self._cover(f"ticket {ticket}" if ticket else f"station {cam.station_id}", END_DATE_NS - 1)

    def _cover(self, identity: str, valid_until_ns: int) -> None:
        if identity not in self._contracts and len(self._contracts) >= MAX_REGISTRATIONS:
            self._rejected["too_many_registrations"] += 1
            return
        self._contracts[identity] = valid_until_ns

    def _take_registered(self, stations: Sequence[RegisteredStation], *, replace_known: bool = False) -> None:
        """Note what the ledger has verified."""
        for station in stations:
            identity = f"ticket {station.ticket}" if station.ticket is not None else f"station {station.station_id}"
            if replace_known or identity not in self._contracts:
                self._cover(identity, station.valid_until_ns)

    def fix(self, fix: GnssFix) -> None:
        """Use a fix of the unit's own receiver."""
        self._source = self._source or fix.source
        if fix.source != self._source:
            self._rejected["second_receiver"] += 1
        elif fix.fix_type is not FixType.THREE_D or fix.latitude_deg is None or fix.longitude_deg is None:
            self._rejected["fix_without_position"] += 1
        elif fix.differential or fix.carrier_solution is not CarrierSolution.NONE:
            self._rejected["fix_is_corrected"] += 1  # its error is not that of the vehicles
        else:
            north, east = self._plaza.plane(fix.latitude_deg, fix.longitude_deg)
            if reject := self._estimator.add(fix.sampled_ns, east, north):
                self._rejected[reject] += 1

    def estimate_delta(self, now_ns: int) -> TollDelta:
        """Compute the delta position; it is used once it is passed to `use_delta`.

        A delta of a later time was retained before a reboot of the host, and would keep out those of this one.
        """
        while self._deltas and self._deltas[-1].sampled_ns > now_ns:
            self._rejected["delta_from_the_future"] += 1
            self._deltas.pop()
        found = self._estimator.delta(now_ns)
        if isinstance(found, Explanation):
            return TollDelta(
                sampled_ns=now_ns, plaza=self._plaza.name, valid=False, reason=reason(found), reason_code=found
            )
        return TollDelta(
            sampled_ns=found.time_ns,
            plaza=self._plaza.name,
            valid=True,
            reason="",
            north_m=round(found.north, DELTA_ROUNDING),
            east_m=round(found.east, DELTA_ROUNDING),
            sd_m=round(found.sd, DELTA_ROUNDING),
            fixes=found.fixes,
            window_s=found.window_s,
        )

    def use_delta(self, delta: TollDelta) -> bool:
        """Use a delta for the CAM that arrive from `delta.latency_s` after it on; whether it is used."""
        if not delta.valid or (self._deltas and delta.sampled_ns <= self._deltas[-1].sampled_ns):
            return False
        if delta.sampled_ns + round(self._settings.delta.latency_s * SECOND_NS) < self._newest_cam_ns:
            self._rejected["late_delta"] += 1  # CAM that it belongs to are used already
            return False
        self._deltas.append(delta)
        return True

    def continue_passages(self, message: OpenPassages) -> Iterator[Statement]:
        """Take over what the ledger holds and this process does not; forget passages that are settled."""
        self._take_registered(message.registered)
        self._ready_ns = min(message.sampled_ns, self._ready_ns or message.sampled_ns)
        for settled in message.settled:
            self._unsettled.pop(settled, None)
        for statement in message.passages:
            known = statement.passage_id in self._passages or statement.passage_id in self._unsettled
            if known or statement.state.is_final or statement.passage_id in message.settled:
                continue
            passage = self._continued(statement)
            self._passages[passage.passage_id] = passage
            yield from self._take_over(passage)

    def used(self) -> tuple[UsedCam, ...]:
        """Take what was used since the last call, at most as many as a message holds."""
        count, left = 0, USED_BYTES
        for _, (_, _, data, *_) in self._table.used[:MAX_USED]:
            left -= USED_OVERHEAD + 4 * (len(data) + 2) // 3
            if left < 0:
                break
            count += 1
        taken, self._table.used = self._table.used[:count], self._table.used[count:]
        self._remember(taken)
        return tuple(
            UsedCam(
                sampled_ns=sampled_ns,
                received_ns=received_ns,
                data=data,
                clock_offset_ns=offset_ns,
                authentication=Authentication(authentication),
                signer=signer,
            )
            for offset_ns, (sampled_ns, received_ns, data, authentication, signer) in taken
        )

    def _remember(self, taken: Sequence[tuple[int, Received]]) -> None:
        """Remember what the ledger has got, as long as it may ask for it, and as far as memory is for it."""
        self._taken += taken
        self._taken_bytes += sum(len(received[2]) for _, received in taken)
        while self._taken and self._newest_cam_ns - self._taken[0][1][1] > REMEMBERED_NS:
            self._taken_bytes -= len(self._taken.popleft()[1][2])
        while self._taken_bytes > TAKEN_BYTES:
            self._taken_bytes -= len(self._taken.popleft()[1][2])
            self._rejected["used_cam_dropped"] += 1

    def recall(self) -> tuple[TollDelta, ...]:
        """Let `used` begin with the oldest CAM again, which the ledger has lost; return the deltas of their time."""
        self._table.used = [*self._taken, *self._table.used]
        self._taken.clear()
        self._taken_bytes = 0
        first_ns = self._newest_cam_ns - REMEMBERED_NS
        return tuple(delta for delta in self._deltas if delta.sampled_ns >= first_ns)

    def restore(
        self, cams: Sequence[tuple[Cam, int]], deltas: Sequence[TollDelta], message: OpenPassages
    ) -> list[TollPassage]:
        """Use what an earlier process has used, so that its passages go on as if there had been no restart.

        To be called before any other CAM is used. A passage depends on the CAM since it was opened only: those of each
        passage whose first CAM is there are used again, in their order; the others are remembered, against replays.

        Parameters
        ----------
        cams : sequence of (Cam, int)
            In the order of use, with corrected times, and [ns] the correction that is in them.
        deltas : sequence of TollDelta
            The delta positions of their time.
        message : OpenPassages
            What the ledger holds.

        Returns
        -------
        list of TollPassage
            Final statements that the ledger may not have received.
        """
        self._take_registered(message.registered, replace_known=True)
        for delta in deltas:
            self.use_delta(delta)
        open_ids = {
            passage.passage_id: set(passage.station_ids) for passage in message.passages if not passage.state.is_final
        }
        stations: set[int] = set()  # of the passages that have begun
        self._ready_ns, self._table.on_time, said = 0, True, list[Statement]()
        batch: dict[tuple[int, str | None], Cam] = {}
        for cam, _ in cams:
            stations |= open_ids.get(passage_id(self._plaza.name, cam.frame), set())
            if cam.station_id not in stations:
                self._table.repetitions.add(cam)
                continue
            station = cam.station_id, ticket_of(cam)
            if station in batch:
                said += self.use(list(batch.values()))
                batch.clear()
            batch[station] = cam
        said += self.use(list(batch.values()))
        self._ready_ns, self._first_cam_ns, self._table.on_time, self._table.used = None, None, False, []
        self._remember(
            [
                (offset_ns, (cam.sampled_ns, cam.received_ns, cam.frame, cam.authentication.value, cam.signer))
                for cam, offset_ns in cams
            ]
        )
        for cam, offset_ns in cams:
            self._table.continue_clock(cam, offset_ns)
        return [
            toll_passage
            for toll_passage in said
            if isinstance(toll_passage, TollPassage) and toll_passage.state.is_final
        ]

    def use(self, cams: Sequence[Cam]) -> Iterator[Statement]:
        """Use a batch of CAM."""
        vehicles = [cam for cam in cams if cam.station_type not in NO_VEHICLE]
        if self._first_cam_ns is None and vehicles:
            self._first_cam_ns = self._table.seen_since_ns = min(cam.received_ns for cam in vehicles)
        self._newest_cam_ns = max([self._newest_cam_ns, *(cam.received_ns for cam in vehicles)])
        self._rejected["no_road_vehicle"] += len(cams) - len(vehicles)
        for updates in self._table.use(vehicles):
            self._cams += len(updates)
            for update, here in zip(updates, self._located(updates), strict=True):
                yield from self._moved(update, here)

    def tick(self, now_ns: int) -> Iterator[Statement]:
        """End the passages of vehicles that fell silent, delete old tracks, and repeat what the ledger has not."""
        if self._ready_ns is None:
            self._ready_ns = now_ns + round(self._settings.passage.resume_wait_s * SECOND_NS)
        self._delete_silent(now_ns)
        self._contracts = {identity: until for identity, until in self._contracts.items() if until > now_ns}
        repeated = list(self._unsettled.values())[:REPEATED]
        for passage in [item for item in self._passages.values() if not item.state.is_final]:
            if now_ns - passage.here.time_ns > self._settings.passage.lost_after_s * SECOND_NS:
                passage.registered = passage.registered or self._is_registered(passage, passage.here.time_ns)
                passage.lose()
                yield self._ended(passage, now_ns)
                self._forget(passage)
        for statement in repeated:
            yield statement.model_copy(update={"sampled_ns": now_ns, "checkpoint": True})
            self._unsettled[statement.passage_id] = self._unsettled.pop(statement.passage_id)

    def _delete_silent(self, now_ns: int) -> None:
        """Delete the tracks of silent vehicles, and what is known of all deleted tracks.

        The passage of a silent vehicle waits for another track, or is lost later.
        """
        silent = {track.number for track in self._table.delete_silent(now_ns)}
        known = {track.number for track in self._table.tracks}
        self._journeys = {number: journey for number, journey in self._journeys.items() if number in known}
        for passage in [item for item in self._passages.values() if item.track is not None and item.track not in known]:
            if passage.state.is_final:
                self._forget(passage)
            elif passage.track in silent:
                passage.track = None

    def alarm(self, now_ns: int) -> TollAlarm | None:
        """Alarm that the table is full: more unknown stations than vehicles; None: it is not, or was said just now."""
        full_ns, self._table.full_ns = self._table.full_ns, None
        if full_ns is None or (self._alarm_ns is not None and 0 <= now_ns - self._alarm_ns < ALARM_NS):
            return None
        self._alarm_ns = now_ns
        unknown = [track for track in self._table.tracks if track.ticket is None]
        place = self._plaza.position(0.0, 0.0)
        return TollAlarm(
            sampled_ns=now_ns,
            plaza=self._plaza.name,
            kind=AlarmKind.GHOSTS,
            since_ns=min([full_ns, *(track.born_ns for track in unknown)]),
            until_ns=full_ns,
            ghosts=len(unknown),
            latitude_deg=place.latitude_deg,
            longitude_deg=place.longitude_deg,
            reason_code=explain(Code.TRACKS_FULL, track_count=len(unknown)),
        )

    def tracks(self, now_ns: int) -> TollTracks:
        """Describe every track, as far as a message holds them; the rest is counted."""
        described = [
            self._track(track, journey.here, journey.passage)
            for track in sorted(self._table.tracks, key=lambda track: track.ticket is None)
            if (journey := self._journeys.get(track.number)) and journey.here
        ]
        tracks = fitting(described, TRACKS_BYTES)
        if len(tracks) < len(described):
            self._rejected["tracks left out"] += len(described) - len(tracks)
        return TollTracks(
            sampled_ns=now_ns,
            tracks=tuple(tracks),
            cams=self._cams,
            rejected=self.rejected.total(),
            trust=self._trust(now_ns),
        )

    # Positions

    def _located(self, updates: Sequence[Update]) -> list[Here]:
        """Locate the vehicles of a round relative to the lanes."""
        estimates = self._table.estimates([update.track for update in updates])
        mean, cov = estimates.mean, estimates.cov
        deltas = [self._delta_for(update.measured.cam.received_ns) for update in updates]
        stated = [update.measured.stated_sd for update in updates]
        common_sd = self._model.common_sd
        fixes = Fixes(
            mean[:, :2],
            cov[:, :2, :2],
            np.array([value or 0.0 for value in stated]),
            np.array([value is not None for value in stated]),
            np.array([(delta.east_m, delta.north_m) if delta else (0.0, 0.0) for delta, _ in deltas], dtype=np.float64),
            np.array([sd if delta else common_sd for delta, sd in deltas]),
        )
        projection = self._geometry.project(fixes.position)
        heading = np.stack([np.cos(mean[:, 2]), np.sin(mean[:, 2])], axis=-1)
        along_lane = np.vecdot(projection.direction, heading[:, None]) > ALIGNED
        allowed = along_lane.copy()
        for k, update in enumerate(updates):
            journey = self._journeys.get(update.track.number)
            if journey and journey.passage:
                allowed[k] = self._directions == journey.passage.direction
        allowed |= ~allowed.any(axis=1, keepdims=True)
        location = locate(projection, fixes, allowed, self._model, self._agreement)
        return [
            self._here(update, mean[k], cov[k], _row(location, k), deltas[k][0], along_lane[k])
            for k, update in enumerate(updates)
        ]

    def _here(
        self,
        update: Update,
        mean: FloatArray,
        cov: FloatArray,
        location: Location,
        delta: TollDelta | None,
        along_lane: BoolArray,
    ) -> Here:
        lane = int(location.lanes.argmax())
        variance = float(location.sd) ** 2
        applied = delta is not None and int(location.hypotheses.argmax()) == COMMON
        return Here(
            time_ns=update.measured.time_ns,
            east=float(mean[0] + location.shift[0]),
            north=float(mean[1] + location.shift[1]),
            cov=(float(cov[0, 0]) + variance, float(cov[0, 1]), float(cov[1, 1]) + variance),
            heading=float(mean[2]),
            speed=float(mean[3]),
            speed_sd=sqrt(cov[3, 3]),
            direction=str(self._directions[lane]),
            aligned=bool(along_lane[lane]),
            along=float(location.along),
            along_sd=float(location.along_sd),
            lanes=tuple(location.lanes.tolist()),
            lane=lane,
            delta_ns=delta.sampled_ns if delta and applied else None,
            modes=_modes(location),
        )

    def _delta_for(self, received_ns: int) -> tuple[TollDelta | None, float]:
        """Delta for a CAM that arrived at a time, and the standard deviation [m] of its error then."""
        newest_ns = received_ns - round(self._settings.delta.latency_s * SECOND_NS)
        for delta in reversed(self._deltas):
            if delta.sampled_ns <= newest_ns:
                age_s = (received_ns - delta.sampled_ns) * 1e-9
                if age_s > self._settings.delta.max_age_s or delta.sd_m is None:
                    return None, 0.0
                return delta, sqrt(delta.sd_m**2 + self._model.change_variance(age_s))
        return None, 0.0

    # Passages

    def _moved(self, update: Update, here: Here) -> Iterator[Statement]:
        """Follow a vehicle's passage with its newest position."""
        track = update.track
        journey = self._journeys.setdefault(track.number, Journey())
        if update.continues:
            self._inherit(journey, self._journeys.pop(update.continues.number, None), track)
        waits = journey.passage is None and self._adopt(journey, track, here)
        if journey.passage is None and not waits and self._may_open(track, here):
            here = self._restarted(update)
            if self._may_open(track, here):
                yield from self._opened(journey, update, here)
        self._note(journey, here, self._settings.passage.decided)
        passage = journey.passage
        if passage is None:
            return
        passage.registered = passage.registered or self._is_registered(passage, here.time_ns)
        settings, exit_line = self._settings.passage, float(self._geometry.exit[here.lane])
        if passage.advance(here, journey.crossing, settings):
            yield self._changed(passage, track, here)
        if passage.leave(exit_line, settings):
            yield self._changed(passage, track, here)
        elif not passage.state.is_final and here.time_ns - passage.stated_ns >= SECOND_NS:
            passage.remember_lanes()
            yield self._statement(passage, here.time_ns, checkpoint=True)
        yield from self._command(passage, here)
        has_left = here.along > exit_line + settings.turned_m
        if passage.state is PassageState.VOID or (passage.state.is_final and has_left):
            self._forget(passage)
            journey.passage = journey.crossing = journey.before = None
            track.has_passage = False

    @staticmethod
    def _note(journey: Journey, here: Here, decided: float) -> None:
        """Remember the newest position before the gate line, and the crossing."""
        journey.here = here
        if here.along < 0.0:
            journey.before, journey.crossing = here, None
        elif journey.crossing is None and journey.before is not None:
            journey.crossing = crossing_between(journey.before, here, decided)
        elif journey.crossing is not None:
            journey.crossing = journey.crossing.widened(here)

    def _may_open(self, track: Track, here: Here) -> bool:
        """Whether a vehicle without a passage is between approach line and gate line, drives forward, and is sure."""
        is_ready = self._ready_ns is not None and here.time_ns >= self._ready_ns
        inside = self._geometry.approach[here.lane] <= here.along < -self._settings.passage.crossed_m
        return is_ready and inside and here.aligned and sum(here.lanes) > ON_ROAD and track.predecessor is None

    def _restarted(self, update: Update) -> Here:
        """Begin the track anew with its newest CAM, as if it were the first one."""
        self._table.restart(update)
        return self._located([update])[0]

    def _opened(self, journey: Journey, update: Update, here: Here) -> Iterator[TollPassage]:
        passage = Passage(
            passage_id(self._plaza.name, update.measured.cam.frame),
            opened_ns=here.time_ns,
            direction=here.direction,
            station_ids=[update.track.station_id],
            here=here,
            tickets=[ticket] if (ticket := update.track.ticket) else [],
            authenticated=ticket is not None,
            track=update.track.number,
        )
        for other in list(self._passages.values()):
            if update.track.station_id in other.station_ids and not other.state.is_final:
                yield self._contradiction(passage, other)
        passage.registered = self._is_registered(passage, here.time_ns)
        journey.passage, journey.before, journey.crossing = passage, None, None
        update.track.has_passage = True
        self._passages[passage.passage_id] = passage
        yield self._statement(passage, here.time_ns)

    def _contradiction(self, younger: Passage, older: Passage) -> TollPassage:
        """Note that two passages with one station ID are of two vehicles; return the statement on the older one.

        What is not authenticated is no doubt about what is, and two tickets are two stations: who has no contract is
        reviewed.
        """
        for one, other in ((younger, older), (older, younger)):
            if one.tickets and other.tickets and one.tickets[-1] != other.tickets[-1]:
                one.identify(other)
            elif not one.tickets or other.tickets:
                one.contradict(other)
        return self._statement(older, older.here.time_ns, checkpoint=True)

    def _changed(self, passage: Passage, track: Track, here: Here) -> TollPassage:
        """Make the statement on a change of a passage's state; note which ones it overlaps."""
        crossing = passage.crossing
        if passage.state is PassageState.CROSSED and crossing:
            passage.suspect(self._overlapped(passage, here))
        evidence = None
        if passage.registered and passage.state in WITH_EVIDENCE:
            evidence = self._evidence(passage, track)
        statement = self._statement(passage, here.time_ns, evidence=evidence)
        return self._kept(statement) if passage.state.is_final else statement

    def _overlapped(self, passage: Passage, here: Here) -> list[Passage]:
        """Find the passages that crossed the gate line before in the same lane, and whose vehicles are still there."""
        lane = passage.crossing.lane if passage.crossing else None
        if lane is None:
            return []
        found = []
        model = self._model
        relative_sd = sqrt(2.0) * sqrt(model.vehicle_sd**2 + self._settings.errors.white_sd_m**2)
        for other in self._passages.values():
            crossed = other.state in (PassageState.CROSSED, PassageState.CHARGED, PassageState.UNREGISTERED)
            if other is passage or not crossed or not other.crossing or other.crossing.lane != lane:
                continue
            length_m = self._length_of(other)
            if overlap(other, here, length_m, relative_sd=relative_sd):
                found.append(other)
        return found

    def _length_of(self, passage: Passage) -> float:
        """Length [m] for overlaps: no more than a vehicle has, or one ghost overlaps each car that follows it."""
        tracks = [track for track in self._table.tracks_of(passage.station_ids[-1]) if track.number == passage.track]
        length_m = next((track.length_m for track in tracks if track.length_m), self._settings.passage.vehicle_length_m)
        return min(length_m, LONGEST_M)

    def _inherit(self, journey: Journey, old: Journey | None, track: Track) -> None:
        """Continue the passage of the track that this one continues under a new station ID."""
        if old is None or old.passage is None or journey.passage is not None:
            return
        self._attach(journey, old.passage, track)
        journey.before = journey.before or old.before

    def _adopt(self, journey: Journey, track: Track, here: Here) -> bool:
        """Continue a passage that no track has, if its vehicle can be here now.

        It has the same station ID, or that has fallen silent and this track begins where the vehicle must be. Silence
        counts from the first CAM of this process: after a restart, vehicles in a queue are where the next one was.

        Returns
        -------
        bool
            Whether the track waits, since it may continue a passage whose station is not silent for long enough.
        """
        idle = [passage for passage in self._passages.values() if not passage.doubt and self._is_idle(passage)]
        own = [
            passage for passage in idle
            if track.station_id in passage.station_ids and _is_of(passage, track) and self._reaches(passage, here)
        ]  # fmt: skip
        away = [self._away(passage, here) for passage in idle]
        nearest = idle[int(np.argmin(away))] if away and np.isfinite(min(away)) else None
        found = own[0] if own else nearest
        if found is None:
            return False
        if not own:
            silent_since_ns = max(found.here.time_ns, self._first_cam_ns or 0)
            if here.time_ns - silent_since_ns < self._settings.track.silence_ns(found.here.speed):
                return True
        self._attach(journey, found, track)
        if found.crossing is None and journey.crossing is None and found.here.time_ns < here.time_ns:
            journey.before = journey.before or found.here
        return False

    def _away(self, passage: Passage, here: Here) -> float:
        """Distance [m] from where the vehicle of an idle passage must be now; infinite if it cannot be that one."""
        last = passage.here
        if not here.aligned or self._table.tracks_of(passage.station_ids[-1]):
            return np.inf
        elapsed_s = (here.time_ns - last.time_ns) * 1e-9
        if not 0.0 < elapsed_s <= self._settings.track.deleted_after_s:
            return np.inf
        moved = np.array([[here.east - last.east, here.north - last.north]])
        dt, heading, speed, now = np.array([[elapsed_s], [last.heading], [last.speed], [here.speed]])
        gate_m = self._settings.track.link_gate_m
        return float(away_from_prediction(moved, dt, heading, speed, now, gate_m)[0])

    def _is_idle(self, passage: Passage) -> bool:
        return all(track.number != passage.track for track in self._table.tracks_of(passage.station_ids[-1]))

    def _reaches(self, passage: Passage, here: Here) -> bool:
        """Whether the vehicle of a passage can be here: a CAM is not signed, and anybody can use its station ID."""
        settings = self._settings
        return can_reach(passage.here, here, gate_m=settings.track.link_gate_m, longest_s=settings.passage.lost_after_s)

    def _attach(self, journey: Journey, passage: Passage, track: Track) -> None:
        others = [station for station in passage.station_ids if station != track.station_id]
        if len(others) >= STATION_IDS:
            self._rejected["too_many_station_ids"] += 1
            return
        passage.station_ids = [*others, track.station_id]
        if track.ticket is None:
            passage.authenticated = False
        elif track.ticket not in passage.tickets:
            passage.tickets = [*passage.tickets, track.ticket][-STATION_IDS:]
        journey.passage, passage.track, track.has_passage = passage, track.number, True

    def _continued(self, statement: TollPassage) -> Passage:
        """Make a passage from the ledger's newest statement on it."""
        north, east = self._plaza.plane(statement.latitude_deg, statement.longitude_deg)
        posterior = {lane.lane: lane.probability for lane in statement.lanes}
        lanes = tuple(posterior.get(lane.name, 0.0) for lane in self._plaza.lanes)
        lane = int(np.argmax(lanes))
        projection = self._geometry.project(np.array([[east, north]]))
        variance = 0.5 * statement.position_sd_m**2
        here = Here(
            time_ns=statement.sampled_ns,
            east=east,
            north=north,
            cov=(variance, 0.0, variance),
            heading=0.5 * pi - statement.heading_rad,
            speed=statement.speed_m_s,
            speed_sd=1.0,
            direction=self._plaza.lanes[lane].direction,
            aligned=True,
            along=float(projection.along[0, lane]),
            along_sd=statement.position_sd_m,
            lanes=lanes,
            lane=lane,
            delta_ns=statement.delta_ns,
        )
        crossing = None
        if statement.crossing_ns is not None:
            names = [lane.name for lane in self._plaza.lanes]
            decided = names.index(statement.lane) if statement.lane in names else None
            crossing = Crossing(
                statement.crossing_ns, statement.crossing_sd_s or 0.0, decided, lanes, statement.delta_ns,
                tuple(self._mode_of(mode) for mode in statement.modes),
            )  # fmt: skip
        return Passage(
            statement.passage_id,
            opened_ns=statement.opened_ns,
            direction=here.direction,
            station_ids=list(statement.station_ids),
            tickets=list(statement.tickets),
            authenticated=statement.authenticated,
            here=here,
            state=statement.state,
            doubt=CodedText(statement.reason, statement.reason_code) if statement.reason else None,
            crossing=crossing,
            stated_ns=statement.sampled_ns,
            overlaps=list(statement.overlaps),
        )

    def _mode_of(self, mode: CrossingMode) -> TimeMode:
        probability = {lane.lane: lane.probability for lane in mode.lanes}
        return TimeMode(mode.offset_s, mode.sd_s, tuple(probability.get(lane.name, 0.0) for lane in self._plaza.lanes))

    def _take_over(self, passage: Passage) -> Iterator[TollPassage]:
        """Continue the older passage of a station ID with the track that opened a younger one."""
        for track in self._table.tracks_of(passage.station_ids[-1]):
            yield from self._take_over_with(passage, track)

    def _take_over_with(self, passage: Passage, track: Track) -> Iterator[TollPassage]:
        journey = self._journeys.get(track.number)
        if journey is None or journey.here is None or not _is_of(passage, track):
            return
        younger = journey.passage
        if younger is None or younger.state.is_final or younger.opened_ns <= passage.opened_ns:
            return
        if not self._reaches(passage, journey.here):
            yield self._contradiction(younger, passage)
            return
        younger.give_way(passage)
        yield self._ended(younger, journey.here.time_ns)
        self._forget(younger)
        self._attach(journey, passage, track)

    def _is_registered(self, passage: Passage, now_ns: int) -> bool:
        """Whether a contract covers a ticket of an authenticated passage, or a station ID of another one."""
        identities = [f"ticket {ticket}" for ticket in passage.tickets] or [
            f"station {station}" for station in passage.station_ids
        ]
        return any(self._contracts.get(identity, 0) > now_ns for identity in identities)

    def _forget(self, passage: Passage) -> None:
        self._passages.pop(passage.passage_id, None)
        self._gates.pop(passage.passage_id, None)

    def _ended(self, passage: Passage, now_ns: int) -> TollPassage:
        return self._kept(self._statement(passage, now_ns))

    def _kept(self, statement: TollPassage) -> TollPassage:
        """Remember a final statement until the ledger has it."""
        if len(self._unsettled) >= MAX_UNSETTLED:
            self._rejected["unsettled_passages_dropped"] += 1
            del self._unsettled[next(iter(self._unsettled))]
        self._unsettled[statement.passage_id] = statement
        return statement

    def _command(self, passage: Passage, here: Here) -> Iterator[GateCommand]:
        """Command the gate of a vehicle's lane when that changes, and once a second."""
        settings = self._settings.passage
        lane = here.decided(settings.decided)
        if passage.state is not PassageState.OPEN or lane is None or not is_near(here, settings):
            return
        why = refusal(passage, self._ahead(passage, here, lane))
        command = lane, why is None, why.code if why else None
        before, said_ns = self._gates.get(passage.passage_id, (None, 0))
        if command == before and here.time_ns - said_ns < SECOND_NS:
            return
        self._gates[passage.passage_id] = command, here.time_ns
        arrival = Arrival.of(here)
        yield GateCommand(
            sampled_ns=here.time_ns,
            plaza=self._plaza.name,
            lane=self._plaza.lanes[lane].name,
            passage_id=passage.passage_id,
            open=why is None,
            mode=self._plaza.lanes[lane].mode,
            crossing_ns=arrival.crossing_ns,
            crossing_sd_s=arrival.sd_s,
            valid_until_ns=max(arrival.crossing_ns or 0, here.time_ns) + GATE_VALID_S * SECOND_NS,
            reason=why.text if why else "",
            reason_code=why.code if why else None,
        )

    def _ahead(self, passage: Passage, here: Here, lane: int) -> Passage | None:
        """Find the passage before this one at the barrier of a lane.

        What is not authenticated is not before what is: a station ID that anybody sends keeps no barrier closed. If a
        car without a ticket stands there, the barrier opens for both, and the lane's detector counts two.
        """
        if self._plaza.lanes[lane].mode is GateMode.FREE_FLOW:
            return None
        for other in self._passages.values():
            if other is passage or other.state is not PassageState.OPEN or other.track is None:
                continue
            if passage.authenticated and not other.authenticated:
                continue
            if other.here.lane == lane and here.along < other.here.along:
                return other
        return None

    # Messages

    def _statement(
        self, passage: Passage, now_ns: int, *, checkpoint: bool = False, evidence: PassageEvidence | None = None
    ) -> TollPassage:
        here, crossing, why = passage.here, passage.crossing, passage.why or passage.doubt
        passage.stated_ns = now_ns
        position = self._plaza.position(here.north, here.east)
        lanes = crossing.lanes if crossing else here.lanes
        lane = crossing.lane if crossing else here.decided(self._settings.passage.decided)
        return TollPassage(
            sampled_ns=now_ns,
            passage_id=passage.passage_id,
            plaza=self._plaza.name,
            plaza_digest=self._plaza.digest,
            state=passage.state,
            reason=why.text if why else "",
            reason_code=why.code if why else None,
            checkpoint=checkpoint,
            station_ids=tuple(passage.station_ids),
            opened_ns=passage.opened_ns,
            crossing_ns=crossing.time_ns if crossing else None,
            crossing_sd_s=crossing.sd_s if crossing else None,
            exit_ns=passage.exit_ns,
            lane=None if lane is None else self._plaza.lanes[lane].name,
            lanes=self._probabilities(lanes),
            latitude_deg=position.latitude_deg,
            longitude_deg=position.longitude_deg,
            heading_rad=0.5 * pi - here.heading,
            speed_m_s=here.speed,
            position_sd_m=here.sd,
            delta_ns=crossing.delta_ns if crossing else here.delta_ns,
            trust=self._trust(here.time_ns),
            modes=self._time_modes(crossing),
            authenticated=passage.authenticated,
            tickets=tuple(passage.tickets),
            overlaps=tuple(passage.overlaps),
            evidence=evidence,
        )

    def _time_modes(self, crossing: Crossing | None) -> tuple[CrossingMode, ...]:
        return tuple(
            CrossingMode(offset_s=mode.offset_s, sd_s=mode.sd_s, lanes=self._probabilities(mode.lanes))
            for mode in (crossing.modes if crossing else ())
        )

    def _probabilities(self, lanes: Sequence[float]) -> tuple[LaneProbability, ...]:
        return tuple(
            LaneProbability(lane=lane.name, probability=probability)
            for lane, probability in zip(self._plaza.lanes, lanes, strict=True)
            if probability > MIN_PROBABILITY
        )

    def _evidence(self, passage: Passage, track: Track) -> PassageEvidence:
        """Everything that the passage follows from; of a very long one the newest, as much as a message holds."""
        frames = list(track.frames)
        while size(evidence := self._evidence_of(passage, track, frames)) > EVIDENCE_BYTES and len(frames) > 1:
            frames = frames[1 + len(frames) // 16 :]
        return evidence

    def _evidence_of(self, passage: Passage, track: Track, frames: Sequence[Received]) -> PassageEvidence:
        first_ns, last_ns = frames[0][1], frames[-1][1]
        since_ns = 0 if len(frames) == len(track.frames) else first_ns
        before_ns = round((self._settings.delta.max_age_s + self._settings.delta.latency_s) * SECOND_NS)
        return PassageEvidence(
            version=VERSION,
            settings=self._settings.model_dump_json(),
            track_since_ns=track.since_ns,
            frames=tuple(
                EvidenceFrame(
                    sampled_ns=sampled_ns,
                    received_ns=received_ns,
                    data=data,
                    authentication=Authentication(authentication),
                    signer=signer,
                )
                for sampled_ns, received_ns, data, authentication, signer in frames
            ),
            deltas=tuple(d for d in self._deltas if first_ns - before_ns <= d.sampled_ns <= last_ns),
            lanes=tuple(
                LanePosterior(sampled_ns=time_ns, lanes=self._probabilities(lanes))
                for time_ns, lanes in passage.posteriors
                if time_ns >= since_ns
            ),
        )

    def _track(self, track: Track, here: Here, passage: Passage | None) -> TollTrack:
        position = self._plaza.position(here.north, here.east)
        values, vectors = np.linalg.eigh([[here.cov[0], here.cov[1]], [here.cov[1], here.cov[2]]])
        lane = here.decided(self._settings.passage.decided)
        return TollTrack(
            track=track.number,
            station_id=track.station_id,
            updated_ns=track.updated_ns,
            latitude_deg=position.latitude_deg,
            longitude_deg=position.longitude_deg,
            speed_m_s=here.speed,
            heading_rad=0.5 * pi - here.heading,
            ellipse_major_m=ELLIPSE_95 * sqrt(values[1]),
            ellipse_minor_m=ELLIPSE_95 * sqrt(values[0]),
            ellipse_orientation_rad=float(np.arctan2(vectors[0, 1], vectors[1, 1])),
            lanes=self._probabilities(here.lanes),
            lane=None if lane is None else self._plaza.lanes[lane].name,
            delta_applied=here.delta_ns is not None,
            registered=self._contracts.get(
                f"ticket {track.ticket}" if track.ticket else f"station {track.station_id}", 0
            )
            > track.updated_ns,
            passage_id=passage.passage_id if passage else None,
            authentication=track.authentication,
            unverified=track.unverified,
            ticket=track.ticket,
        )

    def _trust(self, now_ns: int) -> str:
        """State of the surveyed antenna and its receiver."""
        if not self._deltas:
            return "antenna surveyed; no delta position"
        delta = self._deltas[-1]
        age_s = (now_ns - delta.sampled_ns) * 1e-9
        if age_s > self._settings.delta.max_age_s + self._settings.delta.latency_s:
            return "antenna surveyed; the delta position is too old"
        return f"antenna surveyed; delta position from {delta.fixes} fixes, sd {delta.sd_m:.2f} m"


def derive(plaza: Plaza, settings: Settings, cams: Sequence[Cam], deltas: Sequence[TollDelta]) -> list[TollPassage]:
    """Derive the statements on a registered vehicle's passage again from its CAM and the deltas, in their order."""
    core = Core(plaza, settings, on_time=True)
    list(core.continue_passages(OpenPassages(sampled_ns=0, passages=(), settled=())))
    core.cover_all(cams)
    for delta in deltas:
        core.use_delta(delta)
    return [toll_passage for cam in cams for toll_passage in core.use([cam]) if isinstance(toll_passage, TollPassage)]


def _is_of(passage: Passage, track: Track) -> bool:
    """Whether a track with a station ID of a passage may be its vehicle: its ticket, or neither is authenticated."""
    return track.ticket in passage.tickets if passage.tickets else track.ticket is None


def _modes(location: Location) -> tuple[Mode, ...]:
    """Where the vehicle of one row is by each hypothesis that is possible."""
    return tuple(
        Mode(float(along - location.along), float(sd), tuple(lanes.tolist()))
        for lanes, along, sd in zip(
            location.by_hypothesis, location.along_by_hypothesis, location.along_sd_by_hypothesis, strict=True
        )
        if lanes.max() > MIN_PROBABILITY
    )


def _row(location: Location, k: int) -> Location:
    return Location(*(values[k] for values in location))


def _geometry(plaza: Plaza) -> LaneGeometry:
    """Centre lines in the plane x east, y north, with the distances of approach, gate and exit line along them."""
    lines = []
    for lane in plaza.lanes:
        found = [along(lane.centre, line) for line in (lane.approach, lane.gate, lane.exit)]
        approach, gate, leave = (distance for distance in found if distance is not None)
        lines.append((approach, gate, leave))
    return LaneGeometry.of([lane.centre[:, ::-1] for lane in plaza.lanes], [x.width_m for x in plaza.lanes], lines)
