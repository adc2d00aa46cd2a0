"""Reports position, verdict and events to a control centre: outbox, link, watch sessions and renewal in one loop."""

import logging
import time
from collections.abc import Iterator

from pydantic import Field

from shared.bus.bus import Bus, Envelope, decoded
from shared.evidence import EvidenceError, KeyFile, keys_folder
from shared.evidence.signer import Signer
from shared.faults import Faults
from shared.fleet.batch import Event
from shared.fleet.cbor import BadCbor
from shared.fleet.identity import identity_folder
from shared.fleet.receipts import Receipt
from shared.fleet.times import RESTING_S
from shared.fleet.topics import BATCH, LIVE, RECEIPT
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationSolution
from shared.messages.operation import HostClock, Origin, OriginKind
from shared.messages.toll import TollTransaction
from shared.messages.trust import TrustState
from shared.messages.uplink import UplinkState
from shared.runtime.config import Section
from shared.topics import on_request, subscriptions

from .enrolment import Enrolment
from .link import Link
from .outbox import Backlog, OutboxFault, alone
from .reporting import CLOCK, ReportWriter
from .sampling import Sampler, Tracking, event_of
from .sending import KEY, WINDOW, BatchSelection
from .utc import Utc
from .watching import BadWatch, Watch

log = logging.getLogger(__name__)

NAME = "monitoring.uplink"
FOLDER = "uplink"  # of the state folder
NS = 1_000_000_000
PAUSE_S, WATCHED_PAUSE_S = 0.15, 0.05  # between two looks at the bus: most of a message's cost is to wake up for it
FLUSH_NS, SLOW_FLUSH_NS, FAST_FLUSH_NS = 10 * NS, RESTING_S * NS, NS
MAX_PRODUCERS = 16  # of origin/state that are remembered
STATE_NS, QUIET_STATE_NS = NS, 10 * NS  # between two states: while something changes, and in any case
SOLUTION = "navigation/solution"
CLOCK_NOT_SET = (
    "the clock is not set: there was no GNSS time yet, and nothing holds the host's clock; no reports are made"
)
OWN = frozenset(topic.name for topic in subscriptions(NAME))
MB = 1_000_000
NO_BACKLOG = Backlog(0, 0, 0, None)


class Config(Section):
    """How much the centre is told, and how much is kept while it cannot be reached."""

    tracking: Tracking = Field(
        default=Tracking.LIVE,
        description="live: position and verdict once a second, and people of the centre may watch; trips: positions "
        "while the vehicle moves, sent once a minute; verdict: no positions; off: connects and sends nothing. "
        "People can watch with live alone",
    )
    outbox_mb: int = Field(
        default=200,
        ge=1,
        le=100_000,
        description="reports that wait for the centre, in megabytes: 110 kB an hour of driving; when it is full, the "
        "oldest positions are dropped, and a signed gap says so",
    )


