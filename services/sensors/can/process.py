"""Reads the vehicle's CAN bus or an OBD adapter; transmits requests only where the configuration asks for them."""

import time
from collections.abc import Sequence

from pydantic import Field

from shared.bus.bus import Bus, Envelope, decoded
from shared.devices.can_device import check_can_url, only_answers, open_can
from shared.devices.driver import Link, run_driver
from shared.errors import UserError
from shared.messages.base import DeviceName
from shared.messages.gnss import GnssFix
from shared.messages.vehicle import CanRaw
from shared.runtime.config import Section

SPEED_REQUEST = bytes.fromhex("02010D0000000000")  # SAE J1979 mode 01, PID 0D
VIN_REQUEST = bytes.fromhex("0209020000000000")  # mode 09, PID 02
ELM_PERIOD_S = 0.5  # an adapter answers two to ten times a second
VIN_PERIOD_S = 10.0
NS = 1_000_000_000
GNSS_AGE_NS = 5 * NS  # of the newest fix, up to which requests follow it
VIN_REQUESTS = 6  # then a vehicle that has none to tell is left alone


class Config(Section):
    """Settings of the CAN driver; `shared/devices/can_device.py` lists the kinds of device."""

    device: str = Field(default="socketcan://can0", description="URL of the CAN interface or OBD adapter")
    source: DeviceName = Field(default="can0", description="name of this CAN bus in the published messages")
    obd_period_s: float | None = Field(
        default=None,
        ge=0.0,
        description="period of the OBD-II speed requests; 0: nothing is transmitted; if not given, 0.5 s with an "
        "ELM327, which gives nothing unasked, and 0 with other devices",
    )
    obd_at_gnss_time: bool = Field(
        default=True,
        description="whether speed requests are sent at the stamps of GNSS, in whole periods from one of them, while "
        "fixes come",
    )
    obd_vin: bool = Field(
        default=False,
        description="whether the vehicle identification number (VIN) is asked for after the start; it identifies the "
        "vehicle in recordings",
    )
    obd_identifier: int = Field(
        default=0x7DF,
        ge=0,
        le=0x1FFFFFFF,
        description="CAN identifier of the OBD-II requests; 0x18DB33F1 on vehicles with 29-bit identifiers",
    )

    @property
    def period_s(self) -> float:
        """[s] Period of the speed requests; 0: none."""
        if self.obd_period_s is None:
            return ELM_PERIOD_S if only_answers(self.device) else 0.0
        return self.obd_period_s


def next_request_ns(now_ns: int, period_ns: int, gnss_ns: int | None) -> int:
    """Time of the next request: a period later, or at the stamp of a fix and whole periods, half a period away."""
    if gnss_ns is None or abs(now_ns - gnss_ns) > GNSS_AGE_NS:
        return now_ns + period_ns
    phase_ns = (now_ns - gnss_ns) % period_ns
    ahead_ns = period_ns - phase_ns
    return now_ns + (ahead_ns if 2 * ahead_ns >= period_ns else ahead_ns + period_ns)


class Process:
    """Publishes the received frames in batches of at most 0.1 s, as lines of a candump log."""

    def __init__(self, config: Config) -> None:
        check_can_url(config.device)  # an invalid URL is a configuration error, raised at the start
        if only_answers(config.device) and not config.period_s:
            raise UserError(
                f"[sensors.can] device = {config.device!r} gives nothing unasked: set obd_period_s = 0.5, or "
                "leave it out"
            )
        self._config = config
        self._next_request_ns, self._next_vin = 0, 0.0
        self._gnss_ns: int | None = None  # stamp of the newest fix
        self._vin_requests = VIN_REQUESTS if config.obd_vin else 0

    def run(self, bus: Bus) -> None:
        """Read until the bus stops."""
        config = self._config
        link = Link(lambda: open_can(config.device, config.obd_identifier, bus.now_ns), gap_s=0.03, chunk_s=0.07)

        def request(envelopes: Sequence[Envelope]) -> None:
            self._follow(bus, envelopes)
            if link.present:
                self._request(bus, link)
            for kind, count in link.rejects.items():
                bus.rejects[kind] = count

        run_driver(bus, link, config.device, self._raw, request, source=config.source)

    def _request(self, bus: Bus, link: Link) -> None:
        now_s = time.monotonic()
        now_ns = bus.now_ns()
        if self._config.period_s and now_ns >= self._next_request_ns:
            self._next_request_ns = next_request_ns(now_ns, round(self._config.period_s * NS), self._gnss_ns)
            link.write(bus, SPEED_REQUEST)
        if self._vin_requests and now_s >= self._next_vin:
            self._next_vin = now_s + VIN_PERIOD_S
            self._vin_requests -= 1
            link.write(bus, VIN_REQUEST)

    def _follow(self, bus: Bus, envelopes: Sequence[Envelope]) -> None:
        """Note the stamp of the newest fix, if requests follow GNSS."""
        for envelope in envelopes:
            fix = decoded(bus, envelope)
            if self._config.obd_at_gnss_time and isinstance(fix, GnssFix):
                self._gnss_ns = fix.sampled_ns

    def _raw(self, data: bytes, received_ns: int) -> CanRaw:
        return CanRaw(received_ns=received_ns, source=self._config.source, data=data)
