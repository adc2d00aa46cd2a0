"""What the unit says of its connection to a control centre."""

from typing import Annotated

from pydantic import Field

from .base import Bytes, Count, Message, Name, Nanoseconds, Reason


class UplinkState(Message):
    """Connection to the control centre, and what waits for its receipt; counts are since the start of the process."""

    now_ns: Nanoseconds
    connected: bool
    offline: Reason | None = None  # why there is no connection, or why nothing is reported
    centre: Annotated[str, Field(max_length=300)] | None = None  # host and port; None: this unit is not enrolled
    tracking: Name  # off, verdict, trips or live
    backlog_batches: Count = 0  # without a receipt
    backlog_refused: Count = 0  # of these, by the centre
    backlog_bytes: Bytes = 0
    oldest_ns: Nanoseconds | None = None  # first report of the oldest of them, UTC
    sent: Count = 0  # batches, repeated ones as well
    receipted: Count = 0
    refused: Count = 0
    dropped: Count = 0  # reports, by a full outbox or disk
    sent_bytes: Bytes = 0  # of MQTT
    watchers: Count = 0  # people of the centre who watch this vehicle now
    watched_until_ns: Nanoseconds | None = None
    certificate_until_ns: Nanoseconds | None = None  # UTC
