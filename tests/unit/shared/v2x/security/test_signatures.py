"""Signatures against the program `openssl`: keys and signatures that it makes, and those of ours that it verifies."""

import hashlib
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature, encode_dss_signature

from shared.v2x.security import signatures
from shared.v2x.security.certificates import Signature
from shared.v2x.security.issuing import signing
from tests.support.patience import HANGS_S

OF_OPENSSL = {
    "ecdsaNistP256": "prime256v1",
    "ecdsaBrainpoolP256r1": "brainpoolP256r1",
    "ecdsaNistP384": "secp384r1",
    "ecdsaBrainpoolP384r1": "brainpoolP384r1",
}


def openssl(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        ["openssl", *arguments], cwd=folder, capture_output=True, text=True, timeout=HANGS_S, check=False
    )
    return done.stdout.strip()


def halves(data: bytes, signer: bytes, name: str) -> bytes:
    """What the outer hash of IEEE 1609.2, 5.3.1 is of: openssl makes that one."""
    return hashlib.new(name, data).digest() + hashlib.new(name, signer).digest()


@pytest.mark.parametrize("curve", signatures.CURVES)
def test_a_ticket_and_a_message_that_openssl_has_signed_are_verified(curve: str, tmp_path: Path) -> None:
    """The key, and the signatures of an authority and of its ticket, come from another program."""
    openssl(tmp_path, "ecparam", "-name", OF_OPENSSL[curve], "-genkey", "-noout", "-out", "key.pem")
    key = serialization.load_pem_private_key((tmp_path / "key.pem").read_bytes(), None)
    holder = signing.issue(key, signing.root_tbs("openssl", 0, 20))  # type: ignore[arg-type]
    name = holder.certificate.hash_name
    data = b"content that a station signs"
    for content, signer in ((data, holder.certificate.canonical), (holder.certificate.tbs, b"")):
        (tmp_path / "data").write_bytes(halves(content, signer, name))
        openssl(tmp_path, "dgst", f"-{name}", "-sign", "key.pem", "-out", "signature.der", "data")
        r, s = decode_dss_signature((tmp_path / "signature.der").read_bytes())
        size = key.key_size // 8  # type: ignore[union-attr]
        made = Signature(curve, r.to_bytes(size), s.to_bytes(size))
        if signer:
            assert signatures.is_signed_by(holder.certificate, content, made)
            assert not signatures.is_signed_by(holder.certificate, content + b".", made)
        else:
            assert signatures.signs_itself(replace(holder.certificate, signature=made))


@pytest.mark.parametrize("curve", signatures.CURVES)
def test_openssl_verifies_what_we_sign(curve: str, tmp_path: Path) -> None:
    holder = signing.issue(signing.key_of(b"ours", curve), signing.root_tbs("ours", 0, 20))
    certificate = holder.certificate
    public = holder.key.public_key().public_bytes(
        serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
    )
    made = certificate.signature
    (tmp_path / "key.pem").write_bytes(public)
    (tmp_path / "signature").write_bytes(encode_dss_signature(int.from_bytes(made.r), int.from_bytes(made.s)))
    for content, answer in ((certificate.tbs, "Verified OK"), (certificate.tbs + b".", "Verification failure")):
        (tmp_path / "data").write_bytes(halves(content, b"", certificate.hash_name))
        command = ("dgst", f"-{certificate.hash_name}", "-verify", "key.pem", "-signature", "signature", "data")
        assert openssl(tmp_path, *command) == answer


def test_the_hash_of_a_384_bit_signer_is_sha_384_on_its_link_alone() -> None:
    """A root of 384 bits signs its authority by SHA-384, the authority of 256 bits its ticket by SHA-256."""
    root = signing.issue(signing.key_of(b"root", "ecdsaBrainpoolP384r1"), signing.root_tbs("root", 0, 20))
    authority = signing.issue(signing.key_of(b"aa"), signing.authority_tbs("aa", 0, 20), root)
    ticket = signing.issue(signing.key_of(b"at"), signing.ticket_tbs(0, 168), authority)
    assert [one.certificate.hash_name for one in (root, authority, ticket)] == ["sha384", "sha256", "sha256"]
    assert root.certificate.digest == hashlib.sha384(root.certificate.encoded).digest()[-8:]
    assert signatures.is_issued_by(authority.certificate, root.certificate)
    assert signatures.is_issued_by(ticket.certificate, authority.certificate)
    assert not signatures.is_issued_by(ticket.certificate, root.certificate)
    assert not signatures.signs_itself(ticket.certificate)
