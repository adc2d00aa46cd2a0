"""The offline runtime: all processes that are functions of their messages, in one thread, in time order."""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from typing import cast

from ..faults import Faults
from ..messages.base import Message, Tick
from ..messages.trust import TrustRecord
from ..processes import BY_NAME
from ..topics import BY_MESSAGE, subscriptions
from .config import VehicleFile
from .live import TICK_NS, Reactor, arrival_ns, handled, load_process


class OfflineUnit:
    """Layers 2 to 4 of one vehicle, each message delivered to its consumers in the order published.

    A unit begins as one that was `stopped` in order at standstill, without anything open; otherwise nothing is known of
    the time before, as after the installation.
    """

    def __init__(self, vehicle: VehicleFile, processes: Sequence[str] | None = None, *, stopped: bool = True) -> None:
        names = [name for name in processes or vehicle.processes if BY_NAME[name].is_function]
        self._vehicle = vehicle
        self._processes = {name: cast(Reactor, load_process(name, vehicle)) for name in names}
        self._consumers = {
            kind: [name for name in row.consumers if name in names and name not in row.producers]  # not its own message
            for kind, row in BY_MESSAGE.items()
        }
        self._next_tick_ns: int | None = None
        self._retained: dict[type[Message], Message] = {}  # newest of each topic that the broker keeps
        self._faults = {name: Faults(Counter()) for name in names}
        if stopped and "core.trust" in self._processes:
            list(self._handled("core.trust", TrustRecord(sampled_ns=0, ended_in_order=True, moving=False)))

    def process(self, name: str) -> Reactor:
        """One of the processes."""
        return self._processes[name]

    def run(self, inputs: Iterable[Message]) -> Iterator[Message]:
        """Feed inputs in order of arrival; yield each input and the messages that follow from it."""
        for message in inputs:
            stamp_ns = arrival_ns(message)
            if stamp_ns is not None:
                yield from self._ticks_until(stamp_ns)
            yield from self._deliver(message)
            if BY_MESSAGE[type(message)].persist:
                yield from self._restore(message)

    def _restore(self, saved: Message) -> Iterator[Message]:
        """Give what an earlier unit has saved to the processes that publish it, if they use it."""
        for name in BY_MESSAGE[type(saved)].producers:
            if name in self._processes and BY_MESSAGE[type(saved)] in subscriptions(name):
                for message in self._handled(name, saved):
                    yield from self._deliver(message)

    def end(self, names: Sequence[str]) -> None:
        """End processes as SIGKILL would."""
        for name in names:
            self._processes.pop(name, None)

    def begin(self, names: Sequence[str]) -> Iterator[Message]:
        """Begin processes that have ended; yields what follows from the retained messages that they receive."""
        for name in names:
            self._processes[name] = cast(Reactor, load_process(name, self._vehicle))
            for topic in subscriptions(name):
                if (kept := self._retained.get(topic.message)) is not None:
                    for message in self._handled(name, kept):
                        yield from self._deliver(message)

    def close(self) -> Iterator[Message]:
        """End every process as SIGTERM would; yield their last messages."""
        for process in self._processes.values():
            closing = getattr(process, "close", None)
            if closing is not None:
                for message in closing():
                    yield from self._deliver(message)

    def _ticks_until(self, stamp_ns: int) -> Iterator[Message]:
        if self._next_tick_ns is None:
            self._next_tick_ns = (stamp_ns // TICK_NS + 1) * TICK_NS
        if stamp_ns >= self._next_tick_ns:
            # A gap in a recording is one step of time, as for a live process after suspension.
            tick = Tick(now_ns=stamp_ns // TICK_NS * TICK_NS)
            self._next_tick_ns = tick.now_ns + TICK_NS
            for name in self._processes:
                for message in self._handled(name, tick):
                    yield from self._deliver(message)

    def _deliver(self, first: Message) -> Iterator[Message]:
        waiting = deque([first])
        while waiting:
            message = waiting.popleft()
            yield message
            if BY_MESSAGE[type(message)].retain:
                self._retained[type(message)] = message
            for name in self._consumers[type(message)]:
                if name in self._processes:
                    waiting.extend(self._handled(name, message))

    def _handled(self, name: str, message: Message) -> Iterator[Message]:
        return handled(self._processes[name], message, self._faults[name], self._next_tick_ns or 0)
