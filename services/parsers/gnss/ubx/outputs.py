"""The UBX messages of what the controller wants to receive, and how many of them a serial port carries."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from shared.messages.gnss import GnssConfigure, GnssOutput

MESSAGES = {
    GnssOutput.FIX: ("NAV-PVT", "NAV-EOE"),
    GnssOutput.DILUTION: ("NAV-DOP",),
    GnssOutput.COVARIANCE: ("NAV-COV",),
    GnssOutput.SATELLITES: ("NAV-SAT",),
    GnssOutput.RAW_MEASUREMENTS: ("RXM-RAWX",),
    GnssOutput.NAVIGATION_BITS: ("RXM-SFRBX",),
    GnssOutput.INTERFERENCE: ("NAV-STATUS", "MON-RF", "SEC-SIG"),
    GnssOutput.CLOCK: ("NAV-CLOCK",),
    GnssOutput.SIGNALS: ("NAV-SIG",),
    GnssOutput.INERTIAL: ("ESF-RAW",),
    GnssOutput.WHEEL_TICKS: ("ESF-MEAS",),
    GnssOutput.LEVELS: ("NAV-PL",),
}
REQUIRED = frozenset(("NAV-PVT", "NAV-EOE", "NAV-DOP", "NAV-COV", "NAV-SAT"))  # asked for together, in one setting
ONCE_A_SECOND = frozenset(
    ("RXM-RAWX", "NAV-STATUS", "NAV-CLOCK", "MON-RF", "SEC-SIG", "NAV-SIG", "NAV-PL")
)  # whatever the navigation period
SATELLITES, SIGNALS = 32, 56  # in view of a receiver of two bands
# [bytes] of a frame in each epoch in which it is sent. u-blox F9 HPG 1.32 (UBX-22008968), section 3.
EPOCH_BYTES = {
    "NAV-PVT": 100, "NAV-EOE": 12, "NAV-COV": 72, "NAV-DOP": 26, "NAV-STATUS": 24, "MON-RF": 60, "SEC-SIG": 20,
    "NAV-CLOCK": 28, "NAV-SAT": 16 + 12 * SATELLITES, "RXM-RAWX": 24 + 32 * SIGNALS, "NAV-SIG": 16 + 16 * SIGNALS,
    "NAV-PL": 60,
}  # fmt: skip
# [bytes/s] of what is not sent by epochs: 20 subframes of 60 bytes; wheel ticks at 10 Hz; 100 samples of 7 sensors.
STEADY_BYTES_S = {"RXM-SFRBX": 1200, "ESF-MEAS": 400, "ESF-RAW": 6000}
# In the order in which they are left out of a port that is too slow, the last one first; the fix is never left out.
BY_IMPORTANCE = (
    "NAV-COV", "NAV-DOP", "NAV-STATUS", "MON-RF", "SEC-SIG", "NAV-CLOCK", "ESF-MEAS", "NAV-SAT", "RXM-RAWX",
    "RXM-SFRBX", "NAV-PL", "NAV-SIG", "ESF-RAW",
)  # fmt: skip
BITS = 10  # of a byte at a serial port, with start and stop bit
PORT_SHARE = 0.7  # of a port for these messages: NMEA, which stays switched on, needs the rest
STEP_S = 0.1  # between the navigation periods that are asked for in place of one that is too short


@dataclass(frozen=True)
class OutputPlan:
    """How often each message is asked for."""

    period_s: float  # navigation period
    every: Mapping[str, int]  # epochs from one message to the next; 0: switched off, since the port is too slow
    shortage: str | None = None  # what the rate of the port does not carry, and the remedy

    @property
    def names(self) -> tuple[str, ...]:
        """The messages that are asked for."""
        return tuple(name for name, every in self.every.items() if every)


def plan_outputs(wanted: GnssConfigure, rate_baud: int | None) -> OutputPlan:
    """Choose how often each message of a request is sent, so that a serial port carries them.

    Parameters
    ----------
    wanted : GnssConfigure
        Outputs and navigation period.
    rate_baud : int or None
        [baud] Rate of the port; None where it has none, as a USB port.

    Returns
    -------
    OutputPlan
        All of the request if it fits. Otherwise the fix in every epoch (less often, if even that is too much), and of
        the rest by importance what fits once a second, then what fits in every epoch.

    Notes
    -----
    With the size b of a message, the period T and a message every n epochs, the load is the sum of b / (n T)::

        sum <= 0.7 rate / 10
    """
    period_s = wanted.navigation_period_s
    full = {name: usual_every(name, period_s) for name in messages_of(wanted.outputs)}
    if rate_baud is None or load_bytes_s(full, period_s) <= (limit := PORT_SHARE * rate_baud / BITS):
        return OutputPlan(period_s, full)
    fix = {name: 1 for name in full if name in MESSAGES[GnssOutput.FIX]}
    if load_bytes_s(fix, period_s) > limit:
        period_s = math.ceil(load_bytes_s(fix, 1.0) / limit / STEP_S) * STEP_S
    plan = dict.fromkeys(full, 0) | fix
    for seldom in (True, False):
        for name in BY_IMPORTANCE:
            every = _once_a_second(name, period_s) if seldom else usual_every(name, period_s)
            if name in full and (seldom or plan[name]) and load_bytes_s(plan | {name: every}, period_s) <= limit:
                plan[name] = every
    return OutputPlan(period_s, plan, "; ".join(_shortage(plan, period_s, wanted, rate_baud)))


def load_bytes_s(every: Mapping[str, int], period_s: float) -> float:
    """Bytes a second of messages that are sent every so many epochs."""
    return sum(
        STEADY_BYTES_S[name] if name in STEADY_BYTES_S else EPOCH_BYTES[name] / (epochs * period_s)
        for name, epochs in every.items()
        if epochs
    )


def usual_every(name: str, period_s: float) -> int:
    """Epochs from one message to the next where the port is fast enough."""
    return max(1, round(1.0 / period_s)) if name in ONCE_A_SECOND else 1


def _once_a_second(name: str, period_s: float) -> int:
    return 1 if name in STEADY_BYTES_S else max(1, round(1.0 / period_s))


def _shortage(plan: Mapping[str, int], period_s: float, wanted: GnssConfigure, rate_baud: int) -> Iterator[str]:
    yield f"{rate_baud} baud carry {rate_baud / BITS / 1000:.1f} kB/s"
    if period_s != wanted.navigation_period_s:
        yield f"a fix every {period_s:g} s and not every {wanted.navigation_period_s:g} s"
    if left := [name for name, every in plan.items() if not every]:
        yield f"without {', '.join(left)}"
    if seldom := [name for name, every in plan.items() if every > usual_every(name, period_s)]:
        yield f"{', '.join(seldom)} once a second"
    yield "raise the rate of the receiver's port, and baud in the device's URL"


def messages_of(outputs: Iterable[GnssOutput]) -> tuple[str, ...]:
    """The messages of outputs."""
    return tuple(name for output in outputs for name in MESSAGES[output])
