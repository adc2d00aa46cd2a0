"""A vehicle that passes messages of its bus on while it is told that somebody watches, as monitoring.uplink does."""

import asyncio
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nats.aio.msg import Msg

from shared.fleet.topics import LIVE, WATCH, subject
from tests.support.dashboard.fake_unit import FakeBus, FakeUnit
from tests.support.fleet.web import RunningWeb

PERIOD_NS = 200_000_000


class WatchedUnit:
    """Keeps what the centre asks for, and answers it unless it is silent."""

    def __init__(self, running: RunningWeb, vehicle: str, folder: Path) -> None:
        self.vehicle, self.requests = vehicle, list[dict[str, object]]()
        self.silent = False
        self.bus = FakeBus(folder, vehicle)
        self.unit = FakeUnit(self.bus)
        self._client = running.client
        self._due_ns: dict[str, int] = {}

    async def run(self) -> None:
        """Work until cancelled."""
        subscription = await self._client.subscribe(subject(self.vehicle, WATCH), cb=self._take)
        try:
            while True:
                await asyncio.sleep(0.02)
                await self._pass_on()
        finally:
            await subscription.unsubscribe()

    async def _take(self, message: Msg) -> None:
        self.requests.append(json.loads(message.data))

    async def _pass_on(self) -> None:
        envelopes = self.bus.receive(0.0)
        if self.silent or not self.requests or not self.requests[-1]["watchers"]:
            return
        topics = self.requests[-1]["topics"]
        assert isinstance(topics, list)
        for envelope in envelopes:
            # Several monitors share a topic: each has a turn of its own.
            key = (
                f"{envelope.topic} {envelope.producer} {len(envelope.payload)}"
                if envelope.topic == "trust/monitor"
                else envelope.topic
            )
            if envelope.topic in topics and envelope.received_ns >= self._due_ns.get(key, 0):
                self._due_ns[key] = envelope.received_ns + PERIOD_NS
                await self._client.publish(subject(self.vehicle, f"{LIVE}/{envelope.topic}"), envelope.payload)


@contextmanager
def watched_unit(running: RunningWeb, vehicle: str, folder: Path) -> Iterator[WatchedUnit]:
    """Run such a vehicle."""
    unit = WatchedUnit(running, vehicle, folder)
    task = asyncio.run_coroutine_threadsafe(unit.run(), running.loop)
    try:
        yield unit
    finally:
        task.cancel()
