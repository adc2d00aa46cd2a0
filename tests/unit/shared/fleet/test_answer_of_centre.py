"""What a unit takes of a centre that answers a renewal: nothing that it could not say of itself afterwards."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from fleet.admission.authority import Authority
from shared.errors import UserError
from shared.evidence.signer import FileSigner
from shared.fleet import enrolling
from shared.fleet.identity import UplinkIdentity, date_of


@pytest.mark.parametrize(
    ("host", "year"),
    [("h" * 400, 2026), ("", 2026), ("a\ud800b", 2026), ("two\nlines", 2026), ("centre.example", 9990)],
)
def test_an_answer_that_would_end_the_process_is_refused_and_replaces_nothing(
    tmp_path: Path, host: str, year: int
) -> None:
    authority = Authority(tmp_path / "authority")
    key, request = enrolling._key_and_request("car-1")

    def written(name: str, at: datetime) -> None:
        answer: dict[str, object] = {
            "vehicle": "car-1", "tenant": "demo", "certificate": authority.certify(request, "car-1", at).pem,
            "authority": authority.pem, "host": name, "mqtt_port": 8883, "renew_url": "https://centre.example/renew",
        }  # fmt: skip
        identity = enrolling._written(tmp_path / "uplink", answer, key, "ab" * 8)
        assert date_of(identity.centre.not_after_ns)

    with pytest.raises(UserError, match="cannot be used"):
        written(host, datetime(year, 5, 1, tzinfo=UTC))
    assert not (tmp_path / "uplink").exists()
    written("centre.example", datetime(2026, 5, 1, tzinfo=UTC))


def test_a_renewal_for_another_vehicle_is_refused_and_replaces_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    authority, signer = Authority(tmp_path / "authority"), FileSigner(bytes(32))
    names = ["car-1", "car-2", "car-1"]

    def ask(_place: object, _path: str, body: dict[str, str], _context: object) -> dict[str, object]:
        name = names.pop(0)
        return {
            "vehicle": name, "tenant": "demo", "authority": authority.pem, "host": "centre.example", "mqtt_port": 8883,
            "certificate": authority.certify(body["request"], name, datetime(2026, 5, 1, tzinfo=UTC)).pem,
            "renew_url": "https://centre.example/renew",
        }  # fmt: skip

    monkeypatch.setattr(enrolling, "_ask", ask)
    monkeypatch.setattr(enrolling, "_authority_of", lambda _place, _fingerprint: authority.pem)
    token = f"secret.{enrolling.fingerprint_of(authority.pem)}"
    identity = enrolling.enrol("https://centre.example", token, "unit-7", tmp_path / "uplink", signer)
    before = identity.tls.read_bytes()
    with pytest.raises(UserError, match="answers for car-2, and this unit is car-1"):
        enrolling.renew(identity, signer)
    assert identity.tls.read_bytes() == before and UplinkIdentity.read(identity.folder) == identity
    assert enrolling.renew(identity, signer).tls.read_bytes() != before
