"""A user who may write every topic, let into the broker of a running demo: stands for an allowed but broken client."""

import signal
import time
from pathlib import Path

import psutil
from paho.mqtt.reasoncodes import ReasonCode

from broker import passwords
from tests.support.bus import mqtt

NAME, SECRET = "intruder", "known"
READ_WITHIN_S = 5.0


def let_in(rules: Path, broker: psutil.Process, port: int) -> None:
    """Add the user to the broker's files, and wait until the broker has read them."""
    for name, line in (
        ("passwords", passwords.line(NAME, SECRET)),
        ("acl.conf", f"\nuser {NAME}\ntopic readwrite #\n"),
    ):
        path = rules / name
        path.chmod(0o600)
        path.write_text(path.read_text() + line)
    broker.send_signal(signal.SIGHUP)
    deadline = time.monotonic() + READ_WITHIN_S
    while True:
        with client(port) as trying:
            answer: ReasonCode = trying.connect()
        if not answer.is_failure:
            return
        assert time.monotonic() < deadline, f"the broker refuses {NAME}: {answer}"
        time.sleep(0.05)


def client(port: int) -> mqtt.Client:
    """A connection of this user."""
    return mqtt.Client(port, user=NAME, password=SECRET)
