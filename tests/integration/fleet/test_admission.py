"""Admission by a whole centre: certificates that end, are foreign or revoked, and the commands of the operator."""

import asyncio
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta, tzinfo
from errno import ENOSPC
from pathlib import Path
from unittest.mock import Mock

import httpx
import psycopg
import pytest
import uvicorn
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec

from fleet.admission import authority as authorities
from fleet.admission import process as admission
from fleet.admission.authority import Authority
from fleet.admission.enrolment import MAX_RENEWALS, Enrolment, Refusal, make_token
from fleet.admission.limits import FREE
from fleet.admission.process import make_app
from fleet.admission.revocation import POLL_PERIOD_S, Revocation
from fleet.centre import Centre
from fleet.database.revoking import LOCK_VEHICLE, REVOKE
from shared.errors import UserError
from shared.evidence.signer import FileSigner
from shared.fleet import enrolling
from shared.fleet.enrolling import enrol, renew
from shared.fleet.identity import UplinkIdentity
from tests.support.dashboard.status_server import eventually
from tests.support.fleet import certificates
from tests.support.fleet.reports import Unit
from tests.support.fleet.vehicle_link import Link, obu, rows, token_for
from tests.support.patience import HANGS_S

Connect = Callable[[UplinkIdentity], Link]


def enrolled(folder: Path, to: Path, vehicle: str, seed: bytes) -> UplinkIdentity:
    return enrol(*token_for(folder, vehicle), vehicle, to, FileSigner(seed.ljust(32, b".")))


