"""Configures a u-blox receiver before generation 9 by UBX-CFG-RATE, CFG-NAV5 and CFG-MSG, each acknowledged.

All of it stays in the volatile memory: UBX-CFG-CFG, which would save it, is not sent.

Source: u-blox M8 interface description (UBX-13003221), sections 32.10.15 CFG-MSG, 32.10.19 CFG-NAV5, 32.10.27 CFG-RATE,
32.9 UBX-ACK.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from pyubx2.ubxtypes_core import UBX_MSGIDS

from shared.messages.gnss import GnssConfigure, GnssOutput
from shared.protocols.ubx import ubx_frame

from .exchange import DYNAMIC_MODELS, NO_RESPONSE, TIMEOUT_TICKS, Exchange, Result
from .outputs import OutputPlan
from .valset import elevation_rad

CFG, MSG, RATE, NAV5 = 0x06, 0x01, 0x08, 0x24
# In place of NAV-PVT, which receivers before generation 7 do not have.
BEFORE_PVT = ("NAV-POSLLH", "NAV-SOL", "NAV-VELNED", "NAV-TIMEUTC")
GENERATION_9_MESSAGES = frozenset(("MON-RF", "SEC-SIG", "NAV-SIG"))  # generation 9 alone has them
DYNAMIC_MODEL_ONLY = 1  # bit of the mask of CFG-NAV5
ATTEMPTS = 2  # of each setting
SHORTEST_MS, LONGEST_MS = 50, 65535


@dataclass(frozen=True)
class _Setting:
    """One message that the receiver acknowledges."""

    frame: bytes
    message: str | None = None  # that is switched on by it; None of one that is switched off


class LegacyExchange(Exchange):
    """Sends one setting after another, each when the one before was acknowledged, and polls what is read back."""

    def __init__(self, wanted: GnssConfigure, plan: OutputPlan) -> None:
        self._wanted, self._plan = wanted, plan
        self._settings = list(self._wanted_settings())
        self._sent: list[str] = []
        self._attempts = self._ticks = 0
        self._polled = False
        self._model: str | None = None
        self._mask_rad: float | None = None

    def begin(self) -> Iterator[bytes | Result]:
        """Yield the first setting, or the reason why the request is invalid."""
        if SHORTEST_MS <= round(self._plan.period_s * 1000) <= LONGEST_MS:
            yield from self._next()
        else:
            yield Result(f"a navigation period of {self._plan.period_s} s is outside 0.05 to 65.535 s")

    def take(self, kind: str, payload: bytes) -> Iterator[bytes | Result]:
        """Process an acknowledgement, or what was polled."""
        if kind.startswith("ACK-") and self._settings and payload[:2] == self._settings[0].frame[2:4]:
            yield from self._answered(self._settings.pop(0), accepted=kind == "ACK-ACK")
        elif self._polled and kind == "CFG-NAV5" and len(payload) >= 13:
            self._model = DYNAMIC_MODELS.get(payload[2])
            self._mask_rad = elevation_rad(payload[12])
        elif self._polled and kind == "CFG-RATE" and len(payload) >= 4:
            period_ms, cycles = struct.unpack_from("<HH", payload)
            yield self._result(period_ms * cycles / 1000)

    def tick(self) -> Iterator[bytes | Result]:
        """Repeat a setting that was not answered, and give up after that."""
        self._ticks += 1
        if self._ticks < TIMEOUT_TICKS:
            return
        self._ticks = 0
        self._attempts += 1
        if self._attempts < ATTEMPTS:
            yield from self._next()
        else:
            yield Result(NO_RESPONSE, self._plan.shortage, messages=tuple(self._sent))

    def _answered(self, setting: _Setting, *, accepted: bool) -> Iterator[bytes | Result]:
        self._attempts = self._ticks = 0
        if accepted and setting.message:
            self._sent.append(setting.message)
        elif not accepted and setting.message == "NAV-PVT":
            self._settings[:0] = [_output(name) for name in BEFORE_PVT]
        elif not accepted and setting.message is None and setting.frame[3] == RATE:
            yield Result("the receiver rejected UBX-CFG-RATE: it may not support the navigation period")
            return
        yield from self._next()

    def _next(self) -> Iterator[bytes]:
        if self._settings:
            yield self._settings[0].frame
            return
        self._polled = True
        yield ubx_frame(CFG, NAV5, b"")
        yield ubx_frame(CFG, RATE, b"")

    def _wanted_settings(self) -> Iterator[_Setting]:
        period_ms = round(self._plan.period_s * 1000)
        yield _Setting(ubx_frame(CFG, RATE, struct.pack("<HHH", min(period_ms, LONGEST_MS), 1, 1)))
        model = next((number for number, name in DYNAMIC_MODELS.items() if name == self._wanted.dynamic_model), None)
        if model is not None:
            yield _Setting(ubx_frame(CFG, NAV5, struct.pack("<HB33x", DYNAMIC_MODEL_ONLY, model)))
        for name, every in self._plan.every.items():
            if name not in GENERATION_9_MESSAGES:
                yield _output(name, every)

    def _result(self, period_s: float) -> Result:
        fault = None
        gives_fix = "NAV-PVT" in self._sent or {"NAV-POSLLH", "NAV-SOL"} <= set(self._sent)
        if GnssOutput.FIX in self._wanted.outputs and not gives_fix:
            fault = "the receiver sends neither NAV-PVT nor NAV-POSLLH and NAV-SOL"
        elif abs(period_s - self._plan.period_s) > 1e-3:
            fault = f"the receiver's navigation period is {period_s} s, not {self._plan.period_s:g} s"
        elif abs(period_s - self._wanted.navigation_period_s) > 1e-3:
            fault = self._plan.shortage
        return Result(fault, self._plan.shortage, period_s, tuple(self._sent), self._model, self._mask_rad)


def _output(name: str, every: int = 1) -> _Setting:
    """Send a message every so many epochs on the port by which this is sent; 0 switches it off."""
    group, number = next(key for key, known in UBX_MSGIDS.items() if known == name)
    frame = ubx_frame(CFG, MSG, bytes((group, number, min(every, 255))))
    return _Setting(frame, name if every else None)
