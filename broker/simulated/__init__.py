"""A small MQTT 3.1.1 broker for a first run without Mosquitto, and for tests; never for a vehicle.

QoS 0 and 1, retained messages, wills, keep-alive, session take-over, + and #, an access list, bounded queues.
Simpler than the specification allows: no QoS 2, and no session that outlives its connection (CONNACK says so).
Where several filters of a client take a message, it comes once, with the highest QoS of them.
"""

from .access_list import Acl, AclError, parse
from .embedded import Handle, start
from .session import Limits

__all__ = ["Acl", "AclError", "Handle", "Limits", "parse", "start"]
