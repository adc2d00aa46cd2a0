"""Whose CAM are authenticated, and what becomes of the others: frames of a PKI of the test, and attacks on it."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from services.parsers.v2x.process import Config, Process
from shared.errors import ConfigError
from shared.messages.base import Tick
from shared.messages.v2x import MAX_FRAME_BYTES, Authentication, Cam, CamContent, CamList, Unverified
from shared.runtime.config import parse_vehicle
from shared.v2x import cam, geonetworking, its_time
from shared.v2x.security import trusted, verifier
from shared.v2x.security.issuing import signing
from tests.support.cases import each
from tests.support.v2x import cams
from tests.support.v2x.signing import Pki, Ticket, signed

NOW_NS = 1_795_000_000 * 10**9 + 123_456_789
SECOND_NS, MS = 10**9, 1_000_000
NOW_S = its_time.its_time_ms(NOW_NS) // 1000
PKI = Pki.make(NOW_S)
TICKET = PKI.ticket()
AUTHENTICATED, NOT_VERIFIED = Authentication.AUTHENTICATED, Authentication.SIGNED_NOT_VERIFIED
P256_ORDER = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551


def frame(
    ticket: signing.Holder = TICKET, sent_ns: int = NOW_NS, *, content: CamContent = cams.BRAKING, whole: bool = True
) -> bytes:
    time_ms = its_time.its_time_ms(sent_ns)
    return signing.sign_packet(cams.packet(content, time_ms), ticket, time_ms * 1000, with_certificate=whole)


def unit(folder: Path, pki: Pki = PKI, *, lists: dict[str, Any] | None = None, **security: Any) -> Process:
    """A parser that trusts a PKI."""
    pki.write(folder, **(lists or {}))
    return Process(Config.model_validate({"security": {"trust_folder": folder, **security}}))


def received(process: Process, *frames: bytes, at_ns: int = NOW_NS) -> list[Cam]:
    lists = [message for message in process.handle(cams.batch(frames, at_ns)) if isinstance(message, CamList)]
    return [found for listed in lists for found in listed.cams]


def states(found: list[Cam]) -> list[tuple[Authentication, Unverified | None]]:
    return [(one.authentication, one.unverified) for one in found]


CURVES = ("ecdsaNistP256", "ecdsaBrainpoolP256r1", "ecdsaNistP384", "ecdsaBrainpoolP384r1")


@pytest.mark.parametrize("root_curve", CURVES)
@pytest.mark.parametrize("curve", CURVES)
def test_a_frame_whose_chain_and_signature_hold_is_authenticated_on_every_curve(
    curve: str, root_curve: str, tmp_path: Path
) -> None:
    pki = Pki.make(NOW_S, root_curve)
    ticket = pki.ticket(curve=curve)
    process = unit(tmp_path, pki)
    (found,) = received(process, frame(ticket))
    assert (found.authentication, found.unverified) == (AUTHENTICATED, None)
    assert found.signer == ticket.certificate.digest.hex()
    assert process.rejects == Counter()


def test_the_same_frame_without_trusted_certificates_is_signed_and_not_verified() -> None:
    (found,) = received(Process(Config()), frame())
    assert states([found]) == [(NOT_VERIFIED, Unverified.NO_TRUST)]
    assert found.signer == TICKET.certificate.digest.hex()


def test_frames_with_the_digest_alone_wait_for_the_certificate_and_keep_their_order(tmp_path: Path) -> None:
    process = unit(tmp_path)
    times_ns = [NOW_NS + k * 100 * MS for k in range(6)]
    for at_ns in times_ns[:5]:
        assert received(process, frame(sent_ns=at_ns, whole=False), at_ns=at_ns) == []
    found = received(process, frame(sent_ns=times_ns[5]), at_ns=times_ns[5])
    assert states(found) == [(AUTHENTICATED, None)] * 6
    assert [one.received_ns for one in found] == times_ns
    (later,) = received(process, frame(sent_ns=times_ns[5] + MS, whole=False), at_ns=times_ns[5] + MS)
    assert later.authentication is AUTHENTICATED
    assert process.rejects == Counter()


def test_without_its_certificate_a_frame_is_not_verified_after_a_second(tmp_path: Path) -> None:
    process = unit(tmp_path)
    assert received(process, frame(whole=False)) == []
    assert list(process.handle(Tick(now_ns=NOW_NS + 900 * MS))) == []
    (listed,) = process.handle(Tick(now_ns=NOW_NS + SECOND_NS))
    assert isinstance(listed, CamList)
    assert states(list(listed.cams)) == [(NOT_VERIFIED, Unverified.NO_CERTIFICATE)]


def test_what_waits_is_bounded_and_what_is_beyond_is_not_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verifier, "MOST_HELD", 5)
    monkeypatch.setattr(verifier, "MOST_HELD_OF_TICKET", 3)
    process = unit(tmp_path)
    of_one = [frame(sent_ns=NOW_NS + k * MS, whole=False) for k in range(4)]
    assert states(received(process, *of_one)) == [(NOT_VERIFIED, Unverified.TOO_MANY)]
    of_many = [frame(PKI.ticket(f"car {k}"), whole=False) for k in range(4)]
    assert states(received(process, *of_many)) == [(NOT_VERIFIED, Unverified.TOO_MANY)] * 2


# Attacks


def test_a_forged_signature_is_refused(tmp_path: Path) -> None:
    """Content that its ticket has not signed, and a signature of another key under the victim's certificate."""
    process, genuine = unit(tmp_path), frame()
    other_place = genuine.replace(genuine[80:90], bytes(10), 1)
    thief = replace(PKI.ticket("thief"), certificate=TICKET.certificate)
    assert received(process, genuine[:-1] + bytes([genuine[-1] ^ 1]), frame(thief), frame(thief, whole=False)) == []
    assert process.rejects == Counter({"bad_signature": 3})
    assert AUTHENTICATED not in {one.authentication for one in received(process, other_place)}


