"""The live runtime: one process, fed from the bus until SIGTERM."""

import gc
import importlib
import json
import logging
import os
import signal
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Protocol, cast

from ..bounded import SizeExceeded, read_bytes
from ..bus import codec
from ..bus.bus import QUEUE_LENGTH, Bus, Envelope, decoded
from ..errors import BadPayload
from ..faults import Faults
from ..kinds import Kinds
from ..load import Load
from ..maths.dates import is_plausible
from ..messages.base import Message, Persistent, RawBytes, StampedMessage, Tick
from ..messages.imu import ImuSamples
from ..messages.operation import ConsumptionOrder, ProcessLoad
from ..processes import BY_NAME
from ..settings.digests import digest_for, digest_in
from ..settings.held import HeldSettings
from ..topics import BY_MESSAGE, publications, subscriptions
from .clock import boot_id
from .config import Section, VehicleFile, broker_address, load_vehicle, settings_model, state_dir

log = logging.getLogger(__name__)

TICK_NS = 1_000_000_000
JOURNAL_S = 1.0
MAX_RUNS = 600  # in one message of the journal: 114 kB with the longest names
SERVE_S = 0.2  # longest time between two turns of the bus, which sends the heartbeats
PORTION_BYTES = 32 * 1024  # more than the chunk of a driver; whatever they hold takes less than 0.1 s


class Reactor(Protocol):
    """A process of layers 2 to 4: a function of its messages."""

    def handle(self, message: Message) -> Iterable[Message]:
        """Process one message and return the messages to publish."""
        ...


def arrival_ns(message: Message) -> int | None:
    """When the bytes of a message arrived at their driver; None for a message without such a stamp."""
    return message.received_ns if isinstance(message, (RawBytes, StampedMessage, ImuSamples)) else None


def portions(message: Message) -> Iterable[Message]:
    """Cut what is too long to be handled between two heartbeats, where it may be cut; its stamp stays."""
    if not isinstance(message, RawBytes) or not message.is_stream or len(message.data) <= PORTION_BYTES:
        return (message,)
    parts = (message.data[start : start + PORTION_BYTES] for start in range(0, len(message.data), PORTION_BYTES))
    return (message.model_copy(update={"data": part}) for part in parts)


def handled(
    process: Reactor, message: Message, faults: Faults, now_ns: int, meanwhile: Callable[[], None] = lambda: None
) -> Iterator[Message]:
    """Give a message to a process, and yield what follows; a fault costs this message, and not the process.

    `meanwhile` is called between the portions of a long one.
    """
    for portion in portions(message):
        with faults.handling(now_ns):
            yield from process.handle(portion)
        meanwhile()


class Runner(Protocol):
    """A process of layer 1 or 5, or one that works with files: it owns its loop."""

    def run(self, bus: Bus) -> None:
        """Work until `bus.stopping`."""
        ...


class Journal:
    """The order in which a process consumed its messages, in runs of neighbours."""

    def __init__(self, process: str, incarnation: int) -> None:
        self._process, self._incarnation = process, incarnation
        self._runs: list[tuple[str, str, int, int, int]] = []

    def add(self, envelope: Envelope) -> None:
        """Note that a message was consumed."""
        self._append(envelope.topic, envelope.producer, envelope.incarnation, envelope.sequence)

    def add_tick(self, tick: Tick) -> None:
        """Note that a tick was consumed."""
        self._append("tick", "", tick.now_ns, 0)

    def add_close(self) -> None:
        """Note that `close` of the process was called."""
        self._append("close", "", 0, 0)

    def take(self) -> Iterator[ConsumptionOrder]:
        """The runs since the last call, in messages that the broker passes on; none without any."""
        while self._runs:
            runs, self._runs = tuple(self._runs[:MAX_RUNS]), self._runs[MAX_RUNS:]
            yield ConsumptionOrder(process=self._process, incarnation=self._incarnation, runs=runs)

    def _append(self, topic: str, producer: str, incarnation: int, sequence: int) -> None:
        if self._runs:
            last_topic, last_producer, last_incarnation, first, count = self._runs[-1]
            same = (last_topic, last_producer, last_incarnation) == (topic, producer, incarnation)
            if same and sequence == first + count and topic != "tick":
                self._runs[-1] = (topic, producer, incarnation, first, count + 1)
                return
        self._runs.append((topic, producer, incarnation, sequence, 1))


def load_process(name: str, vehicle: VehicleFile) -> object:
    """Construct a process with its section of the vehicle's file."""
    return _made(name, vehicle.section(name, settings_model(name)))


def _made(name: str, section: Section) -> object:
    module = importlib.import_module(f"services.{name}.process")
    return cast("Callable[[Section], object]", module.Process)(section)


