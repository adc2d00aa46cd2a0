import pytest

from cli.solve.outages import Outages
from shared.errors import UserError
from tests.support.cases import each

S = 1_000_000_000


def test_gnss_is_not_removed_before_the_alignment() -> None:
    outages = Outages.parse("10/30")
    assert not any(outages.hides(t * S) for t in range(100))
    outages.aligned_ns = 50 * S
    assert not any(outages.hides(t * S) for t in range(50))


def test_gnss_is_removed_in_the_last_part_of_every_period() -> None:
    outages = Outages.parse("10/30")
    outages.aligned_ns = 5 * S
    hidden = [t for t in range(100) if outages.hides(t * S)]
    assert hidden == [*range(25, 35), *range(55, 65), *range(85, 95)]


def test_only_completed_gaps_are_listed() -> None:
    outages = Outages.parse("10/30")
    outages.aligned_ns = 5 * S
    assert outages.gaps(94 * S) == [(25 * S, 35 * S), (55 * S, 65 * S)]
    assert outages.gaps(95 * S)[-1] == (85 * S, 95 * S)
    outages.aligned_ns = None
    assert outages.gaps(95 * S) == []


def test_a_gap_may_be_a_fraction_of_a_second() -> None:
    assert Outages.parse("0.5/2") == Outages(S // 2, 2 * S)


@each("text", ["", "10", "10/", "ten/30", "30/10", "10/10", "0/30", "-1/30", "nan/30", "10/inf", "1/2/3"])
def test_an_invalid_outage_is_reported_with_an_example(text: str) -> None:
    with pytest.raises(UserError, match="--outage"):
        Outages.parse(text)


def test_a_start_time_fixes_the_gaps_independently_of_the_filter() -> None:
    outages = Outages.parse("10/30@50")
    outages.recording_ns = 5 * S
    hidden = [t for t in range(130) if outages.hides(t * S)]
    assert hidden == [*range(55, 65), *range(85, 95), *range(115, 125)]
    outages.aligned_ns = 20 * S
    assert hidden == [t for t in range(130) if outages.hides(t * S)]
    assert outages.gaps(124 * S) == [(55 * S, 65 * S), (85 * S, 95 * S)]


@pytest.mark.parametrize("text", ["10/30@", "10/30@x", "10/30@-1", "10/30@nan", "@50", "10/30@50@60"])
def test_an_invalid_start_is_reported_in_one_sentence(text: str) -> None:
    with pytest.raises(UserError, match="--outage"):
        Outages.parse(text)