def test_a_ticket_that_names_a_trusted_authority_which_has_not_signed_it_is_refused(tmp_path: Path) -> None:
    forger = replace(PKI.authority, key=signing.key_of(b"forger"))
    forged = replace(PKI, authority=forger).ticket("forged")
    process = unit(tmp_path)
    assert received(process, *(frame(forged, NOW_NS + k, whole=k < 2) for k in range(3))) == []
    assert process.rejects == Counter({"bad_signature": 3})


@each(("made_by", "reason"), [(Pki.make(NOW_S, name="own root"), "unknown_issuer"), (None, "unknown_issuer")])
def test_a_chain_to_an_unknown_root_counts_as_unsigned(made_by: Pki | None, reason: str, tmp_path: Path) -> None:
    ticket = made_by.ticket() if made_by else None
    time_ms = its_time.its_time_ms(NOW_NS)
    packet = frame(ticket) if ticket else signed(cams.packet(cams.BRAKING, time_ms), Ticket(), time_ms)
    process = unit(tmp_path)
    (found,) = received(process, packet)
    assert states([found]) == [(NOT_VERIFIED, Unverified(reason))]


def test_a_replay_under_another_hop_limit_or_with_the_other_signature_is_the_same_message(tmp_path: Path) -> None:
    """Both are genuine to the key; `core.toll` tells them from the first by what the CAM states."""
    genuine = frame()
    negated = genuine[:-32] + (P256_ORDER - int.from_bytes(genuine[-32:])).to_bytes(32)
    hops = genuine[:3] + bytes([genuine[3] + 1]) + genuine[4:]
    found = received(unit(tmp_path), genuine, negated, hops)
    assert states(found) == [(AUTHENTICATED, None)] * 3
    assert len({(one.station_id, one.generation_delta_time, one.latitude_deg) for one in found}) == 1


@each(("later_s", "reason"), [(2.1, "too_old"), (65.536, "header_time"), (131.072, "header_time")])
def test_a_replay_of_the_whole_frame_is_too_old(later_s: float, reason: str, tmp_path: Path) -> None:
    process = unit(tmp_path)
    at_ns = NOW_NS + round(later_s * 1e9)
    assert received(process, frame(), at_ns=at_ns) == []
    assert process.rejects == Counter({reason: 1})


def test_a_replay_with_rewritten_times_has_a_signature_of_other_content(tmp_path: Path) -> None:
    """131.072 s later the CAM looks new; the header that would say so is signed, and so is the time of signature."""
    before_ms, later_ns = its_time.its_time_ms(NOW_NS), NOW_NS + 131_072 * MS
    later_ms, genuine = its_time.its_time_ms(later_ns), frame()
    header, time_64 = (before_ms % (1 << 32)).to_bytes(4), (before_ms * 1000).to_bytes(8)
    assert (genuine.count(header), genuine.count(time_64)) == (1, 1)
    rewritten = genuine.replace(header, (later_ms % (1 << 32)).to_bytes(4))
    process = unit(tmp_path)
    assert received(process, rewritten, rewritten.replace(time_64, (later_ms * 1000).to_bytes(8)), at_ns=later_ns) == []
    assert process.rejects == Counter({"generation_time": 1, "bad_signature": 1})


