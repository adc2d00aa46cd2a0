"""The position in a replay as a function of the host's clock; pure: time is an argument."""

from shared.messages.replay import ReplayCommand, ReplayControl


class Position:
    """Advances from a recorded time at a speed while it plays, and stops at the end of the recording."""

    def __init__(self, begin_ns: int, end_ns: int, speed: float, now_s: float) -> None:
        self.begin_ns, self.end_ns, self.speed, self.playing = begin_ns, end_ns, speed, True
        self._from_ns, self._from_s = begin_ns, now_s

    def at(self, now_s: float) -> int:
        """Give the recorded time [ns] at a time of the host's clock [s]."""
        if not self.playing:
            return self._from_ns
        return min(self._from_ns + round((now_s - self._from_s) * self.speed * 1e9), self.end_ns)

    def apply(self, control: ReplayControl, now_s: float) -> bool:
        """Carry out a command; return whether the position has to be published anew."""
        self._from_ns, self._from_s = self.at(now_s), now_s
        match control.command:
            case ReplayCommand.PLAY:
                self.playing = True
                if self._from_ns >= self.end_ns:  # from the beginning
                    self._from_ns = self.begin_ns
                    return True
            case ReplayCommand.PAUSE:
                self.playing = False
            case ReplayCommand.SPEED:
                self.speed = self.speed if control.speed is None else control.speed
            case ReplayCommand.SEEK:
                wanted_ns = self.begin_ns + round((control.position_s or 0.0) * 1e9)
                self._from_ns = min(max(wanted_ns, self.begin_ns), self.end_ns)
                return True
            case ReplayCommand.REFRESH:
                return True
        return False

    def stop_at_end(self, now_s: float) -> bool:
        """Pause where the recording ends; return whether it has just ended."""
        if self.playing and self.at(now_s) >= self.end_ns:
            self._from_ns, self.playing = self.end_ns, False
            return True
        return False
