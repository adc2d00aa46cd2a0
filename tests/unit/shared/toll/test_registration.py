"""A registration is accepted only with the signatures of the ticket's key and of the operator."""

import pytest

from shared.errors import RejectedFrame
from shared.messages.toll import TollRegistration
from shared.toll.registration import countersign, fault_of, identity_of, sign_possession, ticket_of
from tests.support.cases import each
from tests.support.v2x.tickets import NS, OPERATOR, STRANGER, Ticket

START_NS = 1_790_000_000 * NS
MINE, OTHER = Ticket("mine"), Ticket("other")


def fault(registration: TollRegistration, *, require: bool = True, plaza: str = "example") -> str | None:
    return fault_of(
        registration, plaza=plaza, operator_keys=[OPERATOR.public_key.hex()], require_ticket=require
    )  # fmt: skip


def test_a_registration_with_both_signatures_is_accepted() -> None:
    registration = MINE.registration("contract-1", START_NS, station_id=7)
    assert fault(registration) is None and fault(registration, require=False) is None
    assert identity_of(registration) == f"ticket {MINE.digest}"
    assert fault(TollRegistration.model_validate_json(registration.model_dump_json())) is None


@each(
    "change",
    [{"contract": "contract-2"}, {"tariff_class": "truck"}, {"station_id": 8}, {"valid_until_ns": START_NS + 119 * NS},
     {"sampled_ns": START_NS + 1}, {"ticket": OTHER.digest}, {"certificate": OTHER.certificate}, {"possession": None},
     {"possession": "00" * 64}, {"certificate": b"no certificate"}, {"certificate": b""}],
)  # fmt: skip
def test_a_change_of_what_the_ticket_has_signed_is_found(change: dict[str, object]) -> None:
    registration = MINE.registration("contract-1", START_NS, station_id=7).model_copy(update=change)
    assert fault(registration) == "registration_not_possessed"


def test_the_ticket_of_another_cannot_be_registered() -> None:
    """The operator signs what it is sent; the key of the victim's ticket is not there."""
    plain = MINE.registration("contract-1", START_NS)
    forged = sign_possession(plain, OTHER.certificate, MINE.sign)
    assert fault(countersign(forged, OPERATOR)) == "registration_not_possessed"


@each("change", [{"countersignature": None}, {"operator_key": STRANGER.key_id}, {"countersignature": "00" * 64}])
def test_without_the_operator_nothing_is_registered(change: dict[str, object]) -> None:
    registration = MINE.registration("contract-1", START_NS)
    assert fault(registration.model_copy(update=change)) == "registration_not_countersigned"
    assert fault(MINE.registration("contract-1", START_NS, operator=STRANGER)) == "registration_not_countersigned"


def test_a_registration_holds_for_one_passage_at_one_plaza() -> None:
    assert fault(MINE.registration("contract-1", START_NS, valid_s=601.0)) == "registration_validity"
    assert fault(MINE.registration("contract-1", START_NS, valid_s=0.0)) == "registration_validity"
    assert fault(MINE.registration("contract-1", START_NS), plaza="another") == "registration_of_another_plaza"


def test_a_station_id_is_registered_only_where_the_plaza_allows_it() -> None:
    plain = TollRegistration(
        sampled_ns=START_NS, contract="c", tariff_class="car", station_id=7, valid_until_ns=START_NS + NS
    )
    assert fault(plain) == "registration_without_ticket" and fault(plain, require=False) is None
    assert identity_of(plain) == "station 7"
    nothing = plain.model_copy(update={"station_id": None})
    assert fault(nothing, require=False) == "registration_without_ticket"


@pytest.mark.parametrize("data", [b"", b"\x80", MINE.certificate[:40]])
def test_bytes_that_are_no_certificate_are_rejected(data: bytes) -> None:
    with pytest.raises(RejectedFrame):
        ticket_of(data)
