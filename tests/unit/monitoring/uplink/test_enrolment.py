"""The enrolment as the uplink sees it: what of a renewal that has failed is still so."""

from pathlib import Path

import pytest

from services.monitoring.uplink import enrolment
from services.monitoring.uplink.enrolment import NS, POLL_PERIOD_NS, Enrolment
from shared.errors import UserError
from shared.evidence.signer import FileSigner
from tests.support.dashboard.status_server import eventually
from tests.support.fleet.certificates import Authority


def test_a_refused_renewal_is_told_until_the_unit_is_enrolled_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise UserError("the centre refuses: the certificate is revoked")

    monkeypatch.setattr(enrolment, "renew", refused)
    authority, signer = Authority(), FileSigner(bytes(32))
    authority.enrol(tmp_path, "car-1", 8883, "another key")  # a renewal is due
    unit = Enrolment(tmp_path)
    identity = unit.look(POLL_PERIOD_NS)
    assert identity is not None
    unit.renew(POLL_PERIOD_NS, identity.centre.not_before_ns + NS, signer)
    eventually(lambda: unit.renewal_fault)
    assert unit.renewal_fault == "the certificate is not renewed: the centre refuses: the certificate is revoked"
    authority.enrol(tmp_path, "car-1", 8883, signer.key_id)
    unit.look(3 * POLL_PERIOD_NS)
    assert unit.renewal_fault is None
