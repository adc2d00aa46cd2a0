"""What NATS may keep of MQTT: which sessions there are, in memory, and no message.

Units publish with QoS 0, not retained. Whatever a vehicle asks NATS to keep would be kept in streams that all share,
and NATS accepts nobody once those are full. The server takes streams that are there in place of its own; a stored
message has headers, so that none is as small as a byte.
"""

import json

from nats.aio.client import Client

ANSWER_S = 2.0
CREATE = "$JS.API.STREAM.CREATE"
SMALLEST_STREAM = {"storage": "memory", "max_msg_size": 1}
STREAMS: dict[str, dict[str, object]] = {
    "$MQTT_sess": {
        "subjects": ["$MQTT.sess.>"], "retention": "limits", "storage": "memory", "max_msgs_per_subject": 1,
        "max_msg_size": 4096,
    },
    "$MQTT_rmsgs": {"subjects": ["$MQTT.rmsgs.>"], "retention": "limits", "max_msgs_per_subject": 1, **SMALLEST_STREAM},
    "$MQTT_msgs": {"subjects": ["$MQTT.msgs.>"], "retention": "interest", "max_consumers": 1, **SMALLEST_STREAM},
    "$MQTT_qos2in": {"subjects": ["$MQTT.qos2.in.>"], "retention": "limits", **SMALLEST_STREAM},
    "$MQTT_out": {"subjects": ["$MQTT.out.>"], "retention": "interest", "max_consumers": 1, **SMALLEST_STREAM},
}  # fmt: skip


class Streams:
    """Makes the streams at each start of NATS, before a vehicle is admitted; `client` is of the vehicles' account."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._made_at: str | None = None

    async def make(self, server: str) -> None:
        """Make them at a server, which has another identity at each start; raises `RuntimeError` and NATS' errors."""
        if server == self._made_at:
            return
        for name, settings in STREAMS.items():
            wanted = json.dumps({"name": name, "num_replicas": 1, **settings}).encode()
            answer = json.loads((await self._client.request(f"{CREATE}.{name}", wanted, timeout=ANSWER_S)).data)
            if error := answer.get("error"):
                raise RuntimeError(
                    f"NATS has another stream {name}: {error}; empty its folder jetstream, start it again"
                )
        self._made_at = server
