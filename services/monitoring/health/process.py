"""The watchdog: judges every topic and process by its deadline, and publishes problems and outages by root cause."""

import os

from shared.bus.bus import Bus, Envelope, decoded
from shared.faults import Faults
from shared.messages.operation import DeadlineReport, ProcessHealth, RecordingState
from shared.runtime.config import Section, parse_vehicle

from .watch import Watch

REPORT_NS = 500_000_000
STEP_NS = 100_000_000
WILL_NS = 10_000_000  # a broker that shuts down sends everybody's last will before it closes the connections
DECODED = ("health/", "recording/state", "deadline/report")


class Config(Section):
    """It has no settings: deadlines stand in the topic table."""


class Process:
    """Publishes a report twice a second, and outages as they begin and end."""

    def __init__(self, config: Config) -> None:
        self._config = config

    def run(self, bus: Bus) -> None:
        """Watch until `bus.stopping`."""
        watch = Watch(parse_vehicle(bus.vehicle_toml).processes, bus.now_ns())
        faults = Faults(bus.rejects)
        report_ns = step_ns = 0
        bus.hear_broker()
        while not bus.stopping:
            bus.follow(watch.untold)
            until_step_s = (step_ns - bus.now_ns()) * 1e-9
            for envelope in bus.receive(min(max(until_step_s, 0.01), 0.1)):
                with faults.handling(bus.now_ns()):
                    _take(watch, envelope, bus)
                if envelope.topic.startswith("health/"):
                    step_ns = min(step_ns, bus.now_ns() + WILL_NS)
            now_ns = bus.now_ns()
            if now_ns >= step_ns and bus.sequence:  # it has been connected at least once
                step_ns = now_ns + STEP_NS
                for outage in watch.step(now_ns, connected=bus.connected):
                    bus.publish(outage)
                    report_ns = now_ns  # with a report at once
            if now_ns >= report_ns and bus.connected and watch.answering:
                report_ns = now_ns + REPORT_NS
                watch.judge_load(now_ns, os.getloadavg()[0])
                watch.intruders.refused(bus.refusals, bus.refused, now_ns)
                watch.intruders.crowded(bus.crowded, now_ns)
                bus.publish(watch.report(now_ns))


def _take(watch: Watch, envelope: Envelope, bus: Bus) -> None:
    watch.take(
        envelope.topic,
        envelope.payload,
        producer=envelope.producer,
        received_ns=envelope.received_ns,
        retained=envelope.retained,
    )
    if not envelope.topic.startswith(DECODED) or (envelope.topic == "deadline/report" and not envelope.retained):
        return
    message = decoded(bus, envelope)
    match message:
        case ProcessHealth():
            watch.take_health(message, envelope.received_ns, retained=envelope.retained)
        case RecordingState():
            watch.take_recording(message)
        case DeadlineReport():
            watch.resume(message)