def run_process(name: str, vehicle: VehicleFile, reread: Callable[[], VehicleFile] = load_vehicle) -> None:
    """Run one process until SIGTERM or SIGINT, or until its settings have changed: it ends with `EX_TEMPFAIL` then.

    `reread` reads the file again: a process ends only if its next life has other settings than this one.
    """
    start_logging(name)
    os.umask(0o007)  # processes with users of their own share the state folder by their group
    section = vehicle.section(name, settings_model(name))
    process = _made(name, section)
    bus = Bus(name, vehicle.name, broker_address(), subscriptions(name), state_dir())
    bus.vehicle_toml = vehicle.text
    bus.settings = HeldSettings(digest_for(name, vehicle, section), lambda: digest_in(name, reread()))

    def stop(_number: int, _frame: FrameType | None) -> None:
        bus.stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    bus.guard()
    gc.collect()
    gc.freeze()  # excludes what exists now from garbage collection, which would take 4 to 9 ms
    try:
        if BY_NAME[name].is_function:
            LiveReactor(cast(Reactor, process), bus, pause_s=BY_NAME[name].pause_s).run()
        else:
            cast(Runner, process).run(bus)
    except Exception as error:
        bus.failed(error)
        raise
    bus.close()
    if bus.settings.have_changed:
        raise SystemExit(os.EX_TEMPFAIL)


