"""Examples of what is connected or simulated: a protocol, a device, an attack."""

from .recipe import Example
from .tree import ROOT, Edit

ATTACK: Example = (
    (
        Edit(
            "shared/messages/simulation.py",
            '    WHEEL_SPIN = "wheel_spin"\n',
            after='    WHEEL_ZERO = "wheel_zero"\n',
        ),
    ),
    (
        Edit(
            "shared/attacks.py",
            '    AttackRow(\n        AttackName.WHEEL_SPIN, "the driven wheels spin", "odometer",\n'
            '        (Parameter("factor", 1.3, 1.0, 5.0, "", "of the speed"),),\n    ),\n'
            "    AttackRow(\n        AttackName.TYRE_CHANGE",
            instead_of="    AttackRow(\n        AttackName.TYRE_CHANGE",
        ),
    ),
    (
        Edit(
            "services/sensors/simulator/attacks/effects.py",
            "    AttackName.WHEEL_SPIN: _scaled,\n",
            after="    AttackName.WHEEL_ZERO: _zero,\n",
        ),
    ),
    (Edit("cli/attack_lab/cases.py", ' "wheel_spin",', after='"odometer_scale", "odometer_freeze", "wheel_zero",'),),
    (
        Edit(
            "docs/explanation/simulator.md",
            "| `wheel_spin` | true | true | wheel and OBD-II speeds times the factor |\n| `wheel_zero` |",
            instead_of="| `wheel_zero` |",
        ),
    ),
)

PROTOCOL: Example = (
    (
        Edit(
            "shared/protocols/tsip.py",
            '''"""Trimble TSIP: packets between two bytes that are doubled inside.

Source: Trimble Standard Interface Protocol reference, packet structure.
"""

from collections.abc import Callable

from .framing.finder import Sums
from .framing.framing import Framing
from .protocol import Protocol
from .undecoded import MAX_BYTES


class TsipFraming(Framing):
    """Superpackets 0x8F between DLE and DLE ETX."""

    protocol, begins = "TSIP", ((b"\\x10", b"\\x8f"),)
    starts = rb"\\x10\\x8f[\\xa0-\\xaf]"
    most_bytes = MAX_BYTES

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """Up to the end of the packet."""
        end = buffer.find(b"\\x10\\x03", start + header)
        return end + 2 - start if end >= 0 else None

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """A packet has no checksum."""
        return None


PROTOCOL = Protocol(TsipFraming(), "Trimble TSIP", remedy="switch NMEA on at this port")
''',
        ),
    ),
    (
        Edit(
            "shared/protocols/registry.py",
            "spartn, text, tsip, ubx, undecoded",
            instead_of="spartn, text, ubx, undecoded",
        ),
        Edit("shared/protocols/registry.py", " tsip.PROTOCOL,", after="spartn.PROTOCOL,"),
    ),
)

DRIVER = '''"""Reads the bytes of an inclinometer, which looks like an IMU without gyroscopes."""

from pydantic import Field

from shared.bus.bus import Bus
from shared.devices.driver import Link, run_driver
from shared.devices.recognising import Port
from shared.messages.base import DeviceName
from shared.messages.imu import ImuRaw
from shared.runtime.config import Section


class Config(Section):
    """Settings of the driver of the inclinometer."""

    device: str = Field(default="serial:///dev/obu-tilt?baud=115200", description="URL of the inclinometer")
    source: DeviceName = Field(default="tilt0", description="name of the inclinometer in the published messages")


class Process:
    """Publishes the bytes unchanged."""

    def __init__(self, config: Config) -> None:
        self._config = config

    def run(self, bus: Bus) -> None:
        """Read until the bus stops."""
        link = Link(Port(self._config.device, "imu").open)
        run_driver(bus, link, self._config.device, self._raw, source=self._config.source)

    def _raw(self, data: bytes, received_ns: int) -> ImuRaw:
        return ImuRaw(received_ns=received_ns, source=self._config.source, data=data)
'''
DOCTOR = "cli/doctor/devices.py"
DEVICE: Example = (
    (
        Edit("services/sensors/tilt/__init__.py", '"""Layer 1, inclinometer."""\n'),
        Edit("services/sensors/tilt/process.py", DRIVER),
    ),
    (
        Edit(
            "shared/processes.py",
            """    ProcessRow(
        "sensors.tilt", Kind.DEVICE_DRIVER, "reads the inclinometer",
        container_user=10_130,
        produces=("imu/raw", "origin/state", "device/state"),
    ),
    ProcessRow(
        "sensors.can",""",
            instead_of="""    ProcessRow(
        "sensors.can",""",
        ),
    ),
    (
        Edit(
            "tests/architecture/test_deployment.py",
            '    "sensors.tilt": 10_130,\n',
            after='    "monitoring.uplink": 10_129,\n',
        ),
    ),
    (
        Edit(
            "deploy/compose.vehicle.yml",
            "  sensors-tilt:\n    <<: *serial\n    profiles: [tilt]\n    command: [run, sensors.tilt]\n"
            '    user: "10130:10001"\n',
            after='    command: [run, sensors.imu]\n    user: "10101:10001"\n',
        ),
    ),
    (
        Edit(
            "deploy/systemd/obu@sensors.tilt.service.d/device.conf",
            "[Service]\nPrivateDevices=no\nDevicePolicy=closed\nDeviceAllow=char-ttyUSB rw\n"
            "SupplementaryGroups=dialout\n",
        ),
        Edit(
            "deploy/systemd/obu@sensors.tilt.service.d/hot-path.conf",
            (ROOT / "deploy/systemd/obu@core.fusion.service.d/hot-path.conf").read_text(encoding="utf-8"),
        ),
    ),
    (
        Edit(
            DOCTOR,
            "from services.sensors.tilt.process import Config as TiltDriver\n",
            after="from services.sensors.imu.process import Config as ImuDriver\n",
        ),
        Edit(
            DOCTOR,
            "type[GnssDriver | ImuDriver | CanDriver | TiltDriver]",
            instead_of="type[GnssDriver | ImuDriver | CanDriver]",
        ),
        Edit(DOCTOR, ' "sensors.tilt": TiltDriver,', after='"sensors.can": CanDriver,'),
    ),
)

EXAMPLES = {"attack": ATTACK, "protocol": PROTOCOL, "device": DEVICE}