def aged(folder: Path, identity: UplinkIdentity, days: float) -> None:
    """Replace the certificate of a vehicle by one of the same key that was made days ago."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.x509.oid import NameOID

    pem = identity.tls.read_bytes()
    key = serialization.load_pem_private_key(pem, None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, identity.centre.vehicle)])
    request = x509.CertificateSigningRequestBuilder().subject_name(name).sign(key, hashes.SHA256())
    made = Authority(Centre(folder).authority).certify(
        request.public_bytes(serialization.Encoding.PEM).decode(),
        identity.centre.vehicle,
        datetime.now(UTC) - timedelta(days=days),
    )
    private = pem.decode().partition("-----BEGIN CERTIFICATE")[0]
    identity.tls.chmod(0o600)
    identity.tls.write_text(private + made.pem)
    with psycopg.connect(Centre(folder).owner_dsn) as db:
        db.execute(
            "UPDATE certificate SET serial = %s, not_before = %s, not_after = %s WHERE vehicle = %s AND kind = 'tls'",
            (made.serial, made.begin, made.end, identity.centre.vehicle),
        )


def test_a_certificate_that_has_ended_does_not_connect_and_is_renewed_even_after_a_winter(
    folder: Path, tmp_path: Path, link: Connect
) -> None:
    identity = enrolled(folder, tmp_path, "winter-1", b"winter")
    aged(folder, identity, 30 + 150)
    assert not link(identity).ready
    assert link(renew(identity, FileSigner(b"winter".ljust(32, b".")))).ready


def test_a_certificate_that_ended_half_a_year_ago_needs_another_token(folder: Path, tmp_path: Path) -> None:
    identity = enrolled(folder, tmp_path, "winter-2", b"two winters")
    aged(folder, identity, 30 + 181)
    with pytest.raises(UserError, match="180 days ago; enrol again"):
        renew(identity, FileSigner(b"two winters".ljust(32, b".")))


def test_a_certificate_of_another_authority_neither_connects_nor_renews(
    folder: Path, tmp_path: Path, link: Connect
) -> None:
    identity = enrolled(folder, tmp_path, "foreign-1", b"foreign")
    key, certificate = certificates.Authority("OBU control centre").certified("foreign-1")
    identity.tls.chmod(0o600)
    identity.tls.write_text(key + certificate)
    assert not link(identity).ready
    with pytest.raises(UserError, match="not of this centre"):
        renew(identity, FileSigner(b"foreign".ljust(32, b".")))


def test_a_renewal_with_a_clock_that_is_days_wrong_is_refused(folder: Path, tmp_path: Path) -> None:
    identity = enrolled(folder, tmp_path, "clock-1", b"clock")
    with pytest.raises(UserError, match="clock of this unit is wrong"):
        renew(
            identity, FileSigner(b"clock".ljust(32, b".")), round(datetime.now(UTC).timestamp() * 1000) - 3 * 86_400_000
        )


def test_revoking_ends_the_connection_at_once_and_leaves_others(folder: Path, tmp_path: Path, link: Connect) -> None:
    stolen = enrolled(folder, tmp_path / "1", "stolen-1", b"stolen")
    connected, other = link(stolen), link(enrolled(folder, tmp_path / "2", "stolen-10", b"other"))
    assert connected.ready
    assert other.ready
    spare = token_for(folder, "stolen-1")
    done = obu("centre", "revoke", "stolen-1", "--reason", "stolen", folder=folder)
    assert done.returncode == 0, done.stderr
    assert len(re.findall("revoked [0-9a-f]{16} of stolen-1", done.stdout)) == 2
    eventually(lambda: connected.ended)
    assert not other.ended
    assert not link(stolen).ready
    with pytest.raises(UserError, match="token has expired"):
        enrol(*spare, "stolen-1", tmp_path / "3", FileSigner(b"s" * 32))
    assert "all keys of stolen-1 are revoked already" in obu("centre", "revoke", "stolen-1", folder=folder).stderr
    audit = rows(folder, "SELECT vehicle, detail->>'reason' FROM audit WHERE action = 'revoked'")
    assert ("stolen-1", "stolen") in audit
    assert "revoked" in obu("centre", "vehicles", folder=folder).stdout


@pytest.mark.slow
def test_a_revocation_of_which_admission_was_not_told_is_found_in_the_database(
    folder: Path, tmp_path: Path, link: Connect
) -> None:
    connected, other = (link(enrolled(folder, tmp_path / name, name, name.encode())) for name in ("lost-1", "lost-10"))
    assert connected.ready and other.ready
    with psycopg.connect(Centre(folder).owner_dsn) as db:
        db.execute("UPDATE certificate SET revoked = now() WHERE vehicle = 'lost-1'")
    eventually(lambda: connected.ended, within_s=POLL_PERIOD_S + 10.0)
    assert not other.ended


def test_a_revocation_that_fails_is_tried_again() -> None:
    tried: list[str] = []

    class FailingRevocation(Revocation):
        async def end(self, vehicle: str) -> None:
            tried.append(vehicle)
            if len(tried) == 1:
                raise TimeoutError("no server of NATS has answered")

    async def revoked() -> list[tuple[str, str]]:
        return [("key 1", "car-1"), ("key 2", "car-1")]

    async def work() -> None:
        look = FailingRevocation(Mock(), Mock(), revoked)
        for _ in range(3):
            await look.look()

    asyncio.run(work())
    assert tried == ["car-1"] * 3


def test_a_connection_that_was_being_admitted_while_its_key_was_revoked_is_ended_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ended, now_s = list[float](), 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)

    class Ending(Revocation):
        async def end(self, vehicle: str) -> None:
            ended.append(now_s)

    async def revoked() -> list[tuple[str, str]]:
        return [("key 1", "car-1")]

    async def work() -> None:
        nonlocal now_s
        look = Ending(Mock(), Mock(), revoked)
        for _ in range(5):
            await look.look()
            now_s += POLL_PERIOD_S

    asyncio.run(work())
    assert ended == [100.0, 100.0 + POLL_PERIOD_S]


def test_what_a_stolen_evidence_key_signs_is_refused_at_once(folder: Path, tmp_path: Path, link: Connect) -> None:
    unit = Unit("stolen-2", 77, round(datetime.now(UTC).timestamp() * 1000))
    vehicle = link(enrol(*token_for(folder, "stolen-2"), "stolen-2", tmp_path, unit.signer))
    vehicle.send("stolen-2", unit.positions())
    eventually(lambda: vehicle.receipts)
    assert vehicle.receipts[0].stored
    assert obu("centre", "revoke", unit.signer.key_id, folder=folder).returncode == 0

    def is_refused() -> bool:
        vehicle.send("stolen-2", unit.positions())
        eventually(lambda: len(vehicle.receipts) > before)
        return bool(vehicle.receipts[-1].refused)

    before = len(vehicle.receipts)
    assert is_refused()
    assert not vehicle.ended  # its TLS key is not revoked


def test_requests_that_are_none_are_answered(folder: Path) -> None:
    centre = Centre(folder)
    with httpx.Client(base_url=centre.enrol_url, verify=False, timeout=HANGS_S) as http:
        assert http.get("/authority.pem").text == Authority(centre.authority).pem
        assert http.get("/docs").status_code == 404
        assert http.post("/enrol", content=b"x" * 40_000).status_code == 413
        assert "no request of a unit" in http.post("/enrol", content=b"{").json()["detail"]
        assert http.post("/renew", json={"certificate": "x"}).status_code == 422


def test_an_address_that_is_refused_too_often_waits_and_others_do_not(dsn: str, tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    app = make_app(Enrolment(lambda: psycopg.connect(dsn), authority, {}), authority)
    body = {"token": "x", "vehicle": "car-1", "request": "x", "evidence": {}}

    async def statuses(address: str, count: int) -> list[int]:
        transport = httpx.ASGITransport(app, client=(address, 1))
        async with httpx.AsyncClient(transport=transport, base_url="https://centre") as http:
            return [(await http.post("/enrol", json=body)).status_code for _ in range(count)]

    assert asyncio.run(statuses("192.0.2.1", 40)) == [403] * FREE + [429] * (40 - FREE)
    assert asyncio.run(statuses("192.0.2.2", 1)) == [403]

    async def statuses_of_a_network(count: int) -> list[int]:
        return [(await statuses(f"2001:db8::{number:x}", 1))[0] for number in range(count)]

    assert asyncio.run(statuses_of_a_network(FREE + 2)) == [403] * FREE + [429] * 2
    assert asyncio.run(statuses("2001:db8:0:1::1", 1)) == [403]


class Requests:
    """Sends requests of units to an admission without a network."""

    def __init__(self, dsn: str, folder: Path, loop: asyncio.AbstractEventLoop) -> None:
        self.dsn, self.authority, self.loop = dsn, Authority(folder), loop
        self.app = make_app(Enrolment(lambda: psycopg.connect(dsn), self.authority, {}), self.authority)
        with psycopg.connect(dsn) as db:
            db.execute("INSERT INTO tenant (name) VALUES ('demo')")

    def token(self, vehicle: str | None) -> str:
        with psycopg.connect(self.dsn) as db:
            return make_token(db, self.authority.pem, "demo", vehicle, "a test").partition(".")[0]

    def send(self, path: str, bodies: Sequence[dict[str, object]], address: str = "192.0.2.1") -> list[httpx.Response]:
        """Send requests beside each other."""

        async def work() -> list[httpx.Response]:
            transport = httpx.ASGITransport(self.app, client=(address, 1))
            async with httpx.AsyncClient(transport=transport, base_url="https://centre") as http:
                return list(await asyncio.gather(*(http.post(path, json=body) for body in bodies)))

        return self.loop.run_until_complete(work())

    def statuses(self, path: str, bodies: Sequence[dict[str, object]], address: str = "192.0.2.1") -> Counter[int]:
        return Counter(answer.status_code for answer in self.send(path, bodies, address))


@pytest.fixture
def requests(dsn: str, tmp_path: Path) -> Iterator[Requests]:
    with asyncio.Runner() as runner:
        yield Requests(dsn, tmp_path, runner.get_loop())


def enrolment_of(vehicle: str, token: str, seed: int = 1) -> tuple[dict[str, object], ec.EllipticCurvePrivateKey]:
    key, request = enrolling._key_and_request(vehicle)
    evidence = enrolling._statement(vehicle, request, FileSigner(seed.to_bytes(32, "big")))
    return {"token": token, "vehicle": vehicle, "request": request, "evidence": evidence}, key


def renewal_of(vehicle: str, certificate: str, key: ec.EllipticCurvePrivateKey, seed: int = 1) -> dict[str, object]:
    _, request = enrolling._key_and_request(vehicle)
    evidence = enrolling._statement(vehicle, request, FileSigner(seed.to_bytes(32, "big")))
    made_ms = round(time.time() * 1000)
    signature = key.sign(enrolling.renewal_text(request, made_ms), ec.ECDSA(hashes.SHA256())).hex()
    return {
        "certificate": certificate, "request": request, "made_ms": made_ms, "signature": signature,
        "evidence": evidence,
    }  # fmt: skip


def test_refusals_beside_each_other_are_counted_and_block_no_valid_request_of_that_address(
    requests: Requests,
) -> None:
    wrong = [enrolment_of("car-1", f"guess {n}")[0] for n in range(64)]
    assert requests.statuses("/enrol", wrong) == {403: FREE, 429: 64 - FREE}
    own, key = enrolment_of("car-1", requests.token("car-1"))
    (answer,) = requests.send("/enrol", [own])
    assert answer.status_code == 200, answer.text
    tenant_wide = [enrolment_of(f"new-{n}", requests.token(None), 10 + n)[0] for n in range(3)]
    assert requests.statuses("/enrol", tenant_wide) == {200: 3}
    certificate = answer.json()["certificate"]
    foreign = {**renewal_of("car-1", certificate, key), "signature": "00" * 64}
    assert requests.statuses("/renew", [foreign] * 40) == {429: 40}
    assert requests.statuses("/renew", [foreign] * 64, "192.0.2.9") == {403: FREE, 429: 64 - FREE}
    assert requests.statuses("/renew", [renewal_of("car-1", certificate, key)], "192.0.2.9") == {200: 1}
    assert requests.statuses("/enrol", [own]) == {429: 1}, "a token that is used is none"


def test_who_has_a_token_or_a_certificate_is_refused_with_it_so_often_and_others_are_not_blocked(
    dsn: str, requests: Requests
) -> None:
    token, other = requests.token("car-1"), requests.token("car-2")
    wrong = [enrolment_of("another", token)[0]] * 64
    assert requests.statuses("/enrol", wrong) == {403: FREE, 429: 64 - FREE}
    elsewhere = [enrolment_of("another", token)[0]] * 5
    assert requests.statuses("/enrol", elsewhere, "192.0.2.2") == {429: 5}, "from any address"
    body, key = enrolment_of("car-2", other, 2)
    (answer,) = requests.send("/enrol", [body])
    assert answer.status_code == 200, answer.text
    with psycopg.connect(dsn) as db:
        db.execute("UPDATE certificate SET revoked = now() WHERE vehicle = 'car-2'")
    revoked = [renewal_of("car-2", answer.json()["certificate"], key, 2) for _ in range(40)]
    assert requests.statuses("/renew", revoked, "192.0.2.3") == {403: FREE, 429: 40 - FREE}


def test_what_is_granted_is_not_counted(requests: Requests) -> None:
    fleet = [enrolment_of(f"car-{n}", requests.token(f"car-{n}"), n)[0] for n in range(1, FREE + 5)]
    assert requests.statuses("/enrol", fleet) == {200: FREE + 4}
    assert requests.statuses("/enrol", [enrolment_of("car-1", "guess")[0]]) == {403: 1}


def test_accounts_and_tenants_by_commands(folder: Path) -> None:
    made = obu("centre", "tenant", "add", "north", "--days", "30", folder=folder)
    assert made.returncode == 0, made.stderr
    assert [line.split()[:2] for line in made.stdout.splitlines()[:2]] == [["tenant", "north"], ["north", "keeps"]]
    assert "north" in obu("centre", "tenant", "list", folder=folder).stdout
    assert "already" in obu("centre", "tenant", "add", "north", folder=folder).stderr
    assert obu("centre", "tenant", "retention", "north", "--toll-days", "400", folder=folder).returncode == 0
    kept = rows(folder, "SELECT retention_days, toll_retention_days FROM tenant WHERE name = 'north'")
    assert kept == [(30, 400)]
    assert obu("centre", "tenant", "web-hook", "north", "https://hook.example/", folder=folder).returncode == 0
    assert (
        "web_hook_networks" in obu("centre", "tenant", "web-hook", "north", "https://10.0.0.1/", folder=folder).stderr
    )
    assert obu("centre", "tenant", "budget", "north", "--vehicle-mb", "100", folder=folder).returncode == 0
    assert rows(folder, "SELECT vehicle_mb_day, mb_day FROM tenant WHERE name = 'north'") == [(100, 50_000)]
    assert "say how much" in obu("centre", "tenant", "budget", "north", folder=folder).stderr
    assert "no web hook" in obu("centre", "tenant", "web-hook", "north", "ftp://hook.example", folder=folder).stderr

    assert obu("centre", "token", "--vehicle", "truck-3", "--tenant", "north", folder=folder).returncode == 0
    noted = rows(folder, "SELECT action, vehicle FROM audit JOIN tenant USING (tenant_id) WHERE name = 'north'")
    assert ("made a token", "truck-3") in noted

    added = obu("centre", "account", "add", "nora", "--role", "operator", "--tenant", "north", folder=folder)
    password = added.stdout.rpartition("once: ")[2].strip()
    web = Centre(folder).web_url
    log_in = {"name": "nora", "password": password}
    assert httpx.post(f"{web}/api/login", json=log_in, headers={"X-OBU-CSRF": "login"}).status_code == 200
    assert "another tenant; name that by --tenant" in obu("centre", "account", "add", "nora", folder=folder).stderr
    weak = obu("centre", "account", "add", "otto", "--password-stdin", folder=folder, given="short\n")
    assert "12 to 200 characters" in weak.stderr
    assert obu("centre", "account", "disable", "nora", folder=folder).returncode == 0
    assert httpx.post(f"{web}/api/login", json=log_in, headers={"X-OBU-CSRF": "login"}).status_code == 401
    assert re.search("nora +north +operator .*disabled", obu("centre", "account", "list", folder=folder).stdout)


def test_another_password_leaves_an_account_its_role(folder: Path) -> None:
    def role(*options: str) -> str:
        done = obu("centre", "account", "add", "erna", *options, folder=folder)
        assert done.returncode == 0, done.stderr
        return str(rows(folder, "SELECT role FROM account WHERE name = 'erna'")[0][0])

    assert role() == "viewer"
    assert [role("--role", "admin"), role(), role("--role", "toll"), role()] == ["admin", "admin", "toll", "toll"]
    noted = rows(folder, "SELECT action, detail->>'role' FROM audit WHERE detail->>'name' = 'erna' ORDER BY at")
    assert [noted[0], noted[-1]] == [("added an account", "viewer"), ("gave an account a password", "toll")]


def test_no_token_is_made_for_a_vehicle_of_another_tenant(folder: Path, tmp_path: Path) -> None:
    enrolled(folder, tmp_path, "owned-1", b"owned")
    obu("centre", "tenant", "add", "south", folder=folder)
    refused = obu("centre", "token", "--vehicle", "owned-1", "--tenant", "south", folder=folder)
    assert refused.returncode == 2
    assert "the vehicle owned-1 belongs to the tenant demo; name that one" in refused.stderr


def test_erasing_asks_first_and_says_what_is_gone(folder: Path, tmp_path: Path, link: Connect) -> None:
    unit = Unit("erased-1", 88, round(datetime.now(UTC).timestamp() * 1000))
    vehicle = link(enrol(*token_for(folder, "erased-1"), "erased-1", tmp_path, unit.signer))
    vehicle.send("erased-1", unit.positions())
    eventually(lambda: vehicle.receipts)
    assert "nothing is erased" in obu("centre", "erase", "erased-1", folder=folder, given="n\n").stdout
    assert "erased 1 batches" in obu("centre", "erase", "erased-1", "--yes", folder=folder).stdout
    assert rows(folder, "SELECT count(*) FROM segment WHERE vehicle = 'erased-1'") == [(0,)]
    assert "there is no vehicle" in obu("centre", "erase", "never-was", "--yes", folder=folder).stderr
    assert obu("centre", "retain", folder=folder).returncode == 0


def test_commands_say_what_to_do_where_no_centre_runs(tmp_path: Path) -> None:
    done = obu("centre", "vehicles", folder=tmp_path)
    assert done.returncode != 0
    assert "obu centre up" in done.stderr
    (tmp_path / "centre.toml").write_text("web_port = 70000\n")
    assert "centre.toml: web_port" in obu("centre", "vehicles", folder=tmp_path).stderr


def test_the_certificate_of_the_servers_is_made_anew_near_its_end_and_for_other_names(tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    first = authority.server(("127.0.0.1",))[0].read_bytes()
    assert authority.server(("127.0.0.1",))[0].read_bytes() == first
    assert authority.server(("127.0.0.1", "centre.example"))[0].read_bytes() != first
    assert Authority(tmp_path).pem == authority.pem
    assert {path.name: oct(path.stat().st_mode & 0o777) for path in tmp_path.iterdir() if path.suffix == ".key"} == {
        "ca.key": "0o400", "server.key": "0o400",
    }  # fmt: skip


def test_a_certificate_of_a_clock_that_was_ahead_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    authority = Authority(tmp_path)
    with monkeypatch.context() as ahead:
        ahead.setattr(authorities, "datetime", SkewedClock)
        certificate, _ = authority.server(["127.0.0.1"])
    assert x509.load_pem_x509_certificate(certificate.read_bytes()).not_valid_before_utc > datetime.now(UTC)
    authority.server(["127.0.0.1"])
    assert x509.load_pem_x509_certificate(certificate.read_bytes()).not_valid_before_utc < datetime.now(UTC)


class SkewedClock(datetime):
    """A clock that is wrong by four hundred days."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> "SkewedClock":
        return cls.fromtimestamp(time.time() + 400 * 86_400, tz)


