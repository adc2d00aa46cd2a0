"""`obu tail`: prints the live messages of a running unit."""

import difflib
import json
import os
import sys
import time

from shared.bus.bus import Bus, Envelope
from shared.errors import BadPayload, UserError
from shared.messages.base import RawBytes
from shared.runtime.config import VehicleFile, broker_address, state_dir
from shared.topics import TOPICS, Topic, topic_of

TIMEOUT_S = 5.0


def follow(name: str, vehicle: VehicleFile, count: int | None, *, raw: bool = False) -> int:
    """Print the messages of one topic, or of all, until Ctrl-C or until `count` messages have been received.

    With `raw`, write the bytes of the device unchanged to standard output.
    """
    topic = topic_of(name)
    if topic is None and name != "#":
        near = _near(name)
        raise UserError(
            f"there is no topic {name!r}; {f'did you mean {near}? ' if near else ''}`obu topics` lists them"
        )
    if raw and (topic is None or not topic.is_raw):
        names = ", ".join(row.name for row in TOPICS if row.is_raw)
        raise UserError(f"{name} does not carry the bytes of a device; with --raw name one of {names}")
    wanted = TOPICS if topic is None else (topic,)
    bus = Bus("observer", vehicle.name, broker_address(), wanted, state_dir(), observer=True)
    started, seen, hinted = time.monotonic(), 0, False
    try:
        while count is None or seen < count:
            for envelope in bus.receive(0.2):
                if name in ("#", envelope.topic) or (topic is not None and name == topic.name):
                    _write(envelope, raw=raw)
                    seen += 1
                    if seen == count:
                        break
            if bus.connected and not seen and not hinted and time.monotonic() - started > TIMEOUT_S:
                hinted = True
                print(f"connected, but no message on {name} from vehicle {vehicle.name!r} yet; {_hint(topic)}",
                      file=sys.stderr)  # fmt: skip
            if not bus.connected and time.monotonic() - started > TIMEOUT_S:
                raise UserError(
                    f"{bus.last_error or 'no broker responds'}; is the unit running? Set OBU_BROKER to its broker"
                )
    except BrokenPipeError:  # the reader has closed the pipe; the rest is not written again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    finally:
        bus.close()
    return 0


def _near(name: str) -> str | None:
    """The most similar topic: one that contains the name or is contained in it, otherwise one of similar spelling."""
    names = [topic.name for topic in TOPICS]
    containing = [known for known in names if name in known or known in name]
    return next(iter(containing or difflib.get_close_matches(name, names, n=1)), None)


def _hint(topic: Topic | None) -> str:
    """Possible reasons for missing messages."""
    wrong_name = "check the vehicle's name (OBU_VEHICLE or --vehicle)"
    if topic is None or topic.rate_hz is not None:
        return wrong_name
    return f"it is published on events only; or {wrong_name}"


def _write(envelope: Envelope, *, raw: bool) -> None:
    """Write one message as a line, or its bytes; each is flushed at once."""
    if not raw:
        print(_line(envelope), flush=True)
        return
    try:
        message = envelope.decode()
    except BadPayload as error:
        print(f"left out: {error}", file=sys.stderr)
        return
    if isinstance(message, RawBytes):
        sys.stdout.buffer.write(message.data)
        sys.stdout.buffer.flush()


def _line(envelope: Envelope) -> str:
    try:
        body = json.loads(envelope.payload)
        del body["sender"]
    except ValueError:  # a number of thousands of digits
        body = envelope.payload.decode(errors="replace")
    return json.dumps({"topic": envelope.topic, "from": envelope.producer, "seq": envelope.sequence, "message": body})
