"""Each detection has exactly one outcome, and a vehicle that sent nothing is known by its detection alone."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from services.monitoring.ledger.ledger import Ledger, PulseTimes
from services.monitoring.ledger.reconciliation import Crossing, Pulse, PulseModel, match, ownership
from shared.messages.toll import LaneBalance, PassageState
from tests.support.v2x.tolling import COUNTED, NS, START_NS, Vehicle, ledger_at

LIMITS = {"detector_sd_s": 0.1, "gate_s": 5.0}
RIPE_NS = START_NS + 400 * NS


def balance(ledger: Ledger, lane: str = "n2", now_ns: int = RIPE_NS) -> LaneBalance:
    ledger.reconcile(now_ns)
    return next(b for b in ledger.balances(0) if b.lane == lane)


def identity(found: LaneBalance) -> bool:
    outcomes = (
        found.charged, found.review, found.undecided, found.unregistered, found.paid_otherwise, found.suspect,
        found.void, found.missed, found.held,
    )  # fmt: skip
    return found.detections == sum(outcomes) + found.pending


def test_a_platoon_is_matched_in_its_order() -> None:
    pulses = [Pulse(n, "n1", n * 1_500_000_000) for n in range(5)]
    crossings = [Crossing(n, n * 1_500_000_000 + 400_000_000, 0.3, "n1", {"n1": 1.0}) for n in range(5)]
    assert match(pulses, crossings, **LIMITS) == {n: n for n in range(5)}


def test_an_undecided_crossing_takes_the_pulse_of_its_more_probable_lane() -> None:
    pulses = [Pulse(1, "n1", 0), Pulse(2, "n2", 0)]
    assert match(pulses, [Crossing(7, 0, 0.2, None, {"n1": 0.3, "n2": 0.7})], **LIMITS) == {2: 7}


def test_a_charge_explains_no_detection_of_another_lane() -> None:
    assert match([Pulse(1, "n1", 0)], [Crossing(7, 0, 0.2, "n2", {"n1": 0.004, "n2": 0.995})], **LIMITS) == {}


def test_an_undecided_crossing_leaves_a_charge_the_only_pulse_that_explains_it() -> None:
    pulses = [Pulse(1, "n1", 0), Pulse(2, "n2", 0)]
    undecided = Crossing(7, 20_000_000, 0.05, None, {"n1": 0.6, "n2": 0.4})
    charged = Crossing(8, 150_000_000, 0.05, "n1", {"n1": 0.995})
    assert match(pulses, [undecided, charged], **LIMITS) == {1: 8, 2: 7}


@pytest.mark.parametrize(("sd_s", "found"), [(0.5, {}), (3.0, {1: 7})])
def test_a_crossing_is_sought_within_three_of_its_standard_deviations(sd_s: float, found: dict[int, int]) -> None:
    assert match([Pulse(1, "n3", 8 * NS)], [Crossing(7, 0, sd_s, "n3", {"n3": 1.0})], **LIMITS) == found


def test_at_most_one_pulse_and_one_crossing_belong_together_whatever_their_order() -> None:
    rng = np.random.default_rng(5)
    pulses = [Pulse(n, f"n{rng.integers(1, 3)}", int(rng.integers(0, 20 * NS))) for n in range(40)]
    crossings = [Crossing(n, int(rng.integers(0, 20 * NS)), 0.3, None, {"n1": 0.5, "n2": 0.5}) for n in range(30)]
    found = match(pulses, crossings, **LIMITS)
    assert len(set(found.values())) == len(found) == 30
    assert match(pulses[::-1], crossings[::-1], **LIMITS) == found


def test_every_detection_has_one_outcome_and_the_hour_adds_up(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    ends = [PassageState.CHARGED, PassageState.CHARGED, PassageState.SUSPECT, PassageState.UNDECIDED, None]
    for n, end in enumerate(ends):
        vehicle = Vehicle(f"v{n}", (n,), crossing_ns=START_NS + (15 + 2 * n) * NS)
        if n not in (1, 3):
            ledger.register(vehicle.registration(), START_NS)
        if end:
            ledger.passage(vehicle.says(end), START_NS + 60 * NS)
        ledger.detect(vehicle.pulse(n), START_NS + 60 * NS)
    found = balance(ledger)
    assert (found.detections, found.charged, found.unregistered) == (5, 1, 1)
    assert (found.review, found.undecided, found.missed, found.suspect) == (1, 1, 1, 0)
    assert found.agrees and identity(found)
    store.close()


def test_a_pulse_is_accounted_for_only_when_its_passage_has_had_time_to_end(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    ledger.detect(Vehicle().pulse(), START_NS + 20 * NS)
    early = balance(ledger, now_ns=START_NS + 60 * NS)
    assert (early.detections, early.pending, early.missed, early.agrees) == (1, 1, 0, True)
    assert balance(ledger).missed == 1
    store.close()


def test_a_charge_in_a_lane_without_a_detector_is_counted_apart_and_disturbs_no_account(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    vehicle = Vehicle()
    ledger.register(vehicle.registration(), START_NS)
    ledger.passage(vehicle.says(PassageState.CHARGED), START_NS + 30 * NS)
    for now_ns in (START_NS + 31 * NS, RIPE_NS):
        found = balance(ledger, now_ns=now_ns)
        assert (found.unconfirmed, found.charged_without_detection, found.agrees) == (1, 0, True)
    store.close()


def test_outcomes_are_counted_as_soon_as_a_passage_explains_a_detection(tmp_path: Path) -> None:
    """The account is closed after 150 s; until then a lane with 56 charges must not show none."""
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", counted=True)
    vehicle = Vehicle(plaza=COUNTED)
    ledger.register(vehicle.registration(), START_NS)
    ledger.detect(vehicle.pulse(), vehicle.crossing_ns)
    now_ns = vehicle.crossing_ns + 3 * NS
    before = balance(ledger, now_ns=now_ns)
    assert (before.detections, before.pending, before.charged, before.provisional) == (1, 1, 0, 0)
    ledger.passage(vehicle.says(PassageState.CHARGED), now_ns)
    found = balance(ledger, now_ns=now_ns)
    assert (found.detections, found.charged, found.pending, found.provisional) == (1, 1, 0, 1)
    closed = balance(ledger)
    assert (closed.detections, closed.charged, closed.pending, closed.provisional) == (1, 1, 0, 0)
    assert found.agrees and closed.agrees and identity(found) and identity(closed)
    store.close()


@pytest.mark.parametrize("lost", [combination for n in range(4) for combination in itertools.combinations(range(5), n)])
def test_lost_and_repeated_pulses_are_counted_once_from_the_next_message(tmp_path: Path, lost: tuple[int, ...]) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    times = [START_NS + n * NS for n in range(6)]
    for n in range(6):
        for _ in range(2 if n not in lost else 0):
            message = Vehicle(crossing_ns=times[n]).pulse(n, earlier_ns=tuple(reversed(times[:n])))
            ledger.detect(message, START_NS + 60 * NS)
    assert balance(ledger, now_ns=START_NS + 60 * NS).detections == 6
    store.close()


def test_pulses_of_another_plaza_or_from_another_year_are_not_counted(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    ledger.detect(Vehicle().pulse().model_copy(update={"plaza": "elsewhere"}), START_NS)
    ledger.detect(Vehicle().pulse(lane="x9"), START_NS)
    ledger.detect(Vehicle(crossing_ns=START_NS - 86_400 * 365 * NS).pulse(), START_NS)
    assert ledger.balances(0) == () and ledger.rejects == {"another plaza": 2}
    store.close()


def test_a_missed_vehicle_is_a_row_of_its_lane_between_the_passages(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", counted=True)
    early, late = Vehicle("a", plaza=COUNTED), Vehicle("b", crossing_ns=START_NS + 90 * NS, plaza=COUNTED)
    ledger.register(early.registration(), START_NS)
    ledger.register(late.registration(), START_NS)
    ledger.passage(early.says(PassageState.CHARGED), early.crossing_ns)
    unseen = Vehicle("c", crossing_ns=START_NS + 40 * NS)
    for number, vehicle in enumerate((early, unseen, late)):
        ledger.detect(vehicle.pulse(number), vehicle.crossing_ns)
    ledger.passage(late.says(PassageState.CHARGED), late.crossing_ns)
    ledger.reconcile(late.crossing_ns)
    ledger.reconcile(START_NS + 300 * NS)
    rows = ledger.state(START_NS + 300 * NS).recent
    assert [row.state.value for row in rows] == ["charged", "missed", "charged"]
    assert (rows[1].lane, rows[1].crossing_ns) == ("n2", unseen.crossing_ns)
    store.close()


def test_radios_without_a_contract_beyond_a_number_are_left_out_and_stop_no_charge(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.monitoring.ledger.ledger.MAX_STRANGERS", 3)
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", counted=True)
    now_ns = START_NS + 30 * NS
    for n in range(5):
        stranger = Vehicle(f"s{n}", (n + 1,), plaza=COUNTED)
        ledger.passage(stranger.says(PassageState.UNREGISTERED), now_ns)
    car = Vehicle("car", (99,), plaza=COUNTED)
    ledger.register(car.registration(), START_NS)
    for state in (PassageState.CROSSED, PassageState.CHARGED):
        ledger.passage(car.says(state), now_ns)
    ledger.detect(car.pulse(), now_ns)
    assert ledger.rejects["crossings without a contract left out"] == 2
    assert len(store.rows("SELECT 1 FROM crossing")) == 4
    store.close()


def test_pulses_near_a_crossing_are_those_of_its_lane_and_time() -> None:
    rng = np.random.default_rng(3)
    rows = {
        key: {"lane": f"n{rng.integers(1, 3)}", "sampled_ns": int(rng.integers(0, 50)), "backward": key % 5 == 0}
        for key in range(60)
    }
    times = PulseTimes(rows)  # type: ignore[arg-type]  # rows of SQLite are read by name only
    for at in range(0, 50, 7):
        expected = {
            key for key, row in rows.items()
            if row["lane"] == "n1" and not row["backward"] and abs(int(str(row["sampled_ns"])) - at) <= 6
        }  # fmt: skip
        assert set(times.near("n1", at, 6)) == expected
    assert times.near(None, 10, 6) == []


MODEL = PulseModel(detector_sd_s=0.1, gate_s=5.0)


def best_by_trying(crossings: list[Crossing], pulses: list[Pulse]) -> dict[Pulse | None, float]:
    """Likelihood of the best assignment for each pulse of the first crossing, by trying all of them.

    Of pulses of one lane less than 0.6 s apart, the most likely one stands for all.
    """
    found: dict[Pulse | None, float] = {}
    for chosen in itertools.product([None, *pulses], repeat=len(crossings)):
        taken = [pulse.key for pulse in chosen if pulse]
        if len(set(taken)) < len(taken):
            continue
        likelihood = MODEL.others_per_s ** (len(pulses) - len(taken))
        for crossing, pulse in zip(crossings, chosen, strict=True):
            if pulse is None:
                likelihood *= MODEL.missed
                continue
            away_s, variance = 1e-9 * (pulse.time_ns - crossing.time_ns), crossing.sd_s**2 + MODEL.detector_sd_s**2
            lane = max(crossing.lanes.get(pulse.lane, 0.0), 1e-3)
            normal = np.exp(-0.5 * away_s**2 / variance) / np.sqrt(2.0 * np.pi * variance)
            likelihood *= (1.0 - MODEL.missed) * lane * (0.99 * normal + 0.01 / 10.0) * (abs(away_s) <= 5.0)
        found[chosen[0]] = max(found.get(chosen[0], 0.0), likelihood)
    kept: dict[Pulse | None, float] = {}
    for own in sorted(found, key=lambda own: -found[own]):
        if own is None or not any(
            other and other.lane == own.lane and abs(other.time_ns - own.time_ns) < 600_000_000 for other in kept
        ):
            kept[own] = found[own]
    return kept


def test_the_pulse_of_a_crossing_is_that_of_the_best_assignment_of_all_around_it() -> None:
    rng = np.random.default_rng(11)
    sure = 0
    for _ in range(60):
        pulses = [Pulse(n, f"n{rng.integers(1, 4)}", int(rng.normal(0.0, 0.5) * NS)) for n in range(rng.integers(1, 5))]
        crossings = [
            Crossing(
                n, int(rng.normal(0.0, 0.3) * NS), float(rng.uniform(0.05, 0.3)), None,
                dict(zip(("n1", "n2", "n3"), rng.dirichlet([1.0, 1.0, 1.0]).tolist(), strict=True)),
            )
            for n in range(rng.integers(1, 4))
        ]  # fmt: skip
        likelihoods = best_by_trying(crossings, pulses)
        best = max(likelihoods, key=lambda own: likelihoods[own])
        found = ownership(crossings[0], pulses, crossings[1:], MODEL)
        assert (found.pulse if found else None) == best
        if found:
            assert found.probability == pytest.approx(likelihoods[best] / sum(likelihoods.values()), rel=1e-9)
            sure += found.probability > 0.99
    assert 5 < sure < 55


def test_two_pulses_of_a_lane_about_one_crossing_leave_it_open_which_is_its_own() -> None:
    crossing = Crossing(7, 0, 0.5, "n1", {"n1": 0.995})
    before, after = Pulse(1, "n1", -550_000_000), Pulse(2, "n1", 500_000_000)
    share = 1.0 / (1.0 + np.exp(-0.5 * (0.55**2 - 0.5**2) / (0.5**2 + 0.1**2)))  # of the two normal densities
    both, alone = ownership(crossing, [before, after], [], MODEL), ownership(crossing, [after], [], MODEL)
    assert both and both.pulse is after and both.probability == pytest.approx(share, abs=2e-3)
    assert alone and alone.probability > 0.99
    axles = ownership(crossing, [after, Pulse(3, "n1", 900_000_000)], [], MODEL)
    assert axles and axles == alone


def test_a_vehicle_that_sends_nothing_beside_an_undecided_one_leaves_its_lane_open() -> None:
    undecided = Crossing(7, 0, 0.05, None, {"n1": 0.6, "n2": 0.4})
    alone = ownership(undecided, [Pulse(1, "n2", 50_000_000)], [], MODEL)
    assert alone and alone.pulse.lane == "n2" and alone.probability > 0.99
    both = ownership(undecided, [Pulse(1, "n2", 50_000_000), Pulse(2, "n1", 0)], [], MODEL)
    assert both and both.probability < 0.8


def test_a_pulse_that_another_vehicle_behind_has_caused_says_nothing_of_a_missed_one() -> None:
    crossing = Crossing(7, 0, 0.05, "n1", {"n1": 0.995})
    late = ownership(crossing, [Pulse(1, "n1", 2 * NS)], [], MODEL)
    assert late is None or late.probability < 0.99


def test_groups_that_nothing_connects_are_assigned_as_all_together() -> None:
    """The sum of costs is that of one table of all pulses and crossings."""
    rng = np.random.default_rng(6)
    pulses = [Pulse(n, f"n{rng.integers(1, 4)}", int(rng.integers(0, 120 * NS))) for n in range(60)]
    lanes = [None, "n1", "n2", "n3"]
    crossings = [
        Crossing(n, int(rng.integers(0, 120 * NS)), float(rng.uniform(0.05, 2.5)), lanes[rng.integers(0, 4)],
                 {"n1": 0.5, "n2": 0.3, "n3": 0.2})
        for n in range(50)
    ]  # fmt: skip
    found = match(pulses, crossings, **LIMITS)
    away_s = np.array([[1e-9 * abs(p.time_ns - c.time_ns) for c in crossings] for p in pulses])
    sds = np.array([crossing.sd_s for crossing in crossings])
    lane = np.array([[crossing.probability(pulse.lane) for crossing in crossings] for pulse in pulses])
    possible = (away_s <= np.maximum(5.0, 3.0 * sds)) & (lane > 0.0)
    cost = np.where(possible, away_s**2 / (sds**2 + 0.01) - 2.0 * np.log(np.maximum(lane, 1e-9)), 1e6)
    rows, columns = linear_sum_assignment(cost)
    whole = [(i, k) for i, k in zip(rows, columns, strict=True) if possible[i, k]]
    assert len(found) == len(whole) < 50
    assert sum(cost[i, k] for i, k in found.items()) == pytest.approx(sum(cost[i, k] for i, k in whole))
