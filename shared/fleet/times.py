"""How often a unit reports at the least, and from which age on a centre calls its newest report old."""

RESTING_S = 60  # between two reports of a vehicle at rest, and between two sendings in the mode trips
RETRY_S = 10  # until a batch without a receipt is sent again
TRANSPORT_S = 20  # allowed for the network, the centre and its page
MAX_AGE_S = RESTING_S + RETRY_S + TRANSPORT_S  # a report may be lost once
