"""`obu tail`: prints the live messages of a running unit."""

import difflib
import json
import sys
import time

from shared.bus.bus import Bus, Envelope
from shared.errors import UserError
from shared.runtime.config import VehicleFile, broker_address, state_dir
from shared.topics import TOPICS, Topic, topic_of

TIMEOUT_S = 5.0


def follow(name: str, vehicle: VehicleFile, count: int | None) -> int:
    """Print the messages of one topic, or of all, until Ctrl-C or until `count` messages have been received."""
    topic = topic_of(name)
    if topic is None and name != "#":
        near = _near(name)
        raise UserError(
            f"there is no topic {name!r}; {f'did you mean {near}? ' if near else ''}`obu topics` lists them"
        )
    wanted = TOPICS if topic is None else (topic,)
    bus = Bus("observer", vehicle.name, broker_address(), wanted, state_dir(), observer=True)
    started, seen, hinted = time.monotonic(), 0, False
    try:
        while count is None or seen < count:
            for envelope in bus.receive(0.2):
                if name in ("#", envelope.topic) or (topic is not None and name == topic.name):
                    print(_line(envelope), flush=True)
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


def _line(envelope: Envelope) -> str:
    topic = topic_of(envelope.topic)
    if topic is not None and topic.is_raw:
        body = envelope.payload.hex()
    else:
        try:
            body = json.loads(envelope.payload)
        except ValueError:  # invalid messages are printed as text, for diagnosis
            body = envelope.payload.decode(errors="replace")
    return json.dumps({"topic": envelope.topic, "from": envelope.producer, "seq": envelope.sequence, "message": body})