def test_the_servers_have_a_certificate_for_any_name_that_the_settings_take(tmp_path: Path) -> None:
    host = f"{'a' * 60}.centre.example"
    certificate, _ = Authority(tmp_path).server([host, "localhost"])
    names = x509.load_pem_x509_certificate(certificate.read_bytes()).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    assert names.value.get_values_for_type(x509.DNSName) == [host, "localhost"]


def test_a_renewal_of_the_servers_certificate_that_fails_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(admission, "RENEW_PERIOD_S", 0.01)
    asked: list[int] = []

    class Full(Authority):
        def server(self, names: Sequence[str]) -> tuple[Path, Path]:
            asked.append(len(names))
            raise OSError(ENOSPC, "No space left on device")

    async def work() -> None:
        server = uvicorn.Server(uvicorn.Config(app=lambda: None))
        task = asyncio.create_task(admission._renew_certificate(server, Full(tmp_path / "ca"), Centre(tmp_path)))
        async with asyncio.timeout(HANGS_S):
            while len(asked) < 2:
                await asyncio.sleep(0.01)
        task.cancel()

    asyncio.run(work())


def test_no_renewal_slips_past_a_revocation(folder: Path, tmp_path: Path) -> None:
    """Both take the vehicle's lock: who comes second sees what the first has done."""
    identity = enrolled(folder, tmp_path, "car-race", b"race")
    given = {"vehicle": "car-race", "key": None, "reason": "stolen"}
    with ThreadPoolExecutor(1) as pool, psycopg.connect(Centre(folder).owner_dsn) as db:
        db.execute(LOCK_VEHICLE, given)
        renewal = pool.submit(renew, identity, FileSigner(b"another".ljust(32, b".")))
        eventually(lambda: rows(folder, "SELECT FROM pg_locks WHERE locktype = 'advisory' AND NOT granted") != [])
        assert len(db.execute(REVOKE, given).fetchall()) == 2
        db.commit()
        with pytest.raises(UserError, match="revoked"):
            renewal.result()
    assert rows(folder, "SELECT FROM certificate WHERE vehicle = 'car-race' AND revoked IS NULL") == []


