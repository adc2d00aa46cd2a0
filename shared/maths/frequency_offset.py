"""Range-rate to a neighbour from the carrier frequency offset (CFO) of its transmission.

::

    CFO = f0 [ (1 + y_t)(1 - rdot/c) - (1 + y_r) ]   =>   rdot = -(c/f0) CFO + c (y_t - y_r)

to first order; rdot > 0 while the range grows. 1 ppm between the oscillators is 300 m/s: y_t must be published by the
neighbour, y_r is a state of the forward filter.
"""

from .gnss_signals import SPEED_OF_LIGHT

CARRIER_FREQUENCY = 5.9e9  # [Hz] ITS-G5 control channel, ETSI EN 302 663
MAX_OFFSET = 100e-6  # [-] far more than any oscillator of a radio (IEEE 802.11: ±20 ppm)


def cfo_from_range_rate(range_rate: float, transmitter: float, receiver: float) -> float:
    """Carrier frequency offset [Hz] at a range-rate [m/s] and fractional frequency offsets [-], exact."""
    return CARRIER_FREQUENCY * ((1.0 + transmitter) * (1.0 - range_rate / SPEED_OF_LIGHT) - (1.0 + receiver))


def range_rate_from_cfo(cfo: float, transmitter: float, receiver: float) -> float:
    """Range-rate [m/s] from a carrier frequency offset [Hz] and fractional frequency offsets [-], to first order."""
    return -SPEED_OF_LIGHT / CARRIER_FREQUENCY * cfo + SPEED_OF_LIGHT * (transmitter - receiver)
