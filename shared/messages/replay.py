"""The replay of a recording: its position, the commands that move it, and what happened during the drive."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from .base import Count, Message, Name, Nanoseconds, Ratio
from .operation import Outage

SLOWEST, FASTEST = 0.1, 100.0  # speed of a replay


class ReplayCommand(StrEnum):
    """What a replay is asked to do."""

    PLAY = "play"
    PAUSE = "pause"
    SEEK = "seek"
    SPEED = "speed"
    REFRESH = "refresh"  # publish the present position anew, for an observer that has just started


class ReplayControl(Message):
    """Plays, pauses, seeks in, or changes the speed of a replay."""

    command: ReplayCommand
    position_s: Annotated[float, Field(ge=0.0, le=1e9)] | None = None  # since the first message; for `seek`
    speed: Annotated[Ratio, Field(ge=SLOWEST, le=FASTEST)] | None = None  # recorded seconds per second; for `speed`


class ReplayState(Message):
    """Position, extent and speed of a replay; all stamps are recorded ones.

    `epoch` counts the jumps. What follows a state that is not `complete` rebuilds the position: first the newest
    message of each topic at the `position_ns` of that state, then what arrived after it. An observer discards what it
    knew and takes all of it in one step when a complete state of the same epoch follows.
    """

    position_ns: Nanoseconds
    begin_ns: Nanoseconds  # first message of the recording
    end_ns: Nanoseconds  # its last message
    speed: Ratio
    playing: bool
    epoch: Count
    complete: bool
    name: Name  # file name of the recording


class TrustChange(Message):
    """A state of the verdict and its begin."""

    since_ns: Nanoseconds
    state: Name


class ReplayEvents(Message):
    """What happened during the whole recorded drive: changes of the verdict, and outages."""

    trust: Annotated[tuple[TrustChange, ...], Field(max_length=500)] = ()
    outages: Annotated[tuple[Outage, ...], Field(max_length=500)] = ()
