"""Tracks of up to some hundred vehicles: initiation, gating, association by station ID, pseudonym changes, deletion."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from math import hypot, sqrt

import numpy as np

from shared.maths.earth import FloatArray
from shared.messages.toll import FRAMES, STATION_IDS
from shared.messages.v2x import Authentication, Cam, Unverified
from shared.toll.plaza import Plaza

from .measurement import CamMeasurement, observation, ticket_of
from .settings import Settings
from .trackers.filters import Estimates, imm

REMEMBERED_NS = 70 * 10**9  # generationDeltaTime is the same again after 65.536 s
MAX_REMEMBERED = 300_000  # CAM; 2,000 a second are 140,000
CHANNEL_NS = 5 * 10**9  # longest delay of what the channel repeats

LINK_ACCELERATION = 3.0  # [m/s²] that a vehicle may have between its last CAM and the first with another station ID
LINK_ACROSS_M = 2.0  # that it may be beside its prediction; the next lane is 3.5 m away
LINK_SPEED_M_S = 1.0  # by which its speed may differ, beside what it has accelerated

# sampled_ns, received_ns and bytes of a frame, for evidence. The garbage collector does not follow such a tuple;
# a minute of CAM of 200 vehicles, kept as messages, stops the process for 0.35 s in each search.
Received = tuple[int, int, bytes, str, str | None]  # with `Authentication` and the ticket
# Station ID, authorization ticket of an authenticated station, and place: a station ID that is used at two places at
# once is followed at both, so that who uses it first does not hide the other one.
Sender = tuple[int, str | None, int]
MAX_SPEED = 70.0  # [m/s]
# Innovations of a consistent vehicle exceed their variance by chance: of the mean over 20 CAM the root is below 1.3.
LEARNED_CAMS, CHANCE, MOST_INFLATION = 20.0, 1.3, 4.0
# Frames are the sender's, up to 2,304 bytes each. Those of a passage are evidence, as far as one message holds them
# (`EVIDENCE_BYTES`, in base64); before it begins, as many as a track can bring into one that it continues.
TRACK_BYTES, TABLE_BYTES = 150_000, 32_000_000  # of the frames of one track, and of all
FRAMES_BEFORE = 100
PLACES = 4  # at which one station is followed
CLOCK_JITTER_NS = 250_000_000  # by which the delay of a station's CAM varies on the channel and on this computer


@dataclass
class Track:
    """One vehicle."""

    number: int
    slot: int  # row in the table's arrays
    station_ids: list[int]
    since_ns: int  # first CAM that the estimate rests on
    updated_ns: int  # time of the last CAM
    received_ns: int
    clock_offset_ns: int  # added to the CAM's times
    length_m: float | None = None
    frames: deque[Received] = field(default_factory=deque)  # the last used, in the order of use
    frame_bytes: int = 0
    has_passage: bool = False
    predecessor: "Track | None" = None  # a track that this one may continue under a new station ID ...
    silent_for_ns: int = 0  # ... once that has been silent for so long
    others: tuple["Track", ...] = ()  # that it may continue as well, if they stay silent
    born_ns: int = 0  # time of the first CAM
    authentication: Authentication = Authentication.UNSIGNED  # least of its CAM
    unverified: Unverified | None = None  # why its newest CAM is signed and not authenticated
    sender: Sender = (0, None, 0)
    is_continued: bool = False  # by another one
    innovation: float = 1.0  # mean square of its innovations over what they should be

    @property
    def inflation(self) -> float:
        """Factor by which a vehicle's positions err more than the model, and it itself, say; never below 1.

        Learned from the innovations since the track, or its passage, began.
        """
        return min(max(1.0, sqrt(self.innovation) / CHANCE), MOST_INFLATION)

    def learn(self, ratio: float) -> None:
        """Use the square of an innovation over its variance; one outlier counts no more than the largest factor."""
        self.innovation += (min(ratio, MOST_INFLATION**2) - self.innovation) / LEARNED_CAMS

    @property
    def ticket(self) -> str | None:
        """Authorization ticket, if its CAM are authenticated."""
        return self.sender[1]

    def keep(self, *frames: Received) -> None:
        """Keep frames behind those that are kept, as far as they may be evidence."""
        self.frames += frames
        self.frame_bytes += sum(len(frame[2]) for frame in frames)
        most = FRAMES if self.has_passage else FRAMES_BEFORE
        while len(self.frames) > most or (self.frame_bytes > TRACK_BYTES and len(self.frames) > 1):
            self.drop_oldest()

    def drop_oldest(self) -> None:
        """Drop the oldest frame."""
        self.frame_bytes -= len(self.frames.popleft()[2])

    @property
    def station_id(self) -> int:
        """The present pseudonym."""
        return self.station_ids[-1]


@dataclass(frozen=True)
class Update:
    """A track with the CAM that it has just used."""

    track: Track
    measured: CamMeasurement
    born: bool
    continues: Track | None = None  # track whose station ID is confirmed to have changed to this one's; it is deleted


def least(*states: Authentication) -> Authentication:
    """What is known of the sender of several CAM: as much as of the one of which the least is known."""
    order = tuple(Authentication)
    return min(states, key=order.index)


def away_from_prediction(
    moved: FloatArray, dt: FloatArray, heading: FloatArray, speed: FloatArray, speed_now: FloatArray, gate_m: float
) -> FloatArray:
    """Distance [m] of a vehicle from where n others must be if they went on; infinite if it cannot be one of them.

    Parameters
    ----------
    moved : ndarray, shape (n, 2)
        [m] From the last position of each.
    dt, heading, speed : ndarray, shape (n,)
        [s] Since then, [rad] and [m/s] then.
    speed_now : ndarray, shape (n,)
        [m/s] Of the vehicle.
    gate_m : float
        [m] Tolerance along the road.

    Notes
    -----
    With an acceleration of up to a = 3 m/s²: |s - v dt| <= gate + ½ a dt² along the road, 2 m across it, and
    |v_now - v| <= a dt + 1 m/s.
    """
    along = np.cos(heading) * moved[:, 0] + np.sin(heading) * moved[:, 1] - speed * dt
    across = np.cos(heading) * moved[:, 1] - np.sin(heading) * moved[:, 0]
    can_be = (
        (np.abs(along) <= gate_m + 0.5 * LINK_ACCELERATION * dt**2)
        & (np.abs(across) <= LINK_ACROSS_M)
        & (np.abs(speed_now - speed) <= LINK_ACCELERATION * dt + LINK_SPEED_M_S)
    )
    return np.where(can_be, np.hypot(along, across), np.inf)


class Repetitions:
    """The CAM of the last 70 s, to tell those that are received again: by the channel, or by who replays them.

    A replay may have other headers than the original, so that the digest is that of what a CAM states: who, when and
    where, and under which ticket it is authenticated. A copy without its signature is another CAM, so that it does not
    make the genuine one late. A CAM that is received again is remembered from then on.
    """

    def __init__(self) -> None:
        self._received_ns: dict[int, int] = {}  # by digest, in the order of reception

    def add(self, cam: Cam) -> str | None:
        """Remember a CAM; return why it is rejected if it was received before."""
        station = cam.station_id, ticket_of(cam)
        digest = hash((station, cam.generation_delta_time, cam.latitude_deg, cam.longitude_deg))
        before_ns = self._received_ns.pop(digest, None)
        self._received_ns[digest] = cam.received_ns
        while len(self._received_ns) > MAX_REMEMBERED or self._is_old(cam.received_ns):
            del self._received_ns[next(iter(self._received_ns))]
        if before_ns is None:
            return None
        return "replayed" if cam.received_ns - before_ns > CHANNEL_NS else "late_or_repeated"

    def __len__(self) -> int:
        return len(self._received_ns)

    def _is_old(self, now_ns: int) -> bool:
        return abs(now_ns - next(iter(self._received_ns.values()))) > REMEMBERED_NS


class TrackTable:
    """The tracks and their estimates, which are rows of arrays: one round of the IMM updates many vehicles."""

    def __init__(self, settings: Settings, plaza: Plaza, *, on_time: bool = False) -> None:
        self._settings, self._plaza = settings.track, plaza
        self.on_time = on_time  # the CAM's times are corrected already
        self._white_sd = settings.errors.white_sd_m
        self._imm = imm()
        self._numbers = count(1)
        self.by_station: dict[Sender, Track] = {}
        self._of_id: dict[int, dict[Sender, Track]] = {}  # the same by station ID
        self._strays: dict[tuple[int, str | None], tuple[int, CamMeasurement]] = {}  # how many in a row, and the last
        self._busy: set[int] = set()  # numbers of the tracks that have used a CAM of this round
        self.rejected: Counter[str] = Counter()
        self.repetitions = Repetitions()
        self.full_ns: int | None = None  # reception of the newest CAM that found no free track
        self.seen_since_ns = 0  # silence before the first CAM of this process is none
        self.used: list[tuple[int, Received]] = []  # clock offset and CAM, since it was emptied last
        size, start = self._settings.max_tracks, self._imm.start(observation([], 1.0))
        self._x = np.zeros((size, *start.x.shape[1:]))
        self._P = np.zeros((size, *start.P.shape[1:]))
        self._probability = np.zeros((size, *start.probability.shape[1:]))
        self._heading = start.heading
        self._free = list(range(size - 1, -1, -1))

    @property
    def tracks(self) -> list[Track]:
        """All tracks."""
        return list(self.by_station.values())

    def estimates(self, tracks: Sequence[Track]) -> Estimates:
        """Estimates of tracks, each at the time of its last CAM."""
        rows = [track.slot for track in tracks]
        return Estimates(self._x[rows], self._P[rows], self._probability[rows], self._heading)

    def use(self, cams: Sequence[Cam]) -> Iterator[list[Update]]:
        """Use a batch of CAM in rounds, in each of which a station occurs once.

        A round is computed when the one before is dealt with: the estimates are then those of its own CAM.
        """
        waiting = [measured for cam in cams if (measured := self._measured(cam))]
        while waiting:
            first: dict[tuple[int, str | None], CamMeasurement] = {}
            later = []
            for item in waiting:
                if first.setdefault(item.station, item) is not item:
                    later.append(item)
            if updates := self._round(list(first.values())):
                yield updates
            waiting = later

    def restart(self, update: Update) -> None:
        """Begin a track's estimate anew with its newest CAM: what follows depends on the CAM from here on only."""
        track = update.track
        track.since_ns, track.authentication = update.measured.time_ns, update.measured.cam.authentication
        track.frames, track.frame_bytes, track.innovation = deque(), 0, 1.0
        track.keep(_received(update.measured.cam))
        self._put([track], self._imm.start(observation([update.measured], self._white_sd)))

    def continue_clock(self, cam: Cam, clock_offset_ns: int) -> None:
        """Correct the times of a station from here on as before a restart; its CAM so far were corrected already."""
        for track in self.tracks_of(cam.station_id):
            if track.ticket is None and ticket_of(cam) is None:
                track.clock_offset_ns = clock_offset_ns

    def tracks_of(self, station_id: int) -> list[Track]:
        """Tracks that use a station ID now, under any ticket and at any place."""
        return list(self._of_id.get(station_id, {}).values())

    def delete_silent(self, now_ns: int) -> list[Track]:
        """Delete the tracks that have been silent for too long; return them."""
        limit_ns = round(self._settings.deleted_after_s * 1e9)
        silent = [track for track in self.tracks if now_ns - track.received_ns > limit_ns]
        for track in silent:
            self._delete(track)
        return silent

    def _measured(self, cam: Cam) -> CamMeasurement | None:
        """Place of a CAM in the plane; None if it cannot be used."""
        if reason := self.repetitions.add(cam):
            self.rejected[reason] += 1
            return None
        if cam.latitude_deg is None or cam.longitude_deg is None:
            self.rejected["no_position"] += 1
            return None
        if cam.position_out_of_range:
            self.rejected["position_cannot_be_trusted"] += 1
            return None
        if reason := self._wrong_time(cam):
            self.rejected[reason] += 1
            return None
        north, east = self._plaza.plane(cam.latitude_deg, cam.longitude_deg)
        if hypot(north, east) > self._settings.range_m:
            self.rejected["out_of_range"] += 1
            return None
        return CamMeasurement(cam, 0, east, north)

    def _wrong_time(self, cam: Cam) -> str | None:
        """Why an authenticated CAM is not used: it was relayed late, or the clock of its station is wrong."""
        limit_ns = self._settings.clock_limit_s * 1e9
        age_ns = cam.received_ns - cam.sampled_ns
        if self.on_time or ticket_of(cam) is None or abs(age_ns) <= limit_ns:
            return None
        return "too_old" if age_ns > 0 else "from_the_future"

    def _on_unit_time(self, one: CamMeasurement) -> CamMeasurement:
        """Correct the time of a CAM: a station whose clock is wrong keeps the offset of its first CAM.

        That of an authenticated station is signed, and is used as it is: who relays its CAM must not shift its times.
        """
        track, cam = self.by_station.get(one.sender), one.cam
        age_ns = cam.received_ns - cam.sampled_ns
        offset_ns = 0
        if one.is_authenticated or self.on_time:
            return one
        if track is not None:
            offset_ns = track.clock_offset_ns
        elif not 0 <= age_ns <= self._settings.clock_limit_s * 1e9:
            offset_ns = age_ns
        if not offset_ns:
            return one
        corrected = cam.model_copy(update={"sampled_ns": cam.sampled_ns + offset_ns})
        return replace(one, cam=corrected, clock_offset_ns=offset_ns)

    def _began_late(self, track: Track, one: CamMeasurement) -> bool:
        """Whether a track's clock offset is in part the delay of its first CAM, as of one that somebody has relayed.

        No CAM arrives before it is sent, so that the least offset of a vehicle is the nearest to that of its clock.
        """
        if one.is_authenticated or self.on_time:
            return False
        age_ns = one.cam.received_ns - one.cam.sampled_ns + one.clock_offset_ns
        is_younger = age_ns < track.clock_offset_ns - CLOCK_JITTER_NS
        return is_younger and self._distance(track, one) <= self._settings.gate_m

    def _round(self, measured: Sequence[CamMeasurement]) -> list[Update]:
        """Use one CAM of each of several stations."""
        known, new_tracks = list[tuple[Track, CamMeasurement]](), list[CamMeasurement]()
        self._busy.clear()
        self._make_room(measured)
        for item in map(self._on_unit_time, map(self._placed, measured)):
            track = self.by_station.get(item.sender)
            if track is not None and self._began_late(track, item):
                self._delete(track)
                new_tracks.append(self._on_unit_time(_as_stated(item)))
            elif track is None:
                new_tracks.append(item)
            elif item.time_ns <= track.updated_ns and self._is_elsewhere(track, item):
                self._stray(item, new_tracks)
            elif item.time_ns <= track.updated_ns:
                self.rejected["late_or_repeated"] += 1
            elif item.time_ns - track.updated_ns > self._settings.deleted_after_s * 1e9:
                self._delete(track)
                new_tracks.append(item)
            else:
                known.append((track, item))
        updates = self._continue(known, new_tracks) if known else []
        new_tracks.sort(key=lambda item: not item.is_authenticated)  # who is known first, as there may be little room
        updates += [update for new_track in new_tracks if (update := self._start_track(new_track))]
        self._keep_budget()
        return updates

    def _keep_budget(self) -> None:
        """Drop the oldest half of the frames of the track with the most, an unknown sender's first, until all fit."""
        held = sum(track.frame_bytes for track in self.by_station.values())
        while held > TABLE_BYTES:
            several = [track for track in self.by_station.values() if len(track.frames) > 1]
            if not several:
                return
            largest = max(several, key=lambda track: (track.ticket is None, track.frame_bytes))
            held -= largest.frame_bytes
            for _ in range(len(largest.frames) // 2):
                largest.drop_oldest()
                self.rejected["frame_dropped"] += 1
            held += largest.frame_bytes

    def _continue(
        self, known: Sequence[tuple[Track, CamMeasurement]], new_tracks: list[CamMeasurement]
    ) -> list[Update]:
        """Use the CAM of existing tracks inside their gates.

        A station ID whose CAM are outside the gate several times is used by another vehicle as well: the CAM is added
        to `new_tracks`.
        """
        dt = np.array([(measured.time_ns - track.updated_ns) * 1e-9 for track, measured in known])
        predicted = self._imm.predict(self.estimates([track for track, _ in known]), dt)
        away = predicted.mean[:, :2] - np.array([[measured.east, measured.north] for _, measured in known])
        variance = np.trace(predicted.cov[:, :2, :2], axis1=1, axis2=2)
        inside = np.hypot(away[:, 0], away[:, 1]) <= self._settings.gate_m + 5.0 * np.sqrt(variance)
        for (_, item), is_inside in zip(known, inside, strict=True):
            if not is_inside:
                self._stray(item, new_tracks)
        used = [pair for pair, is_inside in zip(known, inside, strict=True) if is_inside]
        if used:
            inflation = [track.inflation for track, _ in used]
            seen = observation([measured for _, measured in used], self._white_sd, inflation)
            expected = variance[inside] + np.trace(seen.R[:, :2, :2], axis1=1, axis2=2)
            for (track, _), ratio in zip(used, (np.vecdot(away, away)[inside] / expected).tolist(), strict=True):
                track.learn(ratio * track.inflation**2)
            self._put([track for track, _ in used], self._imm.update(predicted[inside], seen))
        self._busy.update(track.number for track, _ in used)
        return [self._noted(track, measured, born=False) for track, measured in used]

    def _placed(self, one: CamMeasurement) -> CamMeasurement:
        """Choose the place of a CAM of a station that is followed at several: the nearest prediction."""
        station, ticket = one.station
        senders = [(station, ticket, place) for place in range(PLACES)]
        tracks = [track for sender in senders if (track := self.by_station.get(sender))]
        if not tracks:
            return one
        if len(tracks) == 1:
            return replace(one, place=tracks[0].sender[2])
        return replace(one, place=min(tracks, key=lambda track: self._distance(track, one)).sender[2])

    def _distance(self, track: Track, one: CamMeasurement) -> float:
        """Distance [m] of a CAM from where its track was or will be, at constant speed."""
        east, north, heading, speed = self.estimates([track]).mean[0, :4].tolist()
        dt = (one.cam.sampled_ns + track.clock_offset_ns - one.clock_offset_ns - track.updated_ns) * 1e-9
        return float(
            hypot(one.east - east - speed * dt * np.cos(heading), one.north - north - speed * dt * np.sin(heading))
        )

    def _is_elsewhere(self, track: Track, one: CamMeasurement) -> bool:
        """Whether a CAM that is no newer than its track's last one cannot be an older one of the same vehicle."""
        dt = (one.time_ns - track.updated_ns) * 1e-9
        return self._distance(track, one) > self._settings.gate_m + 0.5 * LINK_ACCELERATION * dt**2

    def _stray(self, one: CamMeasurement, new_tracks: list[CamMeasurement]) -> None:
        """Count a CAM outside its track's gate; after several of one vehicle the station is followed there too.

        CAM inside the gate between them do not matter: two vehicles that use one station ID alternate.
        """
        self.rejected["outside_gate"] += 1
        number, last = self._strays.pop(one.station, (0, one))
        elapsed_s = abs(one.cam.received_ns - last.cam.received_ns) * 1e-9
        away = hypot(one.east - last.east, one.north - last.north)
        is_same = elapsed_s < self._settings.deleted_after_s and away <= self._settings.gate_m + MAX_SPEED * elapsed_s
        number = number + 1 if is_same else 1
        if number < self._settings.jumps:
            self._strays[one.station] = number, one
            while len(self._strays) > self._settings.max_tracks:
                del self._strays[next(iter(self._strays))]
            return
        station, ticket = one.station
        free = [place for place in range(PLACES) if (station, ticket, place) not in self.by_station]
        if not free:
            self.rejected["too_many_places"] += 1
            return
        new_tracks.append(self._on_unit_time(replace(_as_stated(one), place=free[0])))

    def _make_room(self, measured: Sequence[CamMeasurement]) -> None:
        """Delete the tracks of unknown senders that are silent for longest, for authenticated stations without a track.

        Anybody can send any number of station IDs; they must not keep out a vehicle that proves who it is.
        """
        new = sum(item.is_authenticated and not self._is_followed(item) for item in measured)
        if new <= len(self._free):
            return
        unknown = sorted((track for track in self.tracks if track.ticket is None), key=lambda track: track.received_ns)
        for track in unknown[: new - len(self._free)]:
            self.rejected["track_evicted"] += 1
            self.full_ns = max(item.cam.received_ns for item in measured)
            self._delete(track)

    def _is_followed(self, one: CamMeasurement) -> bool:
        return any((*one.station, place) in self.by_station for place in range(PLACES))

    def _start_track(self, one: CamMeasurement) -> Update | None:
        """Begin a track with a CAM of an unknown station."""
        if not self._free:
            self.rejected["too_many_tracks"] += 1
            self.full_ns = one.cam.received_ns
            return None
        track = Track(
            number=next(self._numbers),
            slot=self._free.pop(),
            station_ids=[one.cam.station_id],
            since_ns=one.time_ns,
            updated_ns=one.time_ns,
            received_ns=one.cam.received_ns,
            clock_offset_ns=one.clock_offset_ns,
            authentication=one.cam.authentication,
            sender=one.sender,
        )
        track.predecessor, track.silent_for_ns, track.others = self._silent_here(one)
        track.born_ns = one.time_ns
        self.by_station[one.sender] = track
        self._of_id.setdefault(one.sender[0], {})[one.sender] = track
        self._put([track], self._imm.start(observation([one], self._white_sd)))
        return self._noted(track, one, born=True)

    def _silent_here(self, one: CamMeasurement) -> tuple[Track | None, int, tuple[Track, ...]]:
        """Find the nearest track whose prediction is where an unknown station appears.

        What is authenticated continues, and is continued by, only what is: frames that anybody can send neither put a
        continuation in doubt nor take a passage over.

        Returns
        -------
        Track or None, int, tuple of Track
            The track, [ns] the silence of its station ID that confirms that it has changed, and the other tracks that
            are possible.
        """
        tracks = [
            track for track in self.tracks
            if (track.ticket is not None) is one.is_authenticated
            and 0 < one.time_ns - track.updated_ns < 2.0 * self._settings.link_after_s * 1e9
        ]  # fmt: skip
        if not tracks:
            return None, 0, ()
        state = self.estimates(tracks).mean
        dt = (one.time_ns - np.array([track.updated_ns for track in tracks])) * 1e-9
        speed = state[:, 3] if one.cam.speed_m_s is None else np.full(len(dt), one.cam.speed_m_s)
        moved = np.array([one.east, one.north]) - state[:, :2]
        distance = away_from_prediction(moved, dt, state[:, 2], state[:, 3], speed, self._settings.link_gate_m)
        nearest = int(np.argmin(distance))
        if not np.isfinite(distance[nearest]):
            return None, 0, ()
        others = tuple(tracks[k] for k in np.flatnonzero(np.isfinite(distance)) if k != nearest)
        return tracks[nearest], self._settings.silence_ns(state[nearest, 3]), others

    def _noted(self, track: Track, one: CamMeasurement, *, born: bool) -> Update:
        track.updated_ns, track.received_ns = one.time_ns, one.cam.received_ns
        track.length_m = one.cam.vehicle_length_m or track.length_m
        track.authentication = least(track.authentication, one.cam.authentication)
        track.unverified = one.cam.unverified
        track.keep(_received(one.cam))
        self.used.append((track.clock_offset_ns, track.frames[-1]))
        return Update(track, one, born, self._confirmed_predecessor(track))

    def _confirmed_predecessor(self, track: Track) -> Track | None:
        """Decide whether a track continues its predecessor.

        Only if the old station ID is not used any more, and if neither another silent track can be this one, nor
        another new one that: which of two has which contract is not guessed.
        """
        old = track.predecessor
        if old is None:
            return None
        owner = self.by_station.get(old.sender)
        if old.updated_ns >= track.born_ns or owner not in (None, old):  # both station IDs are in use
            track.predecessor = None
            return None
        if old.number in self._busy or track.updated_ns - max(old.updated_ns, self.seen_since_ns) < track.silent_for_ns:
            return None
        track.predecessor, others, track.others = None, track.others, ()
        if any(other.updated_ns < track.born_ns and not other.is_continued for other in others) or any(
            claimant.predecessor is old or old in claimant.others for claimant in self.by_station.values()
        ):
            self.rejected["ambiguous_continuation"] += 1
            return None
        old.is_continued = True
        track.station_ids = (old.station_ids + track.station_ids)[-STATION_IDS:]
        own, track.frames, track.frame_bytes = track.frames, deque(), 0
        track.has_passage = track.has_passage or old.has_passage
        track.keep(*old.frames, *own)
        track.since_ns = old.since_ns
        track.authentication = least(track.authentication, old.authentication)
        track.length_m = track.length_m or old.length_m
        if owner is old:
            self._delete(old)
        return old

    def _put(self, tracks: Sequence[Track], estimates: Estimates) -> None:
        rows = [track.slot for track in tracks]
        self._x[rows], self._P[rows], self._probability[rows] = estimates.x, estimates.P, estimates.probability

    def _delete(self, track: Track) -> None:
        del self.by_station[track.sender]
        del self._of_id[track.sender[0]][track.sender]
        if not self._of_id[track.sender[0]]:
            del self._of_id[track.sender[0]]
        self._free.append(track.slot)
        track.predecessor, track.others = None, ()  # its own claims end, and no chain of tracks is kept alive
        if not any(claimant.predecessor is track for claimant in self.by_station.values()):
            track.frames, track.frame_bytes = deque(), 0


def _as_stated(one: CamMeasurement) -> CamMeasurement:
    """A CAM with the time that its station states."""
    cam = one.cam.model_copy(update={"sampled_ns": one.cam.sampled_ns - one.clock_offset_ns})
    return replace(one, cam=cam, clock_offset_ns=0)


def _received(cam: Cam) -> Received:
    return cam.sampled_ns, cam.received_ns, cam.frame, cam.authentication.value, cam.signer
