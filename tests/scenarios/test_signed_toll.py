"""Signed CAM through the whole role, and attacks on them: who is charged, and who cannot be made to pay."""

from dataclasses import replace
from pathlib import Path

import pytest

from cli.verify_toll import differences_of, parse, read
from services.monitoring.ledger.pack import chain_notes, frame_faults
from shared.messages.toll import EvidencePack, PassageState, TollReview
from shared.v2x import its_time
from shared.v2x.security.issuing import signing
from shared.v2x.security.trust import load
from tests.support.v2x.role import COMMON
from tests.support.v2x.signed_role import PKI, UTC_NS, SignedRole, plain_packet, station, utc_ns
from tests.support.v2x.signing import Pki
from tests.support.v2x.toll import Vehicle

CAR = Vehicle(7, "n2", error=COMMON)
CROSSING_S = 12.5
CHARGED, SUSPECT = PassageState.CHARGED, PassageState.SUSPECT
P256_ORDER = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551


def with_other_signature(frame: bytes) -> bytes:
    """The same message by another hop limit, and s replaced by n - s."""
    return frame[:3] + bytes([frame[3] + 1]) + frame[4:-32] + (P256_ORDER - int.from_bytes(frame[-32:])).to_bytes(32)


def reasons(reviews: list[TollReview]) -> list[str]:
    return [review.reason_code.code for review in reviews if review.reason_code]


def test_a_signed_vehicle_is_charged_as_authenticated(tmp_path: Path) -> None:
    own = station("car")
    role = SignedRole(tmp_path, (CAR,), pulses_s=(CROSSING_S,), signers=(own,), registrants={7: own})
    role.drive(50.0)
    assert list(role.outcomes().values()) == [CHARGED]
    (transaction,) = role.ledger.due(10**18)
    assert transaction.authenticated and transaction.contract == "contract of 7"
    assert role.parser.rejects.total() == 0
    charged = role.statements[-1]
    assert charged.authenticated and charged.tickets == (own.holder.certificate.digest.hex(),)
    (evidence,) = read(tmp_path / "ledger.sqlite")
    pack = parse(evidence)
    assert differences_of(evidence, pack) == []
    for change, fault in (
        (plain_packet(CAR, 1.0), "a frame of an authenticated passage is not signed"),
        (station("thief").sign(plain_packet(CAR, 1.0), utc_ns(1.0)), "a frame is signed by another ticket"),
    ):
        assert any(fault in found for found in frame_faults(with_first_frame(pack, change)))
    evidence_of = pack.crossed.evidence
    assert evidence_of is not None
    data = evidence_of.frames[0].data
    check_chain(pack, tmp_path)
    forged = data[:-1] + bytes([data[-1] ^ 1])
    assert [*frame_faults(with_first_frame(pack, forged))] == ["the signature of a frame does not verify"]
    assert [*frame_faults(pack.model_copy(update={"registrations": ()}))] == [
        "no registration has the certificate of a frame's ticket"
    ]


def check_chain(pack: EvidencePack, folder: Path) -> None:
    """The authority of a charge is judged by the lists of then, and what was revoked since takes nothing from it."""
    start_s = its_time.its_time_ms(UTC_NS) // 1000
    day_s, ours = 86_400, (PKI.authority.certificate.digest,)
    then, later, last = start_s - 1, start_s + day_s, start_s + 2 * day_s
    for name, lists, is_fault, text in (
        ("trusted", [(then, ())], False, "trusted, by the list of revocations of"),
        ("then", [(then, ours)], True, "revoked by the list of"),
        ("reissued", [(last, ours)], True, "since when is not known"),
        ("before", [(then, ()), (last, ours)], True, "since when is not known"),
        ("since", [(later, ()), (last, ours)], False, "revoked since, by the list of"),
        ("repeated", [(later, ours), (last, ours)], True, "since when is not known"),
    ):
        folder_of = PKI.write(folder / name)
        (folder_of / "crl").unlink()
        for number, (issued_s, revoked) in enumerate(lists):
            crl = signing.revocation_list(PKI.root, issued_s, start_s + 100 * day_s, revoked)
            (folder_of / f"crl{number}").write_bytes(crl)
        (note,) = chain_notes(pack, load(folder_of), last)
        assert (note.is_fault, text in note.text) == (is_fault, True), note
    (note,) = chain_notes(pack, load(folder / "trusted"), start_s + 101 * day_s)
    assert not note.is_fault and "a list has expired" in note.text
    PKI.write(folder / "simulated" / "test")
    (note,) = chain_notes(pack, load(folder / "simulated"), last)
    assert note.is_fault and "a test root" in note.text
    (folder / "nothing").mkdir()
    (note,) = chain_notes(pack, load(folder / "nothing"), last)
    assert note.is_fault and "not trusted by the folder" in note.text
    trusted = load(folder / "trusted")
    charged, crossed = (said.model_copy(update={"tickets": ()}) for said in (pack.charged, pack.crossed))
    assert [len([*chain_notes(pack.model_copy(update=change), trusted, last)]) for change in (
        {"charged": charged}, {"crossed": crossed})] == [1, 1], "either names the ticket"  # fmt: skip
    (note,) = chain_notes(pack.model_copy(update={"charged": charged, "crossed": crossed}), trusted, last)
    assert note.is_fault and "names no ticket" in note.text
    (note,) = chain_notes(pack.model_copy(update={"registrations": ()}), trusted, last)
    assert note.is_fault and "no registration has the certificate" in note.text


