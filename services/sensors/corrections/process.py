"""Receives GNSS corrections from a list of sources, the preferred one first."""

import logging
import select
import time
from collections.abc import Sequence

from pydantic import Field

from shared.bus.bus import Bus, Envelope, decoded
from shared.errors import ConfigError
from shared.messages.corrections import (
    MAX_CORRECTION_SOURCES,
    CorrectionBytes,
    CorrectionSources,
    CorrectionsState,
    SourcePhase,
)
from shared.messages.gnss import GnssFix
from shared.messages.trust import TrustState
from shared.runtime.config import Section

from .address import EXAMPLE, parse
from .gga import Position
from .source import Source

log = logging.getLogger(__name__)

WAIT_TIMEOUT_S = 0.2  # for bytes of a source: corrections are seconds old anyhow
STATEMENT_S = 1.0
STALE_AFTER_S = 5.0  # of the parser's state


class Config(Section):
    """Settings of the driver of corrections; `services/sensors/corrections/address.py` lists the kinds of source."""

    sources: tuple[str, ...] = Field(
        default=(),
        max_length=MAX_CORRECTION_SOURCES,
        description="URLs of the sources, the preferred one first: ntrip://user@host:2101/MOUNT, ntrips://, "
        "tcp://host:port, serial:///dev/..., mqtt://host:1883?topic=NAME, mqtts://",
    )
    password_file: str = Field(
        default="",
        description="file whose first line is the password; others must not be able to read it. A source may have one "
        "of its own: ?password_file=",
    )
    ca_file: str = Field(
        default="",
        description="certificates of the authorities that ntrips:// and mqtts:// trust; if not given, those of the "
        "system",
    )
    certificate_file: str = Field(default="", description="certificate of this unit, for brokers that ask for one")
    key_file: str = Field(default="", description="private key of that certificate")
    gga_period_s: float = Field(
        default=10.0,
        ge=0.0,
        le=3600.0,
        description="period at which an NTRIP caster is told the position of the vehicle, never while the verdict is "
        "UNSAFE; 0: the caster is never told",
    )
    failover_s: float = Field(
        default=30.0,
        gt=0.0,
        le=600.0,
        description="time that a source has to deliver its first valid frame until the next one is connected as well",
    )


class Process:
    """Publishes the bytes of the sources, and what the connections are doing."""

    def __init__(self, config: Config) -> None:
        self._config = config
        defaults = config.model_dump(include={
            "password_file", "ca_file", "certificate_file", "key_file", "gga_period_s",
        })  # fmt: skip
        addresses = [parse(url, defaults) for url in config.sources]
        if not addresses:
            raise ConfigError(f'[sensors.corrections] sources is empty: try sources = ["{EXAMPLE}"], or leave the '
                              "section out")  # fmt: skip
        names = [address.name for address in addresses]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ConfigError(f"[sensors.corrections] sources: {twice[0]} stands there twice; keep one")
        self._position = Position()
        self._sources = [Source(address, self._position) for address in addresses]
        self._open = 1  # so many sources, from the first on, are connected
        self._active: str | None = None
        self._stated_s: float | None = None  # when the parser stated it
        self._next_statement_s = 0.0
        self._phases: tuple[SourcePhase, ...] = ()  # as last stated
        self._logged: dict[str, str] = {}

    def run(self, bus: Bus) -> None:
        """Receive until the bus stops."""
        while not bus.stopping and not bus.connected:
            bus.receive(0.1)
        while not bus.stopping:
            self._wait()
            self._handle(bus, bus.receive(0.0))
            now_s = time.monotonic()
            for source in self._sources[: self._open]:
                if data := source.turn(now_s, bus.now_ns()):
                    bus.publish(CorrectionBytes(received_ns=bus.now_ns(), source=source.address.name, data=data))
            self._select(now_s)
            self._state(bus, now_s)
        for source in self._sources:
            source.release("stopped")

    def _wait(self) -> None:
        """Wait for bytes of a source, or for the peer of a connection that has something to be sent."""
        connections = [source.connection for source in self._sources if source.connection is not None]
        readers = [connection.sock for connection in connections if connection.sock is not None]
        writers = [
            connection.sock for connection in connections if connection.sock is not None and connection.wants_write
        ]
        select.select(readers, writers, [], WAIT_TIMEOUT_S)

    def _handle(self, bus: Bus, envelopes: Sequence[Envelope]) -> None:
        for envelope in envelopes:
            match decoded(bus, envelope):
                case CorrectionsState() as state:
                    self._active, self._stated_s = state.active, time.monotonic()
                case GnssFix() | TrustState() as message:
                    self._position.note(message)

    def _select(self, now_s: float) -> None:
        """Connect to the next source while none delivers; leave those behind the one in use."""
        if self._stated_s is None or now_s - self._stated_s > STALE_AFTER_S:
            return  # without the parser nobody knows what is delivered
        names = [source.address.name for source in self._sources]
        if self._active in names:
            wanted = names.index(self._active) + 1
            for source in self._sources[wanted : self._open]:
                source.release(f"not needed: {self._active} delivers")
            self._open = wanted
            return
        since_s = self._sources[self._open - 1].wanted_since_s
        waited = since_s is not None and now_s - since_s >= self._config.failover_s
        failed = self._sources[self._open - 1].fault is not None
        if self._open < len(self._sources) and (waited or failed):
            self._open += 1

    def _state(self, bus: Bus, now_s: float) -> None:
        phases = tuple(source.phase for source in self._sources)
        if now_s < self._next_statement_s and phases == self._phases:
            return
        self._next_statement_s, self._phases = now_s + STATEMENT_S, phases
        stated = tuple(source.statement(now_s) for source in self._sources)
        bus.publish(CorrectionSources(now_ns=bus.now_ns(), sources=stated))
        for correction_source in stated:
            if correction_source.reason != self._logged.get(correction_source.source):
                self._logged[correction_source.source] = correction_source.reason
                level = (
                    logging.WARNING
                    if correction_source.phase in (SourcePhase.WAITING, SourcePhase.REFUSED)
                    else logging.INFO
                )
                log.log(level, "%s: %s", correction_source.source, correction_source.reason)
        faults = [f"{source.address.name}: {source.fault}" for source in self._sources if source.fault]
        delivers = any(correction_source.phase is SourcePhase.RECEIVING for correction_source in stated)
        bus.last_error = None if delivers or not faults else faults[0][:400]