def test_a_revocation_waits_for_a_renewal_and_revokes_its_keys_too(folder: Path, tmp_path: Path) -> None:
    enrolled(folder, tmp_path, "car-race-2", b"race 2")
    with ThreadPoolExecutor(1) as pool, psycopg.connect(Centre(folder).owner_dsn) as db:
        db.execute(LOCK_VEHICLE, {"vehicle": "car-race-2"})
        db.execute(
            "INSERT INTO certificate (key_id, vehicle, tenant_id, kind, public_key, serial, not_before, not_after) "
            "SELECT 'renewed', vehicle, tenant_id, kind, public_key, 'ff', not_before, not_after FROM certificate "
            "WHERE vehicle = 'car-race-2' AND kind = 'tls'"
        )
        revocation = pool.submit(obu, "centre", "revoke", "car-race-2", folder=folder)
        eventually(lambda: rows(folder, "SELECT FROM pg_locks WHERE locktype = 'advisory' AND NOT granted") != [])
        db.commit()
        assert "revoked renewed" in revocation.result().stdout
    assert rows(folder, "SELECT FROM certificate WHERE vehicle = 'car-race-2' AND revoked IS NULL") == []


def test_a_vehicle_renews_only_so_often_in_a_day(folder: Path, tmp_path: Path) -> None:
    identity = enrolled(folder, tmp_path, "car-often", b"often")
    for _ in range(MAX_RENEWALS - 1):
        identity = renew(identity, FileSigner(b"often".ljust(32, b".")))
    with pytest.raises(UserError, match="try again tomorrow"):
        renew(identity, FileSigner(b"often".ljust(32, b".")))


