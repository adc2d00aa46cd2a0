"""Our parties to the measurement: `python -m benchmarks.bus.party pub RATE_HZ COUNT BYTES | sub COUNT | drive`.

`pub` and `sub` do what `sensors.imu` and `parsers.imu` do with a raw message: stamp, encode, send; receive, decode.
`drive` is the simulator, but stamps as a real driver does: when it has the bytes, not when they were due.
"""

import signal
import sys
import time
from types import FrameType
from typing import cast

from shared.bus.bus import Bus
from shared.messages.base import Message, RawBytes
from shared.messages.imu import ImuRaw
from shared.runtime.config import broker_address, load_vehicle, state_dir
from shared.runtime.live import Runner, load_process
from shared.topics import subscriptions

VEHICLE = "bench"


def publish(rate_hz: float, count: int, size: int) -> None:
    """Send a raw message whenever one is due."""
    bus = Bus("sensors.imu", VEHICLE, broker_address(), (), state_dir())
    data = bytes(size)
    while not bus.connected:
        bus.receive(0.1)
    due_s = time.monotonic()
    for _ in range(count):
        due_s += 1 / rate_hz
        while (remaining_s := due_s - time.monotonic()) > 0:
            bus.receive(remaining_s)
        bus.publish(ImuRaw(received_ns=bus.now_ns(), source="bench", data=data))
    bus.close()


def subscribe(count: int) -> None:
    """Print the age of each message, in nanoseconds, when it has been decoded."""
    bus = Bus("parsers.imu", VEHICLE, broker_address(), subscriptions("parsers.imu"), state_dir())
    ages_ns: list[int] = []
    while not bus.connected:
        bus.receive(0.1)
    bus.receive(0.2)  # the answer to the subscription
    print("ready", flush=True)
    while len(ages_ns) < count:
        for envelope in bus.receive(0.1):
            message = envelope.decode()
            if isinstance(message, ImuRaw):
                ages_ns.append(bus.now_ns() - message.received_ns)
    bus.close()
    print(*ages_ns, sep="\n")


class Driver(Bus):
    """The bus of a driver that takes the time at the last moment."""

    def publish(self, message: Message) -> None:
        """Stamp what a device sent, and send it."""
        if isinstance(message, RawBytes):
            message = message.model_copy(update={"received_ns": self.now_ns()})
        super().publish(message)


def drive() -> None:
    """Drive the simulated vehicle of OBU_VEHICLE until SIGTERM."""
    vehicle, name = load_vehicle(), "sensors.simulator"
    bus = Driver(name, vehicle.name, broker_address(), subscriptions(name), state_dir())

    def stop(_number: int, _frame: FrameType | None) -> None:
        bus.stopping = True

    signal.signal(signal.SIGTERM, stop)
    cast(Runner, load_process(name, vehicle)).run(bus)
    bus.close()


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["pub", rate, number, size]:
            publish(float(rate), int(number), int(size))
        case ["sub", number]:
            subscribe(int(number))
        case ["drive"]:
            drive()
        case _:
            sys.exit(__doc__)
