"""Tracks vehicles at a toll plaza by their CAM, decides their lanes and follows their passages."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from pydantic import Field

from shared.errors import ConfigError, RejectedFrame
from shared.messages.base import Tick
from shared.messages.gnss import GnssFix
from shared.messages.toll import (
    EvidenceFrame,
    GateCommand,
    OpenPassages,
    PassageState,
    PlazaDescription,
    RestoredCams,
    TollAlarm,
    TollDelta,
    TollPassage,
    TollRegistration,
    TollTracks,
    UsedCams,
)
from shared.messages.v2x import Cam, CamList
from shared.runtime.config import vehicle_in
from shared.toll.plaza import load_plaza
from shared.toll.simulated import operator
from shared.v2x.evidence import cam_of

from .core import DELTAS_AT_ONCE, SECOND_NS, Core, derive
from .passages import passage_id
from .settings import Settings

In = CamList | GnssFix | TollRegistration | OpenPassages | RestoredCams | TollDelta | Tick
Out = PlazaDescription | TollAlarm | TollDelta | TollTracks | TollPassage | GateCommand | UsedCams
SIMULATOR = "sensors.traffic"
TRACKS_NS = 500_000_000  # period of `toll/tracks` while CAM arrive
USED_CAM_PERIOD_NS = 500_000_000  # period of `toll/used_cam`
DELTA_NS = 900_000_000  # least distance of two deltas; receivers send one fix a second, or more
NO_FIX_NS = 2_000_000_000  # without a fix for so long, a tick publishes why there is no delta


class Config(Settings):
    """Settings of core.toll."""

    plaza_file: Path = Field(
        default=Path("deploy/plazas/example.geojson"),
        description="GeoJSON file of the plaza, relative to the working folder or repository",
    )

    def model_post_init(self, context: object) -> None:
        """Raise `ConfigError` for a real plaza that requires signatures, and trusts the operator of the simulation."""
        vehicle = vehicle_in(context)
        if vehicle is None or SIMULATOR in vehicle.tables:
            return
        plaza = load_plaza(self.plaza_file)
        if plaza.require_authenticated and operator().public_key.hex() in plaza.operator_keys:
            raise ConfigError(
                f"{self.plaza_file}: operator_keys holds the key of the simulated operator, with which everybody can "
                f"countersign registrations; put that of the operator in its place, or run [{SIMULATOR}]"
            )


class Process:
    """Publishes passages and gate commands as they happen, tracks twice and the delta once a second.

    A new process asks the ledger for the CAM of the one before, and begins anew with them when they are there: what it
    has received meanwhile is used again behind them.
    """

    def __init__(self, config: Config) -> None:
        self._plaza = load_plaza(config.plaza_file)
        self._settings = Settings.model_validate(config.model_dump(exclude={"plaza_file"}))
        self._core = Core(self._plaza, self._settings)
        self._rejected: Counter[str] = Counter()
        self._since_ns: int | None = None  # the first tick
        self._ledger_since_ns: int | None = None
        self._backlog: list[In] | None = []  # received until the ledger has answered; None: it has, or does not
        self._restored: list[UsedCams] = []
        self._new_deltas: list[TollDelta] = []  # since the last `toll/used_cam`
        self._tracks_ns = self._delta_ns = self._used_ns = 0

    @property
    def rejects(self) -> Counter[str]:
        """Rejected messages by reason."""
        return self._core.rejected + self._rejected

    def handle(self, message: In) -> Iterator[Out]:
        """Use a message."""
        for answer in self._answers(message):
            if not isinstance(answer, TollPassage):
                yield answer
                continue
            yield from self._publish_used(answer.sampled_ns)  # what a statement follows from is there before it
            yield self._checked(answer)

    def _answers(self, message: In) -> Iterator[Out]:
        if self._backlog is not None and not isinstance(message, OpenPassages | RestoredCams):
            self._backlog.append(message)
        match message:
            case CamList():
                yield from self._core.use(message.cams)
                yield from self._tracks(message.received_ns)
                yield from self._used(message.received_ns)
            case GnssFix():
                self._core.fix(message)
                yield from self._delta(message.sampled_ns, DELTA_NS)
            case TollRegistration():
                self._core.register(message)
            case RestoredCams():
                if message.since_ns == self._since_ns:
                    self._restored.append(message.used)
            case OpenPassages():
                yield from self._continue(message)
            case TollDelta():  # retained: after a restart, the last one of the process before
                self._use_delta(message)
            case Tick():
                yield from self._tick(message.now_ns)

    def _tick(self, now_ns: int) -> Iterator[Out]:
        if self._since_ns is None:
            self._since_ns = now_ns
            yield self._plaza.description(now_ns)
            yield UsedCams(sampled_ns=now_ns, since_ns=now_ns, cams=())
        if now_ns - self._since_ns >= self._settings.passage.resume_wait_s * SECOND_NS:
            self._backlog = None
        yield from self._delta(now_ns, NO_FIX_NS)
        yield from self._core.tick(now_ns)
        if alarm := self._core.alarm(now_ns):
            yield alarm
        yield from self._tracks(now_ns)
        yield from self._used(now_ns)

    def _continue(self, message: OpenPassages) -> Iterator[Out]:
        """Take over from the process before, once the ledger has sent what that has used."""
        if self._backlog is not None:
            if message.core_since_ns not in (None, self._since_ns):
                return
            yield from self._restore(self._backlog, message)
            self._backlog, self._restored = None, []
        elif self._ledger_since_ns not in (None, message.since_ns):
            self._new_deltas = list(self._core.recall())
            yield from self._publish_used(message.sampled_ns, anew=True)
        self._ledger_since_ns = message.since_ns
        yield from self._core.continue_passages(message)

    def _restore(self, backlog: list[In], message: OpenPassages) -> Iterator[TollPassage]:
        """Begin anew with what the process before has used, and use the backlog behind it; it has stated nothing."""
        frames = [frame for part in self._restored for frame in part.cams]
        used = [(cam, frame.clock_offset_ns) for frame in frames if (cam := self._decoded(frame))]
        if not used:
            return
        deltas = [delta for part in self._restored for delta in part.deltas]
        self._core = Core(self._plaza, self._settings)
        yield from self._core.restore(used, deltas, message)
        for earlier in backlog:
            match earlier:
                case CamList():
                    list(self._core.use(earlier.cams))
                case GnssFix():
                    self._core.fix(earlier)
                case TollRegistration():
                    self._core.register(earlier)
                case TollDelta():
                    self._core.use_delta(earlier)
                case _:
                    pass

    def _checked(self, statement: TollPassage) -> TollPassage:
        """Note whether lane and crossing follow from the evidence, where that does not begin with the passage.

        Evidence that does begin with it gives the same result bit for bit; deriving it takes as long as tracking.
        """
        evidence = statement.evidence
        if evidence is None or passage_id(self._plaza.name, evidence.frames[0].data) == statement.passage_id:
            return statement
        cams = [cam for frame in evidence.frames if (cam := self._decoded(frame))]
        derived = derive(self._plaza, self._settings, cams, evidence.deltas)
        again = next((toll_passage for toll_passage in derived if toll_passage.state is PassageState.CROSSED), None)
        return statement.model_copy(update={"derivable": again is not None and again.lane == statement.lane})

    def _decoded(self, frame: EvidenceFrame) -> Cam | None:
        """Decode a frame once more; one that is no CAM is counted."""
        try:
            return cam_of(frame)
        except RejectedFrame as error:
            self._rejected[error.reason] += 1
            return None

    def _used(self, now_ns: int) -> Iterator[UsedCams]:
        """Publish what was used, for the process after this one."""
        if now_ns - self._used_ns >= USED_CAM_PERIOD_NS:
            self._used_ns = now_ns
            yield from self._publish_used(now_ns)

    def _publish_used(self, now_ns: int, *, anew: bool = False) -> Iterator[UsedCams]:
        if self._since_ns is None:
            return
        deltas, self._new_deltas = tuple(self._new_deltas), []
        while (cams := self._core.used()) or deltas:
            first, deltas = deltas[:DELTAS_AT_ONCE], deltas[DELTAS_AT_ONCE:]
            yield UsedCams(sampled_ns=now_ns, since_ns=self._since_ns, cams=cams, deltas=first, anew=anew)
            anew = False

    def _use_delta(self, delta: TollDelta) -> None:
        if self._core.use_delta(delta):  # the process after this one must use no other ones
            self._new_deltas.append(delta)

    def _delta(self, now_ns: int, period_ns: int) -> Iterator[TollDelta]:
        """Estimate the delta with a fix, not with a tick: it has to be there before the CAM that it belongs to."""
        if now_ns - self._delta_ns >= period_ns:
            self._delta_ns = now_ns
            delta = self._core.estimate_delta(now_ns)
            self._use_delta(delta)
            if self._backlog is not None:
                self._backlog.append(delta)
            yield delta

    def _tracks(self, now_ns: int) -> Iterator[TollTracks]:
        if now_ns - self._tracks_ns >= TRACKS_NS:
            self._tracks_ns = now_ns
            yield self._core.tracks(now_ns)