class LiveReactor:
    """Feeds a process of layers 2 to 4 from the bus, and publishes its messages."""

    def __init__(self, process: Reactor, bus: Bus, *, pause_s: float = 0.0) -> None:
        self._process, self._bus, self._pause_s = process, bus, pause_s
        if isinstance(kinds := getattr(process, "kinds", None), Kinds):
            bus.tell_kinds = kinds.table
        self._journal = Journal(bus.process, bus.incarnation)
        self._next_tick_ns = (bus.now_ns() // TICK_NS + 1) * TICK_NS
        self._next_journal = time.monotonic() + JOURNAL_S
        self._inbox: deque[Envelope] = deque(maxlen=QUEUE_LENGTH)
        self._served = 0.0
        self._faulty: Counter[str] = Counter()
        self._faults = Faults(self._faulty)
        self._load = Load(bus.process) if BY_MESSAGE[ProcessLoad] in publications(bus.process) else None

    def run(self) -> None:
        """Receive, feed, publish, until `bus.stopping`."""
        while not self._bus.stopping and not self._bus.connected:
            self._bus.receive(0.1)
        self._restore()
        while not self._bus.stopping:
            if self._pause_s:
                time.sleep(min(self._pause_s, self._until_tick_s()))
            self._receive(0.0 if self._inbox else min(self._until_tick_s(), SERVE_S))
            for _ in range(len(self._inbox)):  # what arrives meanwhile comes behind the tick
                self._consume(self._inbox.popleft())
                if self._load is not None:  # whose lag is measured between two ticks
                    self._tick()
                self._publish_journal()
            self._tick()
            self._publish_journal()
        closing = getattr(self._process, "close", None)
        if closing is not None:
            self._publish(closing())
            self._journal.add_close()
        self._publish_journal(at_once=True)

    def _receive(self, timeout_s: float) -> None:
        arrived = self._bus.receive(timeout_s)
        if (excess := len(self._inbox) + len(arrived) - QUEUE_LENGTH) > 0:
            self._bus.dropped += excess  # the oldest
        self._inbox.extend(arrived)
        self._served = time.monotonic()

    def _serve(self) -> None:
        """Let the bus work within a long batch, or a long message of it, so that the heartbeat goes on."""
        if time.monotonic() - self._served >= SERVE_S:
            self._receive(0.0)

    def _until_tick_s(self) -> float:
        return max((self._next_tick_ns - self._bus.now_ns()) * 1e-9, 0.0)

    def _consume(self, envelope: Envelope) -> None:
        if (envelope.producer, envelope.incarnation) == (self._bus.process, self._bus.incarnation):
            return  # its own message, of a topic that it consumes as well
        message = decoded(self._bus, envelope)
        if message is None:
            return
        if (stamp_ns := arrival_ns(message)) is not None and not is_plausible(stamp_ns):
            self._bus.rejects["stamp"] += 1
            return
        if self._load is not None and stamp_ns is not None and self._is_skipped(self._load, message, stamp_ns):
            return
        self._publish(self._handled(message))  # first, for the latency
        self._journal.add(envelope)
        self._count_rejects()
        self._serve()

    def _is_skipped(self, load: Load, message: Message, stamp_ns: int) -> bool:
        """Measure the lag by inertial samples, publish and use what follows from it; whether the message is too old."""
        if isinstance(message, ImuSamples) and (told := load.see(stamp_ns)) is not None:
            self._bus.publish(told)
            self._journal.add(self._own(told))
            self._publish(self._handled(told))
        if not load.skips(stamp_ns):
            return False
        self._bus.rejects["input too old"] = load.skipped
        return True

    def _own(self, message: Message) -> Envelope:
        """Envelope of the message that this process has just published, for its journal."""
        name = codec.topic_name(message)
        return Envelope(name, b"", 0, self._bus.process, self._bus.incarnation, self._bus.sequence)

    def _tick(self) -> None:
        now_ns = self._bus.now_ns()
        if now_ns < self._next_tick_ns:
            return
        tick = Tick(now_ns=now_ns // TICK_NS * TICK_NS)
        self._next_tick_ns = tick.now_ns + TICK_NS
        self._journal.add_tick(tick)
        if self._load is not None:
            self._load.tick(tick.now_ns)
        self._publish(self._handled(tick))

    def _publish(self, messages: Iterable[Message]) -> None:
        """Publish messages; those of persistent topics are saved as well."""
        for message in messages:
            self._bus.publish(message)
            self._serve()
            if BY_MESSAGE[type(message)].persist:
                _save(self._bus.state_dir, message)

    def _restore(self) -> None:
        """Publish the saved messages, and feed the process with them."""
        for topic in publications(self._bus.process):
            path = _saved_path(self._bus.state_dir, topic.name)
            if not topic.persist or not path.exists():
                continue
            try:
                message = codec.decode(topic.name, read_bytes(path, codec.MAXIMUM_PAYLOAD))
            except (BadPayload, OSError, SizeExceeded) as error:
                self._bus.rejects["saved state"] += 1
                log.warning("ignored the saved %s: %s", topic.name, error)
                continue
            if isinstance(message, Persistent):
                message = message.model_copy(update={"boot": None, "earlier_life": _is_earlier(message.boot)})
            self._bus.publish(message)
            self._journal.add(self._own(message))
            self._publish(self._handled(message))

    def _handled(self, message: Message) -> Iterator[Message]:
        return handled(self._process, message, self._faults, self._bus.now_ns(), self._serve)

    def _count_rejects(self) -> None:
        rejects: Mapping[str, int] = getattr(self._process, "rejects", {})
        for kind in rejects.keys() | self._faulty.keys():
            self._bus.rejects[kind] = rejects.get(kind, 0) + self._faulty[kind]
        if self._faults.last is not None:
            self._bus.last_error, self._faults.last = self._faults.last, None

    def _publish_journal(self, *, at_once: bool = False) -> None:
        if at_once or time.monotonic() >= self._next_journal:
            self._next_journal = time.monotonic() + JOURNAL_S
            for consumed in self._journal.take():
                self._bus.publish(consumed)


def _is_earlier(boot: str | None) -> bool:
    """Whether a message was saved in an earlier boot of the host; that of an older release does not say."""
    return boot is not None and boot != boot_id()


def _saved_path(folder: Path, name: str) -> Path:
    return folder / f"saved-{name.replace('/', '-')}.json"


def _save(folder: Path, message: Message) -> None:
    """Write the message atomically: a power cut leaves either the old file or the new one."""
    path = _saved_path(folder, codec.topic_name(message))
    if isinstance(message, Persistent):
        message = message.model_copy(update={"boot": boot_id()})
    draft = path.with_suffix(".new")
    try:
        with draft.open("wb") as file:
            file.write(codec.encode(message))
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
        directory = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(directory)  # otherwise the new name may be lost for as long as the file system's commits take
        finally:
            os.close(directory)
    except OSError as error:
        log.warning("could not save %s: %s", path.name, error.strerror)


class JsonFormatter(logging.Formatter):
    """One JSON object a line: UTC, process, level, logger, text."""

    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        """Print a record as one line."""
        line = {
            "ts": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{int(record.msecs):03d}Z",
            "mono": round(time.monotonic(), 3),
            "proc": self._process,
            "level": record.levelname.lower(),
            "event": record.getMessage(),
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line)


def start_logging(process: str) -> None:
    """Send log lines to standard output as JSON; an uncaught bug becomes one of them as well."""
    handler = logging.StreamHandler(sys.stdout)
    handler.setFormatter(JsonFormatter(process))
    logging.basicConfig(level=os.environ.get("OBU_LOG", "INFO").upper(), handlers=[handler], force=True)
    sys.excepthook = lambda kind, error, trace: log.critical("ended by a bug: %s", error, exc_info=(kind, error, trace))
