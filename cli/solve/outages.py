"""Simulated GNSS outages at fixed intervals, to evaluate the drift of the solution."""

from dataclasses import dataclass

from shared.errors import UserError

Gap = tuple[int, int]  # first and last instant [ns], half open


@dataclass
class Outages:
    """GNSS is removed for `gap_ns` of every `period_ns`.

    Without `start_ns` the first gap ends one period after the filter is aligned. With it, as in comparisons with other
    filters, the first gap begins `start_ns` after the start of the recording.
    """

    gap_ns: int
    period_ns: int
    start_ns: int | None = None  # from the first input of the recording
    recording_ns: int = 0  # stamp of that input
    aligned_ns: int | None = None

    @classmethod
    def parse(cls, text: str) -> "Outages":
        """Parse "10/30" (10 s of every 30 s), or "60/180@650" (the first gap begins after 650 s)."""
        lengths, at, start = text.partition("@")
        try:
            gap_s, period_s = (float(part) for part in lengths.split("/"))
            start_s = float(start) if at else None
        except ValueError as error:
            raise UserError(
                f"--outage {text} is invalid; write seconds as GAP/PERIOD, such as 10/30, or with the start of "
                "the first gap, such as 60/180@650"
            ) from error
        if not 0.0 < gap_s < period_s < 1e6:
            raise UserError(f"--outage {text}: the gap must be longer than 0 s and shorter than the period")
        if start_s is not None and not 0.0 <= start_s < 1e7:
            raise UserError(f"--outage {text}: the start of the first gap must be 0 s or later")
        return cls(round(gap_s * 1e9), round(period_s * 1e9), None if start_s is None else round(start_s * 1e9))

    @property
    def first_ns(self) -> int | None:
        """Start of the first gap; None until the filter is aligned."""
        if self.start_ns is not None:
            return self.recording_ns + self.start_ns
        return None if self.aligned_ns is None else self.aligned_ns + self.period_ns - self.gap_ns

    def hides(self, stamp_ns: int) -> bool:
        """Whether GNSS is removed at a time."""
        first = self.first_ns
        return first is not None and stamp_ns >= first and (stamp_ns - first) % self.period_ns < self.gap_ns

    def gaps(self, until_ns: int) -> list[Gap]:
        """The gaps that end before a time."""
        first = self.first_ns
        if first is None:
            return []
        begins = range(first, until_ns - self.gap_ns + 1, self.period_ns)
        return [(begin, begin + self.gap_ns) for begin in begins]
