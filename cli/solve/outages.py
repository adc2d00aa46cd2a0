"""Outages made on purpose: GNSS is taken away at fixed intervals, to see how far the solution drifts."""

from dataclasses import dataclass

from shared.errors import UserError

Gap = tuple[int, int]  # first and last instant [ns], half open


@dataclass
class Outages:
    """GNSS is missing for `gap_ns` of every `period_ns`.

    Without a start the first gap ends a period after the filter is aligned. With one, which is how comparisons with
    others are agreed upon, it begins `start_ns` after the recording does, whatever the filter is doing then.
    """

    gap_ns: int
    period_ns: int
    start_ns: int | None = None  # from the first input of the recording
    recording_ns: int = 0  # stamp of that input
    aligned_ns: int | None = None

    @classmethod
    def parse(cls, text: str) -> "Outages":
        """Read "10/30", which is 10 s of every 30 s, or "60/180@650", where the first gap begins after 650 s."""
        lengths, at, start = text.partition("@")
        try:
            gap_s, period_s = (float(part) for part in lengths.split("/"))
            start_s = float(start) if at else None
        except ValueError as error:
            raise UserError(
                f"--outage {text} is not understood; write seconds as GAP/PERIOD, such as 10/30, or with the start of "
                "the first gap, such as 60/180@650"
            ) from error
        if not 0.0 < gap_s < period_s < 1e6:
            raise UserError(f"--outage {text}: the gap must be longer than 0 s and shorter than the period")
        if start_s is not None and not 0.0 <= start_s < 1e7:
            raise UserError(f"--outage {text}: the first gap begins at a time from 0 s on")
        return cls(round(gap_s * 1e9), round(period_s * 1e9), None if start_s is None else round(start_s * 1e9))

    @property
    def first_ns(self) -> int | None:
        """When the first gap begins, if that is known yet."""
        if self.start_ns is not None:
            return self.recording_ns + self.start_ns
        return None if self.aligned_ns is None else self.aligned_ns + self.period_ns - self.gap_ns

    def hides(self, stamp_ns: int) -> bool:
        """Whether GNSS is missing at an instant."""
        first = self.first_ns
        return first is not None and stamp_ns >= first and (stamp_ns - first) % self.period_ns < self.gap_ns

    def gaps(self, until_ns: int) -> list[Gap]:
        """List the gaps that end before an instant."""
        first = self.first_ns
        if first is None:
            return []
        begins = range(first, until_ns - self.gap_ns + 1, self.period_ns)
        return [(begin, begin + self.gap_ns) for begin in begins]
