"""Serves position and verdict to other programs: the protocol of gpsd, and NMEA 0183 over TCP and UDP."""

import logging
import os
from typing import Annotated

from pydantic import Field, field_validator

from shared.bus.bus import Bus, Envelope, decoded
from shared.bus.codec import stamp_ns
from shared.faults import Faults
from shared.messages.gnss import GnssFix, GnssSatellites
from shared.messages.navigation import NavigationSolution
from shared.messages.operation import Origin
from shared.messages.trust import TrustState
from shared.runtime.config import Section
from shared.topics import BY_NAME

from . import gpsd_reports
from .gpsd_session import Session, SharedReports
from .nmea import ENCODERS, SentenceName, burst
from .report import STALE_AFTER_NS, LatestMessages
from .server import Listener, Peer, Servers, TcpServer, UdpSender

log = logging.getLogger(__name__)

NS = 1_000_000_000
SOLUTION = BY_NAME["navigation/solution"]
SILENT_PERIOD_NS = NS  # between two reports while there is no solution
SKY_PERIOD_NS = NS
POLL_PERIOD_S = 0.1  # longest time between two looks at the clients
MAX_DESTINATIONS = 8  # of datagrams
GPSD_REMEDY = "if it is gpsd: sudo systemctl disable --now gpsd.socket gpsd; or set gpsd_port. It is tried every 5 s"
NMEA_REMEDY = "set nmea_port. It is tried every 5 s"


class Config(Section):
    """Addresses, rate and sentences of the outputs."""

    host: str | None = Field(
        default=None,
        min_length=1,
        max_length=253,
        description="address that gpsd clients and readers of NMEA connect to; 0.0.0.0: the whole network reads the "
        "position; without it OBU_OUTPUTS_HOST, else 127.0.0.1",
    )
    gpsd_port: int = Field(default=2947, ge=0, le=65535, description="TCP port of the protocol of gpsd; 0: none")
    nmea_port: int = Field(default=10110, ge=0, le=65535, description="TCP port of NMEA 0183; 0: none")
    nmea_udp: tuple[Annotated[str, Field(max_length=260)], ...] = Field(
        default=(),
        max_length=MAX_DESTINATIONS,
        description='where NMEA 0183 is sent as datagrams: "host:port"; a broadcast address reaches its whole network',
    )
    rate_hz: int = Field(default=1, ge=1, le=10, description="reports in a second, at most as many as solutions")
    sentences: tuple[SentenceName, ...] = Field(
        default=tuple(ENCODERS), description="NMEA sentences that are sent: RMC, VTG, GGA, GSA, GST, ZDA, HDT"
    )
    clients_maximum: int = Field(default=16, ge=1, le=64, description="connections of other programs at once")

    @field_validator("nmea_udp")
    @classmethod
    def _are_addresses(cls, values: tuple[str, ...]) -> tuple[str, ...]:
        for value in values:
            host_and_port(value)
        return values


def host_and_port(text: str) -> tuple[str, int]:
    """Read host:port, an IPv6 address in brackets; raises `ValueError` with an example."""
    host, _, port = text.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and 0 < int(port[:6]) < 65536):
        raise ValueError(f"{text!r} is not host:port, such as 192.168.1.255:10110")
    return host.strip("[]"), int(port)


class Process:
    """Keeps the newest messages, and gives a report of them to every client at its rate."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._newest, self._shared = LatestMessages(), SharedReports()
        self._slot = -1  # number of the period of the newest report
        self._silent_ns = self._sky_ns = 0  # when the next report without a solution and the next SKY are due
        host = config.host or os.environ.get("OBU_OUTPUTS_HOST", "127.0.0.1")
        self.gpsd = TcpServer((host, config.gpsd_port), lambda: Session(self._shared), GPSD_REMEDY)
        self.nmea = TcpServer((host, config.nmea_port), Listener, NMEA_REMEDY)

    def run(self, bus: Bus) -> None:
        """Receive and serve until the bus stops."""
        config, faults = self._config, Faults(bus.rejects)
        servers = Servers(bus.rejects, config.clients_maximum)
        self._shared.started_ns, self._shared.now_ns = bus.now_ns(), bus.now_ns
        for port, server in ((config.gpsd_port, self.gpsd), (config.nmea_port, self.nmea)):
            if port:
                servers.add(server)
        datagrams = UdpSender(tuple(map(host_and_port, config.nmea_udp)), bus.rejects)
        fault: str | None = None
        try:
            while not bus.stopping:
                for envelope in bus.receive(POLL_PERIOD_S):
                    with faults.handling(bus.now_ns()):
                        self._take(bus, envelope, servers, datagrams)
                if bus.now_ns() >= self._silent_ns:
                    self._give(bus.now_ns(), servers, datagrams)
                    self._silent_ns = bus.now_ns() + SILENT_PERIOD_NS
                servers.serve()
                fault = _told(bus, fault, servers.fault)
        finally:
            servers.close()
            datagrams.close()

    def _take(self, bus: Bus, envelope: Envelope, servers: Servers, datagrams: UdpSender) -> None:
        now_ns = bus.now_ns()
        if envelope.topic == SOLUTION.name and not self._is_due(envelope):
            return
        match message := decoded(bus, envelope):
            case NavigationSolution():
                self._newest.add_solution(message, envelope.received_ns, recorded_ns=envelope.recorded_ns)
                self._give(now_ns, servers, datagrams)
                self._silent_ns = now_ns + STALE_AFTER_NS
            case TrustState():
                self._newest.add_trust(message)
            case GnssFix():
                self._newest.add_fix(message)
            case GnssSatellites():
                self._newest.add_satellites(message)
            case Origin():
                self._newest.add_origin(message, envelope.producer, now_ns, retained=envelope.retained)

    def _is_due(self, envelope: Envelope) -> bool:
        """Whether a solution is the first of a period of UTC, so that solutions between are not decoded."""
        sampled_ns = stamp_ns(SOLUTION, envelope.payload)
        if sampled_ns is None:
            return True  # decoding counts it as rejected
        utc_ns = self._newest.utc_ns(sampled_ns)
        slot = (sampled_ns if utc_ns is None else utc_ns) * self._config.rate_hz // NS
        due, self._slot = slot != self._slot, slot
        return due

    def _give(self, now_ns: int, servers: Servers, datagrams: UdpSender) -> None:
        """Send the present report to whom it concerns."""
        report = self._newest.report(now_ns)
        objects = {"TPV": gpsd_reports.tpv(report), "ATT": gpsd_reports.att(report)}
        if now_ns >= self._sky_ns:
            objects["SKY"] = gpsd_reports.sky(report)
            if objects["SKY"] is not None:
                self._sky_ns = now_ns + SKY_PERIOD_NS
        self._shared.newest.update(objects, GST=gpsd_reports.gst(report))
        servers.send(b"".join(gpsd_reports.encoded(o) for o in objects.values() if o is not None), _wants_json)
        sentences = burst(report, self._config.sentences)
        servers.send(sentences, _wants_nmea)
        datagrams.send(sentences)


def _wants_json(peer: Peer) -> bool:
    return isinstance(peer, Session) and peer.wants_json


def _wants_nmea(peer: Peer) -> bool:
    return not isinstance(peer, Session) or peer.wants_nmea


def _told(bus: Bus, before: str | None, fault: str | None) -> str | None:
    """Show why an address is not served as the last error of this process, and take that back when it is."""
    if fault != before:
        if fault:
            log.warning("%s", fault)
        else:
            log.info("every address is served")
    if fault or bus.last_error == before:
        bus.last_error = fault
    return fault
