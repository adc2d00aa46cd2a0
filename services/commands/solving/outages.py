"""Outages made on purpose: GNSS is taken away at fixed intervals, to see how far the solution drifts."""

from dataclasses import dataclass

from shared.errors import UserError

Gap = tuple[int, int]  # first and last instant [ns], half open


@dataclass
class Outages:
    """GNSS is missing in the last `gap_ns` of every `period_ns`, counted from the alignment of the filter."""

    gap_ns: int
    period_ns: int
    aligned_ns: int | None = None

    @classmethod
    def parse(cls, text: str) -> "Outages":
        """Read "10/30": 10 s of every 30 s."""
        try:
            gap_s, period_s = (float(part) for part in text.split("/"))
        except ValueError as error:
            raise UserError(f"--outage {text} is not understood; write seconds as GAP/PERIOD, such as 10/30") from error
        if not 0.0 < gap_s < period_s < 1e6:
            raise UserError(f"--outage {text}: the gap must be longer than 0 s and shorter than the period")
        return cls(round(gap_s * 1e9), round(period_s * 1e9))

    def hides(self, stamp_ns: int) -> bool:
        """Whether GNSS is missing at an instant; never before the filter is aligned."""
        if self.aligned_ns is None or stamp_ns < self.aligned_ns:
            return False
        return (stamp_ns - self.aligned_ns) % self.period_ns >= self.period_ns - self.gap_ns

    def gaps(self, until_ns: int) -> list[Gap]:
        """List the gaps that end before an instant."""
        if self.aligned_ns is None:
            return []
        whole = range((until_ns - self.aligned_ns) // self.period_ns)
        ends = [self.aligned_ns + (k + 1) * self.period_ns for k in whole]
        return [(end - self.gap_ns, end) for end in ends]
