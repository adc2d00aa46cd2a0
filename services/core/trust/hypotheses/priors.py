"""Prior table: the probability that a fault is present now, before anything is observed.

It is the rate of a fault times the mean time for which it lasts until it is found or repaired. `benchmarks.integrity`
multiplies the shares of its random faults by the same numbers.
"""

from collections.abc import Mapping

from shared.messages.trust import Hypothesis

PRIOR: Mapping[Hypothesis, float] = {
    # Wear, a mounting that works loose, water in a connector, an acoustic attack: some in a year of driving, and each
    # lasts until somebody looks at it.
    Hypothesis.IMU: 1e-3,
    # A changed tyre, a wheel sensor that fails below a speed, a manipulated pulse wheel.
    Hypothesis.ODOMETER: 1e-3,
    # Reflections in town for seconds (0.1 an hour times some 4 s), interference and attacks.
    Hypothesis.GNSS: 1e-4,
    # Satellite faults of a constellation: 1e-5 an hour and satellite, an hour until flagged, ten satellites.
    Hypothesis.SATELLITES: 1e-4,
    # Both, by the same hand: an attack of its own kind.
    Hypothesis.GNSS_AND_ODOMETER: 1e-5,
    # A receiver whose time is wrong while its positions are right: firmware faults at leap seconds and week roll-overs.
    Hypothesis.RECEIVER_TIME: 1e-5,
}
# Attacks are not random: while a test is exceeded or an offset is held, the priors of the suspects together are at
# least this many times the risk.
SUSPECTED = 10.0