def test_a_tls_key_is_certified_once_so_that_every_renewal_counts(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    identity, signer = enrolled(folder, tmp_path, "car-same", b"same"), FileSigner(b"same".ljust(32, b"."))
    made = enrolling._key_and_request("car-same")
    monkeypatch.setattr(enrolling, "_key_and_request", lambda _vehicle: made)
    identity = renew(identity, signer)
    with pytest.raises(UserError, match="registered before"):
        renew(identity, signer)
    audit = rows(folder, "SELECT action FROM audit WHERE vehicle = 'car-same' ORDER BY at")
    assert audit == [("made a token",), ("enrolled",), ("renewed",)]


def test_a_token_that_was_ended_while_an_enrolment_waited_is_not_taken(folder: Path) -> None:
    """The transaction of the enrolment has begun before: its own time does not say whether a token has ended."""
    _, token = token_for(folder, "car-ended")
    begun = psycopg.connect(Centre(folder).owner_dsn)
    begun.execute("SELECT 1")
    with psycopg.connect(Centre(folder).owner_dsn) as db:
        db.execute("UPDATE enrolment SET expires = now() WHERE vehicle = 'car-ended'")
    secret = token.partition(".")[0]
    signer = FileSigner(b"ended".ljust(32, b"."))
    _, request = enrolling._key_and_request("car-ended")
    service = Enrolment(lambda: begun, Authority(Centre(folder).authority), {})
    with pytest.raises(Refusal, match="has expired"):
        service.enrol(secret, "car-ended", request, enrolling._statement("car-ended", request, signer))


def test_a_token_for_any_name_takes_no_name_that_somebody_has(folder: Path, tmp_path: Path) -> None:
    enrolled(folder, tmp_path / "1", "car-mine", b"mine")
    *_, url, token = obu("centre", "token", folder=folder).stdout.split()
    with pytest.raises(UserError, match="taken"):
        enrol(url, token, "car-mine", tmp_path / "2", FileSigner(b"thief".ljust(32, b".")))
    token_for(folder, "car-promised")
    with pytest.raises(UserError, match="taken"):
        enrol(url, token, "car-promised", tmp_path / "2", FileSigner(b"thief".ljust(32, b".")))
    assert enrol(url, token, "car-new", tmp_path / "3", FileSigner(b"new".ljust(32, b"."))).centre.vehicle == "car-new"


def test_a_token_is_listed_and_withdrawn(folder: Path, tmp_path: Path) -> None:
    url, token = token_for(folder, "car-later")
    (line,) = [
        splitline
        for splitline in obu("centre", "tokens", folder=folder).stdout.splitlines()
        if "car-later" in splitline
    ]
    done = obu("centre", "revoke", line.split()[0], folder=folder)
    assert (done.returncode, done.stdout) == (0, "1 unused token ended\n")
    with pytest.raises(UserError, match="has expired; ask for another"):
        enrol(url, token, "car-later", tmp_path, FileSigner(b"later".ljust(32, b".")))
    token_for(folder, "car-later")
    assert obu("centre", "revoke", "car-later", folder=folder).stdout == "1 unused token ended\n"
    again = obu("centre", "revoke", "car-later", folder=folder)
    assert again.returncode == 2 and "`obu centre tokens`" in again.stderr
