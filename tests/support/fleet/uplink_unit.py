"""monitoring.uplink in virtual time, fed by messages of a test."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from services.monitoring.uplink.process import Config, Process
from shared.evidence import KeyFile
from shared.messages.base import Message
from shared.messages.trust import TrustLevel
from shared.messages.uplink import UplinkState
from tests.support.bus.envelopes import sent
from tests.support.bus.fake_bus import FakeBus
from tests.support.fleet.certificates import Authority
from tests.support.outputs import fix, solution, verdict
from tests.support.patience import HANGS_S

NS = 1_000_000_000
START_NS = 1_796_000_000 * NS  # of the OBU time line, and of UTC where a test says nothing else
M = TypeVar("M", bound=Message)


class UplinkUnit:
    """An enrolled unit; `drive` gives it solution, verdict and fix once a second of virtual time."""

    def __init__(
        self, state: Path, port: int = 1, *, authority: Authority | None = None, enrolled: bool = False,
        **settings: object,
    ) -> None:  # fmt: skip
        self.state, self.offset_ns = state, 0  # of UTC from the OBU time line
        self.signer = KeyFile(state / "keys").signer()
        if not enrolled:
            (authority or Authority()).enrol(state / "uplink", "car", port, self.signer.key_id)
        self._delivered: list[Message] = []
        self.bus = FakeBus(state, self._deliver, start_ns=START_NS, step_ns=0)
        self._step_ns = 0
        self.process = Process(Config.model_validate(settings))
        self.process._begin(self.bus.as_bus())

    @property
    def now_ns(self) -> int:
        return self.bus.now_ns()

    def turn(self, *messages: Message, step_s: float = 0.0) -> None:
        """Deliver messages after a step of time, and let the process work once."""
        self.bus._now_ns += round(step_s * NS)
        self._delivered = list(messages)
        self.process.turn(self.bus.as_bus())

    def drive(
        self,
        seconds: int,
        level: TrustLevel = TrustLevel.SAFE,
        speed_m_s: float = 5.0,
        also: Sequence[Message] = (),
        utc: bool = True,
        step_s: int = 1,
    ) -> None:
        """Report as a vehicle that drives, or stands, for some seconds."""
        for _ in range(0, seconds, step_s):
            at_ns = self.now_ns + step_s * NS
            moving = solution(at_ns, velocity_ned_m_s=(speed_m_s, 0.0, 0.0), stationary=speed_m_s == 0.0,
                              protection_level_horizontal_m=3.24)  # fmt: skip
            fixes = (fix(at_ns, at_ns + self.offset_ns),) if utc else ()
            self.turn(*fixes, verdict(at_ns, level), moving, *also, step_s=step_s)

    def work_until(self, condition: Callable[[], bool], step_s: float = 0.02, within_s: float = HANGS_S) -> None:
        """Let the process work in real time until a condition holds."""
        deadline = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < deadline, self.state_message()
            self.turn(step_s=step_s)
            self.process._link.wait(min(step_s, 0.02))

    def state_message(self) -> UplinkState:
        return self.of(UplinkState)[-1]

    def of(self, kind: type[M]) -> list[M]:
        return [message for message in self.bus.published if isinstance(message, kind)]

    def close(self) -> None:
        self.process._link.close()
        self.process._reporting.close()

    def _deliver(self, _call: int) -> list:  # type: ignore[type-arg]
        taken, self._delivered = self._delivered, []
        return [sent(message, self.now_ns, "core.trust") for message in taken]
