"""A small MQTT 5 broker for a first run without Mosquitto, and for tests; never for a vehicle.

QoS 0 and 1, retained messages, message and session expiry, wills, keep-alive, take-over, user
properties, + and #, no-local, retain handling, an access list. Simpler than the specification allows,
and said so to the client: no QoS 2, no topic aliases, no subscription identifiers, no shared
subscriptions, no authentication. A will is sent at once: its delay is not waited for. Sessions are
kept in memory, for an hour at most. Where several filters of a client take a message, it comes once,
with the highest QoS of them.
"""

from .acl import Acl, AclError, parse
from .embedded import Handle, start
from .session import Limits

__all__ = ["Acl", "AclError", "Handle", "Limits", "parse", "start"]