def test_another_cars_valid_ticket_with_the_victims_station_id_is_authenticated_as_that_ticket(tmp_path: Path) -> None:
    thief = PKI.ticket("thief")
    victim_cam, thief_cam = received(unit(tmp_path), frame(), frame(thief))
    assert victim_cam.station_id == thief_cam.station_id
    assert victim_cam.authentication is thief_cam.authentication is AUTHENTICATED
    assert {victim_cam.signer, thief_cam.signer} == {TICKET.certificate.digest.hex(), thief.certificate.digest.hex()}


def hours(since_s: int, count: int) -> dict[str, Any]:
    return {"validityPeriod": signing.validity(since_s, hours=count)}


@each(
    ("pki", "ticket"),
    [
        (PKI, hours(NOW_S - 7200, 1)),
        (PKI, hours(NOW_S + 60, 1)),
        (PKI, hours(NOW_S - 86_401, 168)),  # from before its authority on
        (Pki.make(NOW_S, authority={"validityPeriod": signing.validity(NOW_S - 86_400, hours=2)}), {}),
        (Pki.make(NOW_S, root={"validityPeriod": signing.validity(NOW_S - 86_400, hours=2)}), {}),
    ],
)  # fmt: skip
def test_a_certificate_that_is_not_valid_now_refuses_the_frame(
    pki: Pki, ticket: dict[str, Any], tmp_path: Path
) -> None:
    process = unit(tmp_path, pki)
    assert received(process, frame(pki.ticket(**ticket))) == []
    assert process.rejects == Counter({"expired": 1})


def test_a_ticket_expires_while_it_is_known(tmp_path: Path) -> None:
    process, ticket = unit(tmp_path), PKI.ticket(**hours(NOW_S - 3598, 1))
    assert states(received(process, frame(ticket))) == [(AUTHENTICATED, None)]
    later_ns = NOW_NS + 3 * SECOND_NS
    assert received(process, frame(ticket, later_ns, whole=False), at_ns=later_ns) == []
    assert process.rejects == Counter({"expired": 1})


@each("revoked", [(PKI.authority.certificate.digest,), (PKI.root.certificate.digest,)])
def test_what_a_revoked_authority_has_issued_is_refused(revoked: tuple[bytes, ...], tmp_path: Path) -> None:
    process = unit(tmp_path, lists={"revoked": revoked})
    assert received(process, frame(), frame(whole=False)) == []
    assert process.rejects["revoked"] == 1


def test_a_revocation_counts_while_the_unit_runs(tmp_path: Path) -> None:
    process = unit(tmp_path)
    assert states(received(process, frame())) == [(AUTHENTICATED, None)]
    (tmp_path / "crl").write_bytes(PKI.files(revoked=(PKI.authority.certificate.digest,))["crl"])
    later_ns = NOW_NS + trusted.LOOKED_NS
    list(process.handle(Tick(now_ns=later_ns)))
    assert received(process, frame(sent_ns=later_ns), at_ns=later_ns) == []
    assert process.rejects == Counter({"revoked": 1})


@each(
    ("overdue_s", "unverified"),
    [(-10, None), (3599, None), (3601, Unverified.LISTS_EXPIRED)],
)  # fmt: skip
def test_an_overdue_list_of_revocations_counts_until_its_grace_ends(
    overdue_s: int, unverified: Unverified | None, tmp_path: Path
) -> None:
    process = unit(tmp_path, lists={"until_s": NOW_S - overdue_s}, list_grace_h=1.0)
    (found,) = received(process, frame())
    assert (found.authentication is AUTHENTICATED, found.unverified) == (unverified is None, unverified)
    assert process.rejects == Counter()


def test_without_a_list_of_revocations_no_sender_is_authenticated(tmp_path: Path) -> None:
    process = unit(tmp_path)
    (tmp_path / "crl").unlink()
    list(process.handle(Tick(now_ns=NOW_NS)))
    assert states(received(process, frame())) == [(NOT_VERIFIED, Unverified.NO_REVOCATIONS)]


HERE = {"latitude": 494431234, "longitude": -10993217}
FAR = {"latitude": 484431234, "longitude": -10993217}
CIRCLE, FAR_CIRCLE = (("circularRegion", {"center": place, "radius": 5000}) for place in (HERE, FAR))
RECTANGLE, FAR_RECTANGLE = (
    ("rectangularRegion", [{"northWest": {"latitude": place["latitude"] + 1000, "longitude": -11993217},
                            "southEast": {"latitude": place["latitude"] - 1000, "longitude": -9993217}}])
    for place in (HERE, FAR)
)  # fmt: skip
POLYGON, FAR_POLYGON = (
    ("polygonalRegion", [{"latitude": place["latitude"] + north, "longitude": place["longitude"] + east}
                         for north, east in ((-1000, -1000), (2000, 0), (-1000, 1000))])
    for place in (HERE, FAR)
)  # fmt: skip
FRANCE, GERMANY = ("identifiedRegion", [("countryOnly", 250)]), ("identifiedRegion", [("countryOnly", 276)])


