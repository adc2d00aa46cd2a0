"""Pictures, payments and the hourly account of each lane."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from services.monitoring.ledger.ledger import Ledger
from services.monitoring.ledger.store import Store
from shared.messages.explanation import explain
from shared.messages.toll import (
    LaneBalance,
    PassageState,
    PictureAction,
    PictureAnswer,
    PictureOrder,
    PictureState,
    TollPayment,
)
from shared.toll.plaza import parse_plaza
from tests.support.v2x.tolling import NS, START_NS, WITH_DETECTORS, Vehicle, ledger_at

MIXED_N1 = WITH_DETECTORS.replace('"lane": "n1",', '"lane": "n1", "traffic": "mixed",')
PLAZA = parse_plaza(MIXED_N1.encode())
RIPE_NS = START_NS + 250 * NS
TAKE, KEEP, DELETE = PictureAction.TAKE, PictureAction.KEEP, PictureAction.DELETE
CAR = Vehicle("a", plaza=PLAZA)


class Plaza:
    """A ledger of a plaza with a mixed lane n1, and what it orders of the cameras."""

    def __init__(self, path: Path) -> None:
        self.ledger: Ledger
        self.store: Store
        self.ledger, self.store = ledger_at(path, plaza_file=MIXED_N1)
        self.orders: list[PictureOrder] = []
        self.pulses = 0

    def pulse(self, car: Vehicle) -> None:
        self.ledger.detect(car.pulse(self.pulses), car.crossing_ns)
        self.pulses += 1

    def end(self, car: Vehicle, state: PassageState = PassageState.CHARGED, *, registered: bool = True) -> None:
        if registered:
            self.ledger.register(car.registration(), car.opened_ns)
        if state is PassageState.CHARGED:
            self.ledger.passage(car.says(PassageState.CROSSED), car.crossing_ns)
        self.ledger.passage(car.says(state), car.crossing_ns + 3 * NS)

    def work(self, now_ns: int) -> list[PictureAction]:
        """What is ordered until a time."""
        self.ledger.reconcile(now_ns)
        self.ledger.expire(now_ns)
        orders = self.ledger.pictures.due(now_ns)
        for order in orders:
            self.ledger.pictures.sent(order)
        self.orders += orders
        return [order.action for order in orders]

    def pay(self, lane: str, time_ns: int, number: str = "1") -> None:
        payment = TollPayment(sampled_ns=time_ns, plaza=PLAZA.name, lane=lane, payment=number)
        self.ledger.use(payment, time_ns + 60 * NS)

    def balance(self) -> LaneBalance:
        (found,) = self.ledger.balances(0)
        assert found.agrees
        return found


@pytest.fixture
def plaza(tmp_path: Path) -> Iterator[Plaza]:
    made = Plaza(tmp_path / "ledger.sqlite")
    yield made
    made.store.close()


def test_each_pulse_takes_a_picture_and_a_charge_deletes_it_at_once(plaza: Plaza) -> None:
    plaza.pulse(CAR)
    assert plaza.work(CAR.crossing_ns) == [TAKE]
    assert plaza.orders[0].until_ns == CAR.crossing_ns + 600 * NS
    plaza.end(CAR)
    assert plaza.work(CAR.crossing_ns + 4 * NS) == [DELETE]
    assert plaza.orders[0].picture == plaza.orders[1].picture
    assert plaza.work(RIPE_NS) == []
    assert plaza.store.rows("SELECT * FROM picture") == []


@pytest.mark.parametrize(("lane", "action"), [("n2", KEEP), ("n1", DELETE)])
def test_the_picture_of_a_vehicle_that_nothing_explains_stays_in_a_lane_for_c_its_only(
    plaza: Plaza, lane: str, action: PictureAction
) -> None:
    plaza.pulse(replace(CAR, lane=lane))
    plaza.work(CAR.crossing_ns)
    assert plaza.work(RIPE_NS) == [action]
    assert plaza.balance().missed == 1
    end_ns = CAR.crossing_ns + 7 * 86_400 * NS
    assert plaza.orders[-1].until_ns == (end_ns if action is KEEP else CAR.crossing_ns + 600 * NS)
    if action is KEEP:
        assert plaza.ledger.state(RIPE_NS).pictures_kept == 1
        assert plaza.work(end_ns) == [] and plaza.work(end_ns + NS) == [DELETE]
        plaza.work(end_ns + 2 * NS)
        assert plaza.store.rows("SELECT * FROM picture") == []


def test_a_vehicle_without_a_contract_owes_in_a_lane_for_c_its_only(plaza: Plaza) -> None:
    plaza.pulse(CAR)
    plaza.end(CAR, PassageState.UNREGISTERED, registered=False)
    plaza.work(CAR.crossing_ns)
    assert plaza.work(RIPE_NS) == [KEEP]
    assert plaza.balance().unregistered == 1


def test_the_picture_of_a_review_is_kept_and_the_page_says_what_decides(plaza: Plaza) -> None:
    plaza.pulse(CAR)
    plaza.work(CAR.crossing_ns)
    plaza.end(CAR, PassageState.SUSPECT)
    assert plaza.work(RIPE_NS) == [KEEP]
    assert plaza.orders[-1].reason_code == explain("ledger.picture_review")
    (review,) = plaza.ledger.state(RIPE_NS).reviews
    assert review.decided_by_code == explain("ledger.by_picture") and review.decided_by
    assert plaza.balance().review == 1


def test_what_was_paid_otherwise_settles_one_pulse_of_a_mixed_lane(plaza: Plaza) -> None:
    first, second = replace(CAR, lane="n1"), replace(CAR, lane="n1", crossing_ns=CAR.crossing_ns + 3 * NS)
    for car in (first, second):
        plaza.pulse(car)
    plaza.pay("n1", first.crossing_ns + NS)
    plaza.pay("n1", first.crossing_ns + NS)  # repeated
    plaza.work(CAR.crossing_ns)
    plaza.work(RIPE_NS)
    found = plaza.balance()
    assert (found.detections, found.paid_otherwise, found.missed) == (2, 1, 1)


def test_a_vehicle_with_cam_and_without_contract_may_pay_otherwise(plaza: Plaza) -> None:
    car = replace(CAR, lane="n1")
    plaza.pulse(car)
    plaza.end(car, PassageState.UNREGISTERED, registered=False)
    plaza.pay("n1", car.crossing_ns)
    plaza.work(RIPE_NS)
    assert (plaza.balance().paid_otherwise, plaza.balance().unregistered) == (1, 0)


def test_a_charge_is_not_settled_by_a_payment(plaza: Plaza) -> None:
    car = replace(CAR, lane="n1")
    plaza.pulse(car)
    plaza.end(car)
    plaza.pay("n1", car.crossing_ns)
    plaza.work(RIPE_NS)
    assert (plaza.balance().charged, plaza.balance().paid_otherwise) == (1, 0)


def test_a_payment_in_a_lane_for_c_its_only_is_refused(plaza: Plaza) -> None:
    plaza.pay("n2", CAR.crossing_ns)
    plaza.pay("nowhere", CAR.crossing_ns, "2")
    assert plaza.ledger.rejects == {"payment in a lane for C-ITS only": 1, "another plaza": 1}


def test_one_contract_in_two_lanes_at_once_is_reviewed_twice_and_pays_nothing(plaza: Plaza) -> None:
    other = Vehicle("a again", (7,), "n3", crossing_ns=CAR.crossing_ns + NS, plaza=PLAZA)
    for car in (CAR, other):
        plaza.pulse(car)
        plaza.end(car)
        plaza.work(car.crossing_ns + 4 * NS)
    plaza.work(RIPE_NS)
    found = plaza.ledger.state(RIPE_NS)
    assert (found.transactions - found.reversals, found.amount_cents, len(found.reviews)) == (0, 0, 2)
    assert {review.reason_code.code for review in plaza.ledger.reviews() if review.reason_code} == {"ledger.elsewhere"}


@pytest.mark.parametrize(("after_s", "charged"), [(40.0, 1), (90.0, 2)])
def test_a_contract_that_passes_again_in_less_than_a_drive_round_is_reviewed(
    plaza: Plaza, after_s: float, charged: int
) -> None:
    """The second interval begins so long after the end of the first one."""
    opened_ns = CAR.crossing_ns + round(after_s * NS)
    again = Vehicle("a again", CAR.station_ids, opened_ns=opened_ns, crossing_ns=opened_ns + 15 * NS, plaza=PLAZA)
    for car in (CAR, again):
        plaza.pulse(car)
        plaza.end(car)
        plaza.work(car.crossing_ns + 4 * NS)
    assert plaza.ledger.state(RIPE_NS).transactions == charged
    codes = [review.reason_code.code for review in plaza.ledger.reviews() if review.reason_code]
    assert codes == ([] if charged == 2 else ["ledger.drive_round"])


def test_an_order_is_sent_again_until_the_camera_has_answered_it(plaza: Plaza) -> None:
    def state(at_s: float, *answered: PictureOrder, failed: int = 0) -> int:
        now_ns = CAR.crossing_ns + round(at_s * NS)
        answers = tuple(PictureAnswer(picture=order.picture, action=order.action) for order in answered)
        said = PictureState(sampled_ns=now_ns, plaza=PLAZA.name, failed=failed, answered=answers)
        plaza.ledger.use(said, now_ns)
        return now_ns

    plaza.pulse(CAR)
    assert plaza.work(state(0.0)) == [TAKE] and plaza.work(state(5.0)) == []
    assert plaza.work(state(16.0, failed=1)) == [TAKE]
    assert plaza.ledger.state(state(17.0, failed=1)).pictures_failed == 1
    assert plaza.work(state(50.0, plaza.orders[-1])) == []
    plaza.end(CAR)
    assert plaza.work(state(52.0)) == [DELETE]
    assert plaza.work(state(90.0, plaza.orders[0])) == [DELETE], "the answer to another order is none to this one"
    plaza.work(state(91.0, plaza.orders[-1]))
    assert plaza.store.rows("SELECT * FROM picture") == []