def with_first_frame(pack: EvidencePack, data: bytes) -> EvidencePack:
    """The pack with other bytes in the place of its first frame, labelled as before."""
    evidence = pack.crossed.evidence
    assert evidence is not None
    frames = (evidence.frames[0].model_copy(update={"data": data}), *evidence.frames[1:])
    crossed = pack.crossed.model_copy(update={"evidence": evidence.model_copy(update={"frames": frames})})
    return pack.model_copy(update={"crossed": crossed})


def test_an_unsigned_vehicle_is_charged_nowhere_by_the_ticket_of_a_contract(tmp_path: Path) -> None:
    """Its contract is registered by a ticket, which its CAM do not show, wherever authentication is required."""
    for required in (True, False):
        own = station("car")
        role = SignedRole(tmp_path / str(required), (CAR,), pulses_s=(CROSSING_S,), signers=(None,),
                          registrants={7: own}, require_authenticated=required)  # fmt: skip
        role.drive(50.0)
        assert (role.state().transactions, [*role.outcomes().values()]) == (0, [SUSPECT])
        assert reasons(role.reviews()) == ["ledger.identity"]
        assert not any(statement.authenticated or statement.tickets for statement in role.statements)


def test_a_station_id_is_no_contract_where_authentication_is_required(tmp_path: Path) -> None:
    """Where the plaza allows it the same registration is enough, and the charge says so."""
    for required, state in ((True, PassageState.UNREGISTERED), (False, CHARGED)):
        role = SignedRole(tmp_path / str(required), (CAR,), pulses_s=(CROSSING_S,), signers=(None,),
                          require_authenticated=required)  # fmt: skip
        role.drive(50.0)
        assert [*role.outcomes().values()] == [state]
        assert [transaction.authenticated for transaction in role.ledger.due(10**18)] == ([] if required else [False])


@pytest.mark.parametrize("signs", [False, True], ids=["unsigned", "valid ticket"])
def test_a_stranger_with_the_victims_station_id_changes_nothing_of_the_victims_passage(
    tmp_path: Path, signs: bool
) -> None:
    """He sends it first, from the other carriageway: the victim is tracked, charged once, in his lane."""
    victim, thief = station("victim"), station("thief")
    stranger = replace(CAR, lane="s1", start=-300.0)
    role = SignedRole(tmp_path, (stranger, CAR), pulses_s=(CROSSING_S,), signers=(thief if signs else None, victim),
                      registrants={7: victim})  # fmt: skip
    role.drive(50.0)
    (transaction,) = role.ledger.due(10**18)
    assert (transaction.lane, transaction.contract) == ("n2", "contract of 7")
    assert role.statements and {s.authenticated for s in role.statements if s.state is CHARGED} == {True}


def test_a_copy_of_every_frame_with_other_signatures_makes_no_second_charge(tmp_path: Path) -> None:
    """At once, after 131 s as received, and after 131 s with the times rewritten; a pulse is there for each."""
    own, later_s = station("car"), 131.072
    role = SignedRole(tmp_path, (CAR,), pulses_s=(CROSSING_S, CROSSING_S + later_s), signers=(own,),
                      registrants={7: own})  # fmt: skip
    copier = station("car")  # the same key and ticket: what the car will send
    role.is_lost = lambda t, _vehicle: t > 20.0
    for k in range(200):
        t = k / 10.0
        frame = copier.sign(plain_packet(CAR, t), utc_ns(t))
        role.injected += [(t + 0.05, with_other_signature(frame)), (t + later_s, frame)]
    role.drive(160.0 + 31.0)
    assert (role.state().transactions, role.state().in_review) == (1, 0)
    assert len({statement.passage_id for statement in role.statements}) == 1
    assert role.parser.rejects["header_time"] == 200
    assert role.core is not None and role.core.rejects["late_or_repeated"] >= 190


def test_a_chain_of_a_root_of_his_own_counts_as_unsigned(tmp_path: Path) -> None:
    """Signed, with the victim's station ID and a chain that is not trusted: no passage of the victim's contract."""
    victim = station("victim")
    own = station("thief")
    foreign = Pki.make(its_time.its_time_ms(utc_ns(0.0)) // 1000, name="own root")
    own.holder = foreign.ticket("thief")
    role = SignedRole(tmp_path, (CAR,), pulses_s=(CROSSING_S,), signers=(own,), registrants={7: victim})
    role.drive(50.0)
    assert (role.state().transactions, [*role.outcomes().values()]) == (0, [SUSPECT])
    assert reasons(role.reviews()) == ["ledger.identity"]
    assert not any(statement.authenticated for statement in role.statements)


def test_a_cam_that_was_charged_unsigned_is_recognised_under_another_header(tmp_path: Path) -> None:
    """The plaza allows unsigned CAM; 131.072 s later its frames come again under new headers, with a pulse."""
    later_s = 131.072
    role = SignedRole(tmp_path, (CAR,), pulses_s=(CROSSING_S, CROSSING_S + later_s), signers=(None,),
                      require_authenticated=False)  # fmt: skip
    role.is_lost = lambda t, _vehicle: t > 20.0
    for k in range(200):
        role.injected.append((k / 10.0 + later_s, plain_packet(CAR, k / 10.0, later_s)))
    role.drive(later_s + 60.0)
    assert role.state().transactions == 1
    assert reasons(role.reviews()) == ["ledger.replayed"]