@each("region", [CIRCLE, RECTANGLE, POLYGON, FRANCE])
def test_a_ticket_is_authenticated_in_its_region(region: object, tmp_path: Path) -> None:
    process = unit(tmp_path, countries=(250,))
    assert states(received(process, frame(PKI.ticket(region=region)))) == [(AUTHENTICATED, None)]


@each("region", [FAR_CIRCLE, FAR_RECTANGLE, FAR_POLYGON, GERMANY])
@pytest.mark.parametrize("of", ["ticket", "authority", "root"])
def test_a_position_outside_a_region_of_the_chain_is_refused(of: str, region: object, tmp_path: Path) -> None:
    above: dict[str, Any] = {of: {"region": region}} if of != "ticket" else {}
    pki = Pki.make(NOW_S, **above)
    members: dict[str, Any] = {"region": region} if of == "ticket" else {}
    ticket = pki.ticket(**members)
    process = unit(tmp_path, pki, countries=(250,))
    assert received(process, frame(ticket)) == []
    assert process.rejects == Counter({"wrong_region": 1})


def test_a_cam_without_position_is_in_no_region(tmp_path: Path) -> None:
    process = unit(tmp_path)
    assert received(process, frame(PKI.ticket(region=CIRCLE), content=cams.SILENT)) == []
    assert process.rejects == Counter({"wrong_region": 1})


SPECIAL = {
    ("rescueContainer", ()): 0x0400,
    ("emergencyContainer", ()): 0x0200,
    ("emergencyContainer", (("emergencyPriority", (b"\x80", 2)),)): 0x0240,
    ("safetyCarContainer", (("speedLimit", 80),)): 0x0104,
    ("safetyCarContainer", (("trafficRule", "noPassing"),)): 0x0110,
}


@each(("special", "needed"), list(SPECIAL.items()))
def test_a_special_container_needs_its_permission(
    special: tuple[str, tuple[tuple[str, Any], ...]], needed: int, tmp_path: Path
) -> None:
    kind, members = special
    time_ms = its_time.its_time_ms(NOW_NS)
    payload = cam.encode(cams.BRAKING, time_ms % its_time.CYCLE_MS)
    record = cam.specification().decode("CAM", payload)
    container = {"lightBarSirenInUse": (b"\x80", 2), **dict(members)}
    record["cam"]["camParameters"]["specialVehicleContainer"] = (kind, container)
    body = geonetworking.encode_packet(
        bytes(cam.specification().encode("CAM", record)), replace(cams.SENDER, its_time_ms=time_ms)
    )
    process = unit(tmp_path)
    for ssp, is_granted in ((needed, True), (needed & (needed - 1), False), (0xFFFF & ~needed, False)):
        ticket = PKI.ticket(appPermissions=signing.permissions({36: b"\x01" + ssp.to_bytes(2)}))
        found = received(process, signing.sign_packet(body, ticket, time_ms * 1000, with_certificate=True))
        assert bool(found) is is_granted, hex(ssp)
    assert process.rejects == Counter({"wrong_permission": 2})


@each(
    ("pki", "ticket"),
    [
        (PKI, {"appPermissions": signing.permissions({37: b"\x01\x00\x00\x00"})}),  # of another service
        (PKI, {"appPermissions": [{"psid": 36}]}),  # without SSP
        (PKI, {"appPermissions": signing.permissions({36: b"\x02\x00\x00"})}),  # of another version
        (PKI, {"certIssuePermissions": [signing.may_issue_cam(chain_length=1)]}),  # an authority, and no ticket
        (Pki.make(NOW_S, authority={"certIssuePermissions": []}), {}),
        (Pki.make(NOW_S, root={"certIssuePermissions": [signing.may_issue_cam(chain_length=1)]}), {}),  # too long
    ],
)  # fmt: skip
def test_a_permission_that_the_chain_does_not_grant_is_refused(
    pki: Pki, ticket: dict[str, Any], tmp_path: Path
) -> None:
    process = unit(tmp_path, pki)
    found = received(process, frame(pki.ticket(**ticket)))
    assert not any(one.authentication is AUTHENTICATED for one in found)
    assert process.rejects["wrong_permission"] == 1


