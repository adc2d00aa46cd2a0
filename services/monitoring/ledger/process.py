"""Feeds the ledger from the bus and publishes what is committed. Without a usable database nothing is charged."""

import logging
from collections import Counter
from pathlib import Path

from pydantic import Field

from shared.bus.bus import Bus, Envelope, decoded
from shared.evidence import KeyFile, keys_folder
from shared.faults import Faults
from shared.messages.base import Message
from shared.messages.operation import Origin, OriginKind
from shared.messages.toll import LedgerState, PlazaDetector, TollPassage
from shared.toll.plaza import load_plaza, plaza_path

from .ledger import Ledger, Settings
from .store import LedgerFault, Store

log = logging.getLogger(__name__)

PERIOD_NS = 1_000_000_000
EXPIRE_NS = 10_000_000_000
SCRUB_NS = 30_000_000_000
RETRY_NS = 5_000_000_000


class Config(Settings):
    """Settings of monitoring.ledger."""

    plaza_file: Path = Field(
        default=Path("deploy/plazas/example.geojson"),
        description="GeoJSON file of the plaza, relative to the working folder or repository",
    )
    file: Path = Field(
        default=Path("toll/ledger.sqlite"), description="the database, below the state folder unless absolute"
    )
    seal_file: Path | None = Field(
        default=None,
        description="file on another disk or machine that receives each newest signed entry, to recognise a ledger "
        "that was put back",
    )


class Process:
    """Stores each batch of messages in one transaction; what cannot be stored is not settled, and comes again."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._plaza = load_plaza(config.plaza_file)
        self._plaza_file = plaza_path(config.plaza_file).read_text(encoding="utf-8")
        self._ledger: Ledger | None = None
        self._store: Store | None = None
        self._problem: str | None = None
        self._replaying = False
        self._faulty: Counter[str] = Counter()
        self._faults = Faults(self._faulty)
        self._retry_ns = self._state_ns = self._reconcile_ns = self._expire_ns = 0
        self._scrub_ns = 0

    def run(self, bus: Bus) -> None:
        """Work until the bus stops."""
        while not bus.stopping:
            self._step(bus, bus.receive(0.1))
        self._step(bus, bus.receive(0.0))
        if self._store:
            self._store.close()

    def _step(self, bus: Bus, envelopes: list[Envelope]) -> None:
        messages = [message for envelope in envelopes if (message := decoded(bus, envelope)) is not None]
        for message in messages:
            if isinstance(message, Origin):
                self._replaying = message.kind is OriginKind.REPLAY
        if self._replaying:
            bus.rejects["replay"] += len(messages)
            return
        try:
            self._work(bus, messages)
        except LedgerFault as error:
            self._fail(bus, str(error))
        if self._problem and bus.now_ns() >= self._state_ns:
            self._state_ns = bus.now_ns() + PERIOD_NS
            bus.publish(LedgerState(now_ns=bus.now_ns(), plaza=self._plaza.name, problem=self._problem[:400]))

    def _work(self, bus: Bus, messages: list[Message]) -> None:
        now_ns = bus.now_ns()
        if now_ns < self._retry_ns:
            return
        if self._store is None:
            path = bus.state_dir / self._config.file
            self._store = Store(path)
            key = KeyFile(keys_folder(bus.state_dir))
            self._ledger = Ledger(self._store, self._plaza, self._plaza_file, self._config, now_ns, key=key)
        assert self._ledger is not None
        ledger = self._ledger
        if messages:
            self._use(ledger, self._store, messages, now_ns)
            if any(_may_confirm(message) for message in messages):
                self._reconcile_ns = now_ns
        self._do_what_is_due(self._store, ledger, now_ns)
        self._publish(bus, self._store, ledger, now_ns)
        if self._problem:
            log.info("the ledger is usable again")
        self._problem = None
        if ledger.chain.problem:
            bus.last_error = ledger.chain.problem[:400]
        for kind, number in (ledger.rejects + ledger.registrations.rejects + self._faulty).items():
            bus.rejects[kind] = number

    def _use(self, ledger: Ledger, store: Store, messages: list[Message], now_ns: int) -> None:
        """Store a batch in one transaction; of a message that the ledger cannot handle, nothing is stored."""
        with store.transaction():
            for message in messages:
                with self._faults.handling(now_ns), store.part():
                    ledger.use(message, now_ns)

    def _do_what_is_due(self, store: Store, ledger: Ledger, now_ns: int) -> None:
        """Charge what is confirmed, delete what may not be kept longer, and empty the log."""
        if now_ns >= self._reconcile_ns:
            self._reconcile_ns = now_ns + PERIOD_NS
            with store.transaction():
                ledger.reconcile(now_ns)
        if now_ns >= self._expire_ns:
            self._expire_ns = now_ns + EXPIRE_NS
            with store.transaction():
                ledger.expire(now_ns)
        if now_ns >= self._scrub_ns:
            self._scrub_ns = now_ns + SCRUB_NS
            store.scrub()

    def _publish(self, bus: Bus, store: Store, ledger: Ledger, now_ns: int) -> None:
        """Publish what is committed."""
        for transaction in ledger.due(now_ns):
            bus.publish(transaction)
        if reviews := ledger.reviews():
            for review in reviews:
                bus.publish(review)
            with store.transaction():
                for review in reviews:
                    ledger.reviewed(review)
        self._publish_orders(bus, store, ledger, now_ns)
        if (head := ledger.head(now_ns)) is not None:
            bus.publish(head)
            self._keep_seal(bus, head.statement)
        for restored in (found := ledger.restored()):
            bus.publish(restored)
        if found or now_ns >= self._state_ns:
            self._state_ns = now_ns + PERIOD_NS
            bus.publish(ledger.open_passages(now_ns))
            bus.publish(ledger.state(now_ns))

    def _publish_orders(self, bus: Bus, store: Store, ledger: Ledger, now_ns: int) -> None:
        """Publish orders to the cameras, and alarms."""
        orders, alarms = ledger.pictures.due(now_ns), ledger.alarms.due()
        for message in (*orders, *(alarm for _, alarm in alarms)):
            bus.publish(message)
        if orders or alarms:
            with store.transaction():
                for order in orders:
                    ledger.pictures.sent(order)
                for row, _ in alarms:
                    ledger.alarms.sent(row)

    def _keep_seal(self, bus: Bus, statement: str) -> None:
        """Write the newest signed entry where the ledger's own disk is not."""
        path = self._config.seal_file
        if path is None:
            return
        draft = path.with_name(f".{path.name}.part")
        try:
            draft.write_text(statement + "\n", encoding="utf-8")
            draft.replace(path)
        except OSError as error:
            bus.rejects["seal_file"] += 1
            bus.last_error = f"cannot write {path}: {error.strerror}; check the folder of seal_file"

    def _fail(self, bus: Bus, problem: str) -> None:
        """Count the fault, close the database and try again later; what is not committed comes again."""
        if problem != self._problem:
            log.error("%s", problem)
        bus.rejects["database"] += 1
        bus.last_error = self._problem = problem[:400]
        self._retry_ns = bus.now_ns() + RETRY_NS
        if self._store:
            self._store.close()
        self._store = self._ledger = None


def _may_confirm(message: Message) -> bool:
    """Whether a charge may follow: a pulse of a detector, or the end of a passage."""
    return isinstance(message, PlazaDetector) or (isinstance(message, TollPassage) and message.state.is_final)
