"""Rows of the bank: the bits of each depend neither on the others nor on when somebody looks at it."""

import numpy as np
import pytest

from services.core.fusion.hypotheses.bank import Member
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from tests.unit.core.fusion.hypotheses.test_bank import alternatives, drive, run

BEGIN_S, SPLIT_S, END_S = 0.0, 62.0, 72.0


def begun() -> Navigator:
    """A navigator whose bank runs."""
    nav = Navigator(Settings().with_values({"vehicle.gnss.lever_arm_body_m": tuple(drive().lever_arm_b)}))
    run(nav, BEGIN_S, SPLIT_S)
    return nav


def bits(filter_: ErrorStateFilter | None) -> tuple[bytes, bytes]:
    assert filter_ is not None
    time_ns, values, P = filter_.numbers
    return np.int64(time_ns).tobytes() + values.tobytes(), P.tobytes()


def bits_of_rows(nav: Navigator) -> dict[tuple[str, int], tuple[bytes, bytes]]:
    """Of all rows at the horizon."""
    alternatives(nav)  # which brings them there
    return {key(member): bits(member.cursor.engine.filter) for member in nav.bank._members}


def key(member: Member) -> tuple[str, int]:
    return member.kept.hypothesis.value, member.anchor_ns


@pytest.fixture(scope="module")
def together() -> Navigator:
    nav = begun()
    run(nav, SPLIT_S, END_S)
    return nav


def test_the_main_row_alone_is_the_one_beside_the_others(together: Navigator) -> None:
    alone = begun()
    alone.bank.pause(paused=True)
    run(alone, SPLIT_S, END_S)
    assert bits(alone.engine.filter) == bits(together.engine.filter)


def test_each_row_alone_is_the_one_beside_the_others(together: Navigator) -> None:
    expected = bits_of_rows(together)
    assert len(expected) >= 3
    alone = begun()
    kept = alone.bank._members[-1]
    alone.bank._members = [kept]
    alone.bank._anchor = lambda main, time_ns: None  # type: ignore[method-assign]  # no other row begins
    run(alone, SPLIT_S, END_S)
    assert bits_of_rows(alone) == {key(kept): expected[key(kept)]}


def test_looking_at_the_rows_changes_none_of_their_bits(together: Navigator) -> None:
    looked_at = begun()
    for tenths in range(round(10 * SPLIT_S), round(10 * END_S)):
        run(looked_at, 0.1 * tenths, 0.1 * (tenths + 1))
        alternatives(looked_at)
    assert bits_of_rows(looked_at) == bits_of_rows(together)


def test_nothing_that_runs_on_changes_an_array_of_a_snapshot() -> None:
    """Rows and their snapshots share arrays, which are replaced and never written to."""
    nav = begun()
    cursors = [*nav.verdicts.cursors, *(member.cursor for member in nav.bank._members)]
    kept = [snapshot.engine.filter for cursor in cursors for snapshot in cursor._snapshots]
    kept += [cursor.engine.unrecorded().filter for cursor in cursors]
    arrays = [array for f in kept if f is not None for array in (f.P, *f.numbers[1:], *f.noise[:3])]
    before = [array.tobytes() for array in arrays]
    run(nav, SPLIT_S, SPLIT_S + 2.0)
    alternatives(nav)
    assert len(arrays) > 20 and [array.tobytes() for array in arrays] == before
