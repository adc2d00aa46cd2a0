"""The UBX messages of what the controller wants to be told."""

from collections.abc import Iterable

from shared.messages.gnss import GnssOutput

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
}
REQUIRED = frozenset(("NAV-PVT", "NAV-EOE", "NAV-DOP", "NAV-COV", "NAV-SAT"))  # every receiver of generation 9 has them
ONCE_A_SECOND = frozenset(
    ("RXM-RAWX", "NAV-STATUS", "NAV-CLOCK", "MON-RF", "SEC-SIG", "NAV-SIG")
)  # whatever the navigation period


def messages_of(outputs: Iterable[GnssOutput]) -> tuple[str, ...]:
    """The messages of outputs."""
    return tuple(name for output in outputs for name in MESSAGES[output])


def required(outputs: Iterable[GnssOutput]) -> tuple[str, ...]:
    """Those that every receiver of generation 9 has."""
    return tuple(name for name in messages_of(outputs) if name in REQUIRED)


def optional(outputs: Iterable[GnssOutput]) -> tuple[str, ...]:
    """Those that a receiver may refuse."""
    return tuple(name for name in messages_of(outputs) if name not in REQUIRED)
