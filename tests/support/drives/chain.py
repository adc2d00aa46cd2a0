"""Fusion, the monitors and the verdict on a simulated drive in one thread: messages go to their consumers at once."""

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from services.core.fusion.process import Config as FusionConfig
from services.core.fusion.process import Process as Fusion
from services.core.motion_conflict.process import Config as MotionConfig
from services.core.motion_conflict.process import Process as Motion
from services.core.spoofing.grade import Grade
from services.core.spoofing.process import Config as SpoofingConfig
from services.core.spoofing.process import Process as Spoofing
from services.core.trust.facts import Monitor
from services.core.trust.process import Config as TrustConfig
from services.core.trust.process import Process as Trust
from services.sensors.simulator.drive import Drive
from shared.messages.base import Message, Tick
from shared.messages.imu import ImuSamples
from shared.messages.navigation import FilterState
from shared.messages.trust import Outcome, TrustMonitor, TrustRecord, TrustState
from shared.topics import BY_MESSAGE
from tests.support.drives.spoofing import SECOND_NS, drag_off, inputs

KMH = 1.0 / 3.6


def attacked(
    drive: Drive, begin_s: float, end_s: float, acceleration: float, speed: float, *, held: bool = False
) -> Drive:
    """A drag-off with an end, after which velocities are authentic again, and positions unless the offset is held."""
    dragged = drag_off(drive, begin_s, acceleration, speed)
    on = (drive.fix_ns < end_s * SECOND_NS)[:, None]
    after = drive.fix_position
    if held:
        last = int(on.sum()) - 1
        after = after + (dragged.fix_position[last] - drive.fix_position[last])
    return replace(
        drive,
        fix_velocity_n=np.where(on, dragged.fix_velocity_n, drive.fix_velocity_n),
        fix_position=np.where(on, dragged.fix_position, after),
    )


class Chain:
    """The core processes of a unit; the satellites pass once a second."""

    def __init__(self, drive: Drive, *, follow: bool = True) -> None:
        self._drive, self._follow = drive, follow
        lever = {"vehicle.gnss.lever_arm_body_m": tuple(drive.lever_arm_b)}
        self._fusion_config = FusionConfig().with_values(lever)
        required = tuple(monitor for monitor in Monitor if monitor is not Monitor.EVIDENCE)
        self.processes: dict[str, Any] = {
            "core.fusion": Fusion(self._fusion_config),
            "core.motion_conflict": Motion(MotionConfig()),
            "core.spoofing": Spoofing(SpoofingConfig(grade=Grade.INDUSTRIAL).with_values(lever)),
            "core.trust": Trust(TrustConfig(required_monitors=required)),
        }
        list(self.processes["core.trust"].handle(TrustRecord(sampled_ns=0, ended_in_order=True, moving=False)))
        self._retained: dict[type, Message] = {}
        self.consumed: list[Message] = []  # by core.fusion

    def run(
        self, *, dead: tuple[float, float] | None = None, gap: tuple[float, float] | None = None
    ) -> Iterator[Message]:
        """Everything on the bus; core.fusion is dead for a time, and inertial samples are missing for a time."""
        for message in inputs(self._drive, resolution_m_s=KMH):
            now_ns = message.now_ns if isinstance(message, Tick) else message.received_ns
            if gap and isinstance(message, ImuSamples) and gap[0] <= now_ns / SECOND_NS < gap[1]:
                continue
            if dead and dead[0] <= now_ns / SECOND_NS < dead[1]:
                self.processes.pop("core.fusion", None)
            elif "core.fusion" not in self.processes:
                self._restart_fusion()
            yield from self._deliver(message)

    def _restart_fusion(self) -> None:
        fusion = Fusion(self._fusion_config)
        for kind in (FilterState, TrustState):
            if kind in self._retained:
                list(fusion.handle(self._retained[kind]))  # type: ignore[arg-type]
        self.processes = {"core.fusion": fusion, **self.processes}

    def _deliver(self, first: Message) -> Iterator[Message]:
        waiting: deque[Message] = deque()
        if isinstance(first, Tick):
            for process in list(self.processes.values()):
                waiting.extend(process.handle(first))
            waiting.append(
                TrustMonitor(
                    sampled_ns=first.now_ns, monitor="satellites", outcome=Outcome.PASS, reason="not part of it"
                )
            )
        else:
            waiting.append(first)
        while waiting:
            message = waiting.popleft()
            yield message
            self._retained[type(message)] = message
            row = BY_MESSAGE[type(message)]
            for name, process in self.processes.items():
                if name not in row.consumers or name in row.producers:
                    continue
                if name == "core.fusion":
                    if isinstance(message, TrustState) and not self._follow:
                        continue
                    self.consumed.append(message)
                waiting.extend(process.handle(message))