def test_a_flood_of_new_tickets_is_bounded_and_known_vehicles_stay_authenticated(tmp_path: Path) -> None:
    """Each flooding frame has a certificate of its own that names a trusted authority: only a signature tells."""
    process = unit(tmp_path)
    assert states(received(process, frame())) == [(AUTHENTICATED, None)]
    forged = replace(PKI, authority=replace(PKI.authority, key=signing.key_of(b"forger")))
    flood = [frame(forged.ticket(f"flood {k}")) for k in range(400)]
    found = received(process, *flood, frame(sent_ns=NOW_NS + MS, whole=False))
    checked = process._trusted._verifier.counts["tickets checked"]
    assert checked <= verifier.TICKETS_S
    assert process.rejects["bad_signature"] == checked - 1
    *others, known = found
    assert set(states(others)) == {(NOT_VERIFIED, Unverified.TOO_MANY)}
    assert known.authentication is AUTHENTICATED


def test_a_new_vehicle_is_authenticated_during_a_flood_once_frames_wait_for_its_certificate(tmp_path: Path) -> None:
    process = unit(tmp_path)
    forged = replace(PKI, authority=replace(PKI.authority, key=signing.key_of(b"forger")))
    flood = [frame(forged.ticket(f"flood {k}")) for k in range(110)]
    assert received(process, *flood, frame())[-1].unverified is Unverified.TOO_MANY
    waiting = [frame(sent_ns=NOW_NS + k * MS, whole=False) for k in range(verifier.WAITING)]
    found = received(process, *waiting, frame(sent_ns=NOW_NS + 9 * MS))
    assert states(found) == [(AUTHENTICATED, None)] * (verifier.WAITING + 1)


def test_a_known_ticket_is_not_verified_again(tmp_path: Path) -> None:
    process = unit(tmp_path)
    received(process, *(frame(sent_ns=NOW_NS + k * MS) for k in range(10)), frame())
    counts = process._trusted._verifier.counts
    assert counts == Counter({"packets checked": 10, "certificates read": 1, "tickets checked": 1})


# Test roots


RSU = '[vehicle]\nrole = "rsu"\n[parsers.v2x.security]\ntrust_folder = "{}"\n'


def test_a_test_root_is_refused_where_the_traffic_is_not_simulated(tmp_path: Path) -> None:
    PKI.write(tmp_path / "test")
    text = RSU.format(tmp_path)
    for sections, expected in (
        ("", Unverified.TEST_ROOT),
        ("[sensors.traffic]\n", None),
        ('[sensors.traffic]\n[sensors.v2x]\ndevice = "udp://127.0.0.1:5000"\n', None),
        ('[sensors.traffic]\n[sensors.v2x]\ndevice = "udp://192.168.7.1:5000"\n', Unverified.TEST_ROOT),
        ('[sensors.traffic]\n[sensors.v2x]\ndevice = "mqtt://127.0.0.1:1883/radio"\n', Unverified.TEST_ROOT),
    ):
        config = parse_vehicle(text + sections).section("parsers.v2x", Config)
        (found,) = received(Process(config), frame())
        assert found.unverified is expected
        assert (found.authentication is AUTHENTICATED) is (expected is None)


def test_a_file_cannot_claim_to_be_simulated() -> None:
    text = '[vehicle]\nrole = "rsu"\n[parsers.v2x]\nsimulated = true\n'
    with pytest.raises(ConfigError, match=r"\[sensors\.traffic\]"):
        parse_vehicle(text).section("parsers.v2x", Config)
    beside = parse_vehicle('[vehicle]\nrole = "rsu"\n[parsers.v2x]\n[sensors.traffic]\n')
    config = beside.section("parsers.v2x", Config)
    assert config.simulated and config.security.trust_folder == Path("deploy/trust")
    assert parse_vehicle('[vehicle]\nrole = "rsu"\n').section("parsers.v2x", Config).security.trust_folder is None


def test_files_that_are_no_certificates_are_counted_and_the_others_used(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("certificates of the plaza")
    process = unit(tmp_path)
    assert process.rejects == Counter({"trust_file": 1})
    assert states(received(process, frame())) == [(AUTHENTICATED, None)]


@pytest.mark.parametrize("signs", [True, False])
def test_bytes_behind_a_frame_are_not_kept(signs: bool, tmp_path: Path) -> None:
    plain = frame() if signs else cams.packet(cams.BRAKING, its_time.its_time_ms(NOW_NS))
    (found,) = received(unit(tmp_path), plain + bytes(MAX_FRAME_BYTES - len(plain)))
    assert found.frame == plain
