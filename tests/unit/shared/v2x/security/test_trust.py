"""Trust from files: roots, lists of a trust list manager and of roots, revocations, and what is not used of them."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import RejectedFrame
from shared.messages.v2x import Unverified
from shared.v2x.security import lists, signatures, trust
from shared.v2x.security.certificates import CRL_PSID, CTL_PSID, take_certificate
from shared.v2x.security.issuing import signing, simulated
from shared.v2x.security.reader import Reader, encoded
from tests.support.cases import each
from tests.support.data import recording
from tests.support.v2x.signing import Pki

NOW_S, DAY_S = 720_000_000, 86_400
PKI = Pki.make(NOW_S)
OTHER = Pki.make(NOW_S, "ecdsaBrainpoolP384r1", name="other")
MANAGER = signing.issue(
    signing.key_of(b"manager", "ecdsaBrainpoolP384r1"),
    {"id": ("name", "TLM"), "validityPeriod": signing.validity(0, years=40),
     "appPermissions": signing.permissions({CTL_PSID: b"\x01\xc8"})},
)  # fmt: skip


def trust_list(
    signer: signing.Holder, kind: bytes, entries: list[bytes], *, until_s: int = NOW_S + DAY_S, issued_s: int = NOW_S,
    full: bool = True, psid: int = CTL_PSID,
) -> bytes:  # fmt: skip
    head = {"version": 1, "nextUpdate": until_s, "isFullCtl": full, "ctlSequence": 3}
    content = b"\x01" + kind + b"\x00" + encoded("TrustListHead", head) + encoded("Quantity", len(entries))
    return signing.sign_data(
        content + b"".join(entries), signer, {"psid": psid, "generationTime": issued_s * 1_000_000}
    )


def entry(kind: bytes, holder: signing.Holder) -> bytes:
    """An added certificate, in the form of its kind."""
    certificate, url = holder.certificate.encoded, encoded("Url", "http://dc.example")
    body = {lists.ROOT: b"\x00" + certificate, lists.AUTHORIZATION: certificate + url,
            lists.MANAGER: b"\x00" + certificate + url, lists.ENROLMENT: b"\x80" + certificate + url + url}  # fmt: skip
    return b"\x80" + kind + body[kind]


def deleted(digest: bytes) -> bytes:
    return b"\x81\x80" + digest


CENTRE = b"\x80\x83" + encoded("Url", "http://dc.example") + encoded("DigestList", [bytes(8)])
ECTL = trust_list(
    MANAGER, lists.OF_MANAGER, [entry(lists.MANAGER, MANAGER), entry(lists.ROOT, PKI.root), CENTRE]
)  # fmt: skip
CTL = trust_list(
    PKI.root, lists.OF_ROOT, [entry(lists.ENROLMENT, OTHER.authority), entry(lists.AUTHORIZATION, PKI.authority)]
)  # fmt: skip
CRL = PKI.files()["crl"]
ROOT, AUTHORITY = PKI.root.certificate.digest, PKI.authority.certificate.digest


def loaded(folder: Path, **files: bytes) -> trust.TrustStore:
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return trust.load(folder)


def test_a_root_of_the_managers_list_and_an_authority_of_the_roots_list_are_trusted(tmp_path: Path) -> None:
    store = loaded(tmp_path, tlm=MANAGER.certificate.encoded, ectl=ECTL, ctl=CTL, crl=CRL)
    assert (store.faults, set(store.roots), set(store.issuers)) == ((), {ROOT}, {AUTHORITY})
    issuer = store.issuers[AUTHORITY]
    assert (issuer.listed_until_s, issuer.root.listed_until_s) == (NOW_S + DAY_S, NOW_S + DAY_S)
    for late_s, doubt in ((0, None), (DAY_S + 3600, None), (DAY_S + 3601, Unverified.LISTS_EXPIRED)):
        assert issuer.doubt(NOW_S + late_s, 3600.0, is_simulated=False) is doubt


def test_beside_a_manager_a_root_in_a_file_is_not_trusted(tmp_path: Path) -> None:
    store = loaded(tmp_path, tlm=MANAGER.certificate.encoded, root=OTHER.root.certificate.encoded,
                   aa=OTHER.authority.certificate.encoded, ectl=ECTL)  # fmt: skip
    assert set(store.roots) == {ROOT} and not store.issuers
    assert [fault.split(":")[0] for fault in store.faults] == ["aa"]


def test_the_newest_list_counts_and_what_it_deletes_is_not_trusted(tmp_path: Path) -> None:
    newer = trust_list(MANAGER, lists.OF_MANAGER, [entry(lists.ROOT, PKI.root), deleted(ROOT)], issued_s=NOW_S + 1)
    store = loaded(tmp_path, tlm=MANAGER.certificate.encoded, a=newer, b=ECTL, aa=PKI.authority.certificate.encoded)
    assert not store.roots and not store.issuers


@each(
    ("fault", "files"),
    [
        ("its signer is not trusted", {"ctl": trust_list(OTHER.root, lists.OF_ROOT, [])}),
        ("its signature does not fit it", {"crl": CRL[:-1] + bytes([CRL[-1] ^ 1])}),
        ("it is signed for another service", {"ctl": trust_list(PKI.root, lists.OF_ROOT, [], psid=CRL_PSID)}),
        ("only full ones are used", {"ctl": trust_list(PKI.root, lists.OF_ROOT, [], full=False)}),
        ("its root is not trusted", {"aa": OTHER.authority.certificate.encoded}),
        ("its own signature does not fit it", {"root": PKI.root.certificate.encoded[:-1] + b"\x00"}),
        ("neither a certificate nor a trust list", {"crl": CRL[:-1]}),
        ("neither a certificate nor a trust list", {"aa": PKI.authority.certificate.encoded + b"\x00"}),
        ("neither a certificate nor a trust list", {"text": b"certificates"}),
        ("neither a certificate nor a trust list", {"long": bytes(trust.MOST_BYTES + 1)}),
    ],
)  # fmt: skip
def test_files_that_do_not_prove_themselves_are_named_and_not_used(
    fault: str, files: dict[str, bytes], tmp_path: Path
) -> None:
    folder = tmp_path / str(len(list(tmp_path.iterdir())))
    folder.mkdir()
    store = loaded(folder, **{"root": PKI.root.certificate.encoded, **files})
    named = [each for each in store.faults if "roots in files do not count" not in each]
    assert len(named) == 1 and fault in named[0]
    assert not store.issuers


@each("place", ("missing", "a_file"))
def test_a_folder_that_cannot_be_read_is_a_fault_that_names_it(place: str, tmp_path: Path) -> None:
    (tmp_path / "a_file").write_bytes(b"")
    store = trust.load(tmp_path / place)
    assert len(store.faults) == 1 and str(tmp_path / place) in store.faults[0] and "irectory" in store.faults[0]
    assert not trust.load(tmp_path.parent / tmp_path.name).roots  # the sub-folder `test` need not be there


@each(
    "damaged",
    [
        {"tlm": b""},
        {"tlm": MANAGER.certificate.encoded[:-1]},
        {"tlm": MANAGER.certificate.encoded[:-1] + bytes([MANAGER.certificate.encoded[-1] ^ 1])},
        {"tlm": bytes(trust.MOST_BYTES + 1)},
        {"ectl": ECTL},
        {"ectl": ECTL[:-1]},
    ],
)
def test_where_there_is_or_may_be_a_manager_a_root_in_a_file_does_not_count(
    damaged: dict[str, bytes], tmp_path: Path
) -> None:
    folder = tmp_path / str(len(list(tmp_path.iterdir())))
    folder.mkdir()
    store = loaded(folder, **PKI.files(), **damaged)
    assert not store.roots and not store.issuers
    assert any("roots in files do not count" in fault for fault in store.faults)


def test_where_a_root_has_a_list_an_authority_counts_only_by_it(tmp_path: Path) -> None:
    without = trust_list(PKI.root, lists.OF_ROOT, [deleted(AUTHORITY)])
    store = loaded(tmp_path, **PKI.files(), ctl=without)
    assert set(store.roots) == {ROOT} and not store.issuers
    assert [fault for fault in store.faults if "the list of its root does not have it" in fault]
    store = loaded(tmp_path, **PKI.files(), ctl=CTL)
    assert not store.faults and store.issuers[AUTHORITY].listed_until_s == NOW_S + DAY_S


def test_a_manager_signs_no_list_of_a_root(tmp_path: Path) -> None:
    """Lists of roots, of authorities and of revocations each need a permission of their own."""
    of_root = trust_list(MANAGER, lists.OF_ROOT, [entry(lists.AUTHORIZATION, PKI.authority)])
    own = trust_list(PKI.root, lists.OF_MANAGER, [entry(lists.ROOT, OTHER.root)])
    store = loaded(tmp_path, tlm=MANAGER.certificate.encoded, ectl=ECTL, of_root=of_root, own=own)
    assert set(store.roots) == {ROOT} and not store.issuers
    assert len(store.faults) == 2


def test_an_authority_whose_permissions_its_root_may_not_grant_is_not_trusted(tmp_path: Path) -> None:
    pki = Pki.make(NOW_S, authority={"appPermissions": signing.permissions({CRL_PSID: b"\x01"})})
    store = loaded(tmp_path, **pki.files())
    assert not store.issuers and "its root may not grant its permissions" in store.faults[0]


def test_a_change_of_a_file_changes_the_fingerprint(tmp_path: Path) -> None:
    before = trust.fingerprint(tmp_path)
    (tmp_path / "test").mkdir()
    (tmp_path / "test" / "root").write_bytes(PKI.root.certificate.encoded)
    assert trust.fingerprint(tmp_path) != before
    assert trust.fingerprint(tmp_path / "missing") == trust.fingerprint(tmp_path / "absent")


def test_the_test_root_of_the_simulation_is_the_one_that_lies_beside_the_code() -> None:
    folder = Path(__file__).parents[5] / "deploy/trust"
    assert {path.name: path.read_bytes() for path in (folder / "test").iterdir()} == simulated.files()
    assert [path.name for path in folder.iterdir()] == ["test"], "no live root comes with the code"
    store = trust.load(folder)
    assert not store.faults and all(root.is_test for root in store.roots.values())
    assert {root.certificate.name for root in store.roots.values()} == {simulated.ROOT_NAME}


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from([ECTL, CTL, CRL, PKI.root.certificate.encoded]),
    st.lists(st.tuples(st.integers(0, 5000), st.integers(0, 255)), min_size=1, max_size=6),
)
def test_damaged_files_are_read_or_rejected(whole: bytes, damage: list[tuple[int, int]]) -> None:
    damaged = bytearray(whole)
    for place, value in damage:
        damaged[place % len(damaged)] = value
    read: Any = lists.read_list if whole[:2] == b"\x03\x81" else lambda data: take_certificate(Reader(data))
    try:
        assert read(bytes(damaged))
    except RejectedFrame as error:
        assert error.reason


@pytest.mark.recording
def test_the_chain_and_the_lists_of_european_pkis_are_read_and_their_signatures_hold() -> None:
    """Certificates of the L0 level of the European PKI and of a French one, which our code has not made."""

    def certificate(name: str) -> Any:
        return take_certificate(Reader((recording("cits_trust") / name).read_bytes()))

    tlm, root, authority, ticket = (certificate(name) for name in ("TLM.cert", "RCA.cert", "AA.cert", "AT_0.cert"))
    assert (tlm.name, root.name, authority.name) == ("EU-TLM_L0", "0_FR-ROOT-CA_L0", "0_FR-AA-3_L0")
    assert signatures.signs_itself(tlm) and signatures.signs_itself(root)
    assert signatures.is_issued_by(authority, root) and signatures.is_issued_by(ticket, authority)
    assert authority.grants_all(ticket.permissions, 1) and root.grants_all(ticket.permissions, 2)
    french = lists.read_list((recording("cits_trust") / "vw_ectl_C8EAAB4C86EBCDD2").read_bytes())
    manager = certificate("vw_tlm_C8EAAB4C86EBCDD2")
    assert signatures.is_signed_by(manager, french.data.tbs_data, french.data.signature)
    european = lists.read_list((recording("cits_trust") / "eu_ectl_E3B49921E05A5953").read_bytes())
    assert (len(european.roots), len(french.roots)) == (25, 2)
    assert all(signatures.signs_itself(one) for one in (*european.roots, *french.roots))
    assert root.digest in {one.digest for one in european.roots}
