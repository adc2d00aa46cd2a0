"""The watchdog: every topic and process against its deadline, and outages with their cause."""

from shared.bus.bus import Bus, Envelope
from shared.errors import BadPayload
from shared.messages.operation import ProcessHealth
from shared.runtime.config import Section, parse_vehicle

from .watch import Watch

REPORT_NS = 500_000_000
STEP_NS = 40_000_000
WILL_NS = 10_000_000  # a broker that shuts down sends everybody's last will before it closes the connections


class Config(Section):
    """It has no settings: deadlines stand in the contract."""


class Process:
    """Reports ages twice a second, and outages as they begin and end."""

    def __init__(self, config: Config) -> None:
        self._config = config

    def run(self, bus: Bus) -> None:
        """Watch until told to stop."""
        watch = Watch(parse_vehicle(bus.vehicle_toml).processes, bus.now_ns())
        report_ns = step_ns = 0
        while not bus.stopping:
            until_step_s = (step_ns - bus.now_ns()) * 1e-9
            for envelope in bus.receive(min(max(until_step_s, 0.01), 0.04)):
                _take(watch, envelope, bus)
                if envelope.topic.startswith("health/"):
                    step_ns = min(step_ns, bus.now_ns() + WILL_NS)
            now_ns = bus.now_ns()
            if now_ns >= step_ns and bus.sequence:  # before its first word it never met the broker
                step_ns = now_ns + STEP_NS
                for outage in watch.step(now_ns, connected=bus.connected):
                    bus.publish(outage)
            if now_ns >= report_ns and bus.connected:
                report_ns = now_ns + REPORT_NS
                bus.publish(watch.report(now_ns))


def _take(watch: Watch, envelope: Envelope, bus: Bus) -> None:
    watch.take(
        envelope.topic,
        envelope.payload,
        producer=envelope.producer,
        received_ns=envelope.received_ns,
        retained=envelope.retained,
    )
    if not envelope.topic.startswith("health/"):
        return
    try:
        health = envelope.decode()
    except BadPayload as error:
        bus.rejects["payload"] += 1
        bus.last_error = str(error)[:400]
        return
    if isinstance(health, ProcessHealth):
        watch.take_health(health, envelope.received_ns, retained=envelope.retained)