class Process:
    """One loop over the bus and the connection to the centre."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._utc, self._watch = Utc(), Watch()
        self._solution: Envelope | None = None  # the newest, not decoded
        self._look_ns = self._flush_ns = self._flushed_ns = 0
        self._events_due = self._flush_due = False
        self._sessions = self._renewals = 0
        self._linked = False  # at the last turn
        self._followed: frozenset[str] = frozenset()
        self._origins: dict[str, tuple[OriginKind, str]] = {}  # of each producer
        self._told: UplinkState | None = None  # the last state

    def run(self, bus: Bus) -> None:
        """Work until the bus stops; raises `UserError` where another process has the outbox of this unit."""
        with alone(bus.state_dir / FOLDER):
            self._begin(bus)
            try:
                while not bus.stopping:
                    self.turn(bus)
                    self._link.wait(WATCHED_PAUSE_S if self._watch.is_on(bus.now_ns()) else PAUSE_S)
                self._end(bus)
            finally:
                self._link.close()
                self._reporting.close()

    def _begin(self, bus: Bus) -> None:
        self._faults = Faults(bus.rejects)
        self._sampler = Sampler(self._config.tracking, bus.now_ns())
        self._link = Link(bus.rejects)
        self._enrolment = Enrolment(identity_folder(bus.state_dir))
        self._key = KeyFile(keys_folder(bus.state_dir))
        path = bus.state_dir / FOLDER / "outbox.sqlite"
        self._reporting = ReportWriter(path, self._config.outbox_mb * MB, bus.rejects)

    def turn(self, bus: Bus) -> None:
        """Do what is to be done now."""
        for envelope in bus.receive(0.0):
            with self._faults.handling(bus.now_ns()):
                self._take(bus, envelope)
        now_ns = bus.now_ns()
        self._link.use(self._enrolment.look(now_ns))
        signer, fault = self._signer()
        if signer is not None:
            self._report(bus, signer, now_ns)
            self._talk(bus, signer, now_ns)
        self._follow(bus, now_ns)
        self._tell(bus, now_ns, fault)

    def _end(self, bus: Bus) -> None:
        """Sign what is pending, and send it if there is a connection."""
        signer, _ = self._signer()
        now_ns = bus.now_ns()
        if signer is not None and (utc_ns := self._utc.ns(now_ns)) is not None:
            self._reporting.store(now_ns)
            self._reporting.flush(signer, now_ns, utc_ns // 1_000_000)
            self._talk(bus, signer, now_ns)

    def _take(self, bus: Bus, envelope: Envelope) -> None:
        now_ns = bus.now_ns()
        if envelope.recorded_ns is not None:
            bus.rejects["replay"] += 1
            return
        if self._watch.is_on(now_ns) and self._watch.wants(envelope.topic, envelope.payload, now_ns):
            self._pass_on(bus, envelope)
        if envelope.topic == SOLUTION:
            self._solution = envelope
        elif envelope.topic in OWN and (message := decoded(bus, envelope)) is not None:
            self._use(message, envelope, now_ns)

    def _use(self, message: Message, envelope: Envelope, now_ns: int) -> None:
        match message:
            case TrustState():
                self._sampler.add_trust(message)
                self._look_ns = 0
            case GnssFix():
                self._utc.add_fix(message, excluded=self._sampler.gnss_excluded)
            case HostClock():
                self._utc.add_clock(message)
            case Origin():
                if not envelope.retained and self._is_new(envelope.producer, message):
                    self._add_event(message, envelope.topic, now_ns)
            case _ if not envelope.retained and self._config.tracking is not Tracking.OFF:
                self._add_event(message, envelope.topic, now_ns)

    def _is_new(self, producer: str, origin: Origin) -> bool:
        """Whether a producer's data come from elsewhere than before: nobody takes a simulation for a vehicle."""
        if self._utc.offset_ns is None or self._config.tracking is Tracking.OFF:
            return False
        now = origin.kind, origin.name
        if self._origins.get(producer) == now:
            return False
        if len(self._origins) >= MAX_PRODUCERS:
            self._origins.clear()
        self._origins[producer] = now
        return True

    def _add_event(self, message: Message, topic: str, now_ns: int) -> None:
        utc_ns = self._utc.ns(now_ns)
        if utc_ns is None:
            return
        places = self._sampler.shows_positions(now_ns)
        event = event_of(message, topic, utc_ns // 1_000_000, places=places or isinstance(message, TollTransaction))
        if event is not None:
            self._reporting.add(event)
            self._events_due = True

    def _pass_on(self, bus: Bus, envelope: Envelope) -> None:
        """Give a message to whom watches; one that the network does not take at once is left out."""
        if not self._link.is_ready or not self._link.publish(f"{LIVE}/{envelope.topic}", envelope.payload):
            bus.rejects["live message"] += 1

    def _signer(self) -> tuple[Signer | None, str | None]:
        try:
            return self._key.signer(), None
        except EvidenceError as error:
            return None, f"reports are not signed: {error}"

    def _report(self, bus: Bus, signer: Signer, now_ns: int) -> None:
        """Sample, store and make batches of what is due."""
        identity, utc_ns = self._enrolment.identity, self._utc.ns(now_ns)
        if utc_ns is None or identity is None:
            return
        self._enrolment.renew(now_ns, utc_ns, signer)
        utc_ms = utc_ns // 1_000_000
        for jump in self._utc.jumps:
            log.warning("the clock jumps from %d to %d ms (%s)", *jump)
            bus.rejects["clock jump"] += 1
            self._reporting.add(Event(utc_ms, CLOCK, jump._asdict()))
            self._events_due = True
        self._utc.jumps.clear()
        self._sample(bus, now_ns)
        if not self._reporting.open(identity.centre.vehicle, now_ns, utc_ms):
            return
        self._reporting.store(now_ns)
        self._flush(signer, now_ns, utc_ms)

    def _sample(self, bus: Bus, now_ns: int) -> None:
        if now_ns < self._look_ns:
            return
        self._look_ns = (now_ns // NS + 1) * NS
        if (envelope := self._solution) is not None:
            self._solution = None
            if isinstance(solution := decoded(bus, envelope), NavigationSolution):
                self._sampler.add_solution(solution)
        if self._sampler.is_due(now_ns) and self._utc.offset_ns is not None:
            report, changed = self._sampler.report(now_ns, self._utc.offset_ns)
            self._reporting.add(report)
            at_once = changed and self._config.tracking is not Tracking.TRIPS
            self._flush_due |= at_once or self._sampler.is_parked(now_ns)  # a minute's report is not kept for another

    def _flush(self, signer: Signer, now_ns: int, utc_ms: int) -> None:
        slow = self._config.tracking is Tracking.TRIPS or self._sampler.is_parked(now_ns)
        period_ns = FAST_FLUSH_NS if self._watch.is_on(now_ns) else SLOW_FLUSH_NS if slow else FLUSH_NS
        since_ns = now_ns - self._flush_ns
        if self._flush_due or since_ns >= period_ns or since_ns < 0:
            self._reporting.flush(signer, now_ns, utc_ms)
            self._flush_ns, self._flush_due, self._events_due = now_ns, False, False
        elif self._events_due:
            self._reporting.flush(signer, now_ns, utc_ms, events_only=True)
            self._events_due = False

    def _talk(self, bus: Bus, signer: Signer, now_ns: int) -> None:
        """Read what the centre has sent, and send what is due."""
        messages = self._link.turn(time.monotonic())
        if self._linked and not self._link.connected:
            self._watch.end()  # nobody sees anything; the centre asks again when it is there again
        self._linked = self._link.connected
        sending = self._reporting.sending
        if self._link.sessions != self._sessions:
            self._sessions = self._link.sessions
            if sending is not None:
                sending.restart()
        for noun, payload in messages:
            if noun == RECEIPT:
                self._settle(bus, sending, payload, signer, now_ns)
            else:
                self._begin_watch(bus, payload, now_ns)
        if self._reporting.sending is not None and self._config.tracking is not Tracking.OFF:
            self._send(self._reporting.sending, now_ns)

    def _settle(self, bus: Bus, sending: BatchSelection | None, payload: bytes, signer: Signer, now_ns: int) -> None:
        utc_ns = self._utc.ns(now_ns)
        if sending is None or sending is not self._reporting.sending or utc_ns is None:
            return
        try:
            sending.take(Receipt.decode(payload), signer, now_ns, utc_ns // 1_000_000)
        except BadCbor:
            bus.rejects["receipt"] += 1
        except OutboxFault as error:
            self._reporting.failed(error, now_ns)

    def _begin_watch(self, bus: Bus, payload: bytes, now_ns: int) -> None:
        if self._config.tracking is not Tracking.LIVE:
            bus.rejects["watch"] += 1
            return
        try:
            self._watch.take(payload, now_ns)
        except BadWatch as error:
            bus.rejects["watch"] += 1
            log.warning("a request to watch this vehicle cannot be used: %s", error)

    def _send(self, sending: BatchSelection, now_ns: int) -> None:
        try:
            if self._enrolment.renewals != self._renewals:  # another evidence key may be known now
                sending.outbox.reopen(KEY)
                self._renewals = self._enrolment.renewals
            for _ in range(WINDOW):
                if not self._link.is_ready or (found := sending.next(now_ns)) is None:
                    return
                self._link.publish(BATCH, found[1])
        except OutboxFault as error:
            self._reporting.failed(error, now_ns)

    def _follow(self, bus: Bus, now_ns: int) -> None:
        """Subscribe to what is watched, while it is watched."""
        wanted = self._watch.topics - OWN if self._watch.is_on(now_ns) else frozenset[str]()
        if wanted != self._followed:
            self._followed = wanted
            bus.also([topic for topic in on_request(NAME) if topic.name in wanted])

    def _tell(self, bus: Bus, now_ns: int, fault: str | None) -> None:
        """Publish the state: at most once a second if it has changed, and every ten seconds."""
        before = self._told
        since_ns = QUIET_STATE_NS if before is None else now_ns - before.now_ns
        if 0 <= since_ns < STATE_NS:
            return
        state = self._state(now_ns, fault)
        same = before is not None and state == before.model_copy(update={"now_ns": now_ns})
        if same and 0 <= since_ns < QUIET_STATE_NS:
            return
        if state.offline or (before is not None and bus.last_error == before.offline):
            bus.last_error = state.offline
        self._told = state
        bus.publish(state)

    def _faulty(self, fault: str | None) -> Iterator[str]:
        """Tell what keeps this process from its work, the gravest first."""
        reasons = (fault, self._enrolment.fault, self._reporting.fault,
                   None if self._utc.offset_ns is not None else CLOCK_NOT_SET,
                   self._link.fault, self._enrolment.renewal_fault)  # fmt: skip
        return (reason[:400] for reason in reasons if reason is not None)

    def _state(self, now_ns: int, fault: str | None) -> UplinkState:
        identity, sending = self._enrolment.identity, self._reporting.sending
        centre = identity.centre if identity is not None else None
        tally, waits = self._reporting.tally, NO_BACKLOG
        if sending is not None:
            try:
                waits = sending.outbox.backlog()
            except OutboxFault as error:
                self._reporting.failed(error, now_ns)
        watched = self._watch.is_on(now_ns)
        return UplinkState(
            now_ns=now_ns,
            connected=self._link.connected,
            offline=next(self._faulty(fault), None),
            centre=None if centre is None else f"{centre.host}:{centre.mqtt_port}",
            tracking=self._config.tracking.value,
            backlog_batches=waits.batches,
            backlog_refused=waits.refused,
            backlog_bytes=waits.bytes,
            oldest_ns=None if waits.oldest_ms is None else waits.oldest_ms * 1_000_000,
            sent=tally.sent,
            receipted=tally.receipted,
            refused=tally.refused,
            dropped=self._reporting.dropped,
            sent_bytes=self._link.sent_bytes,
            watchers=self._watch.watchers if watched else 0,
            watched_until_ns=self._watch.until_ns if watched else None,
            certificate_until_ns=None if centre is None else centre.not_after_ns,
        )
