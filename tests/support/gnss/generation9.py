"""A u-blox receiver of generation 9 or later that lacks some keys, as others have more ports or messages than it."""

from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from services.sensors.simulator.gnss.receiver_settings import RATE_MEAS, Settings

NAMES = {int(entry[0]): name for name, entry in UBX_CONFIG_DATABASE.items()}


class Generation9(Settings):
    """The settings of the simulated receiver without the keys whose names contain one of some words."""

    def __init__(self, *lacks: str, shortest_ms: int = 25) -> None:
        super().__init__(("nmea",))
        self._shortest_ms = shortest_ms
        self._values = {
            key: value for key, value in self._values.items() if not any(word in NAMES[key] for word in lacks)
        }

    def answer(self, frame: bytes) -> bytes:
        """Answer one command."""
        return b"".join(self.feed(frame))

    def _allowed(self, key: int, value: int) -> bool:
        return super()._allowed(key, value) and (key != RATE_MEAS or value >= self._shortest_ms)

    def every(self, message: str, port: str = "UART1") -> int | None:
        """Epochs from one message to the next at a port; None where the receiver lacks the key."""
        return self._values.get(int(UBX_CONFIG_DATABASE[f"CFG_MSGOUT_UBX_{message.replace('-', '_')}_{port}"][0]))
