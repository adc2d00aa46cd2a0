"""`python -m benchmarks.bus.party`: the simulator, stamping as a real driver does.

It takes the time when it has the bytes of a device in its hands, not when they were due.
"""

import signal
from types import FrameType
from typing import cast

from shared.bus.bus import Bus
from shared.messages.base import Message, RawBytes
from shared.runtime.config import broker_address, load_vehicle, state_dir
from shared.runtime.live import Runner, load_process
from shared.topics import subscriptions


class Driver(Bus):
    """The bus of a driver that takes the time at the last moment."""

    def publish(self, message: Message) -> None:
        """Stamp what a device sent, and send it."""
        if isinstance(message, RawBytes):
            message = message.model_copy(update={"received_ns": self.now_ns()})
        super().publish(message)


def main() -> None:
    """Drive the simulated vehicle of OBU_VEHICLE until SIGTERM."""
    vehicle, name = load_vehicle(), "sensors.simulator"
    bus = Driver(name, vehicle.name, broker_address(), subscriptions(name), state_dir())

    def stop(_number: int, _frame: FrameType | None) -> None:
        bus.stopping = True

    signal.signal(signal.SIGTERM, stop)
    cast(Runner, load_process(name, vehicle)).run(bus)
    bus.close()


if __name__ == "__main__":
    main()
