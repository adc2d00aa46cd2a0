"""COSE_Sign1 against the examples of RFC 9052 (appendix C.2) and of the COSE working group."""

import base64

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePublicKey, EllipticCurvePublicNumbers
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from shared.evidence.signer import FileSigner
from shared.fleet.cbor import BadCbor, decoded
from shared.fleet.cose import TAG, read_sign1, sign1, to_be_signed
from tests.support.cases import each

CONTENT = b"This is the content."
HEX_CONTENT = CONTENT.hex()


def number(text: str) -> int:
    return int.from_bytes(base64.urlsafe_b64decode(text + "=="), "big")


# Key "11" of the examples, and the Ed25519 key of RFC 8032, section 7.1, test 1.
P256 = EllipticCurvePublicNumbers(
    number("usWxHK2PmfnHKwXPS54m0kTcGJ90UiglWiGahtagnv8"),
    number("IBOL-C3BttVivg-lSreASjpkttcsz-1rb7btKLv8EX4"),
    SECP256R1(),
).public_key()
ED25519_SECRET = bytes.fromhex("9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60")
ED25519 = Ed25519PublicKey.from_public_bytes(
    bytes.fromhex("d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a")
)
KEY_11 = "a10442313154" + HEX_CONTENT + "5840"
C_2_1 = (
    "8eb33e4ca31d1c465ab05aac34cc6b23d58fef5c083106c4d25a91aef0b0117e"
    "2af9a291aa32e14ab834dc56ed2a223444547e01f11d3b0916e5a4c345cacb36"
)
EXTERNAL = (
    "10729cd711cb3813d8d8e944a8da7111e7b258c9bdca6135f7ae1adbee950989"
    "1267837e1e33bd36c150326ae62755c6bd8e540c3e8f92d7d225e8db72b8820b"
)
EDDSA = (
    "7142fd2ff96d56db85bee905a76ba1d0b7321a95c8c4d3607c5781932b7afb87"
    "11497dfa751bf40b58b3bcc32300b1487f3db34085eef013bf08f4a44d6fef0d"
)


def message(protected: str, signature: str, content: str = HEX_CONTENT) -> bytes:
    return bytes.fromhex(f"d284{protected}a10442313154{content}5840{signature}")


def test_the_example_of_rfc_9052_verifies_and_names_its_key() -> None:
    read = read_sign1(message("43a10126", C_2_1))
    assert read.is_genuine(P256)
    assert (read.payload, read.algorithm, read.unprotected) == (CONTENT, -7, {4: b"11"})
    assert to_be_signed(read.protected, b"", read.payload) == bytes.fromhex(
        "846a5369676e61747572653143a101264054" + HEX_CONTENT
    )


def test_external_data_are_signed() -> None:
    read = read_sign1(message("43a10126", EXTERNAL))
    assert read.is_genuine(P256, bytes.fromhex("11aa22bb33cc44dd55006699"))
    assert not read.is_genuine(P256)


def test_the_example_of_ed25519_verifies_and_its_key_makes_the_same_signature() -> None:
    read = read_sign1(message("45a201270300", EDDSA))
    assert read.is_genuine(ED25519)
    signer = FileSigner(ED25519_SECRET)
    assert signer.sign(to_be_signed(read.protected, b"", CONTENT)) == read.signature
    assert signer.public_key == ED25519.public_bytes_raw()


@pytest.mark.parametrize(
    "changed",
    [
        message("43a10126", C_2_1, HEX_CONTENT[:-1] + "f"),  # sign-fail-02: content
        message("45a1013903e6", C_2_1),  # sign-fail-03: algorithm
        message("4aa10167756e6b6e6f776e", C_2_1),  # sign-fail-04: algorithm
        message("45a201260300", C_2_1),  # sign-fail-06: one more header
        message("43a10127", C_2_1),  # EdDSA stated for a key of P-256
    ],
)
def test_what_was_changed_does_not_verify(changed: bytes) -> None:
    assert not read_sign1(changed).is_genuine(P256)


@pytest.mark.parametrize("key", [P256, ED25519])
def test_an_algorithm_outside_the_protected_header_is_not_believed(
    key: EllipticCurvePublicKey | Ed25519PublicKey,
) -> None:
    signature = (
        "87db0d2e5571843b78ac33ecb2830df7b6e0a4d5b7376de336b23c591c90c425"
        "317e56127fbe04370097ce347087b233bf722b64072beb4486bda4031d27244f"
    )
    read = read_sign1(bytes.fromhex(f"d28440a201260442313154{HEX_CONTENT}5840{signature}"))
    assert not read.is_genuine(key)


@each(
    "data",
    [
        b"",
        message("43a10126", C_2_1)[1:],  # sign-pass-03: without its tag
        bytes.fromhex("d903e6") + message("43a10126", C_2_1)[1:],  # sign-fail-01: another tag
        message("43a10126", C_2_1) + b"\0",
        message("43a10126", C_2_1)[:-1],
        message("43a10126", C_2_1[:-2]).replace(b"\x58\x40", b"\x58\x3f"),
        message("4101", C_2_1),  # its header is no map
        TAG + b"\x84\x40\xa0\x40",
        TAG + b"\x9f\x40\xa0\x40\x40\xff",
        TAG + b"\x81" * 60,
    ],
)
def test_what_is_no_cose_sign1_is_refused(data: bytes) -> None:
    with pytest.raises(BadCbor):
        read_sign1(data)


@each(
    "text",
    [
        "c249ffffffffffffffffff", "d81c80", "d8238261786178", "c48219ffff01", "9f01ff", "a201020103", "1801",
        "f97e0000", "fb3ff8000000000000",
    ],
)  # fmt: skip
def test_tags_endless_items_double_keys_and_long_forms_are_no_cbor_of_this_protocol(text: str) -> None:
    with pytest.raises(BadCbor):
        decoded(bytes.fromhex(text))


def test_where_the_form_does_not_matter_one_item_still_fills_the_bytes() -> None:
    long_form = bytes.fromhex("8218011801")
    assert decoded(long_form, canonical=False) == [1, 1]
    for data in (long_form + b"\x00", long_form[:-1], bytes.fromhex("9f01ff"), bytes.fromhex("a201020103")):
        with pytest.raises(BadCbor):
            decoded(data, canonical=False)


def test_signed_by_a_unit_it_verifies_with_its_key_and_external_data_alone() -> None:
    signer, other = FileSigner(bytes(32)), FileSigner(b"1" * 32)
    read = read_sign1(sign1(b"content", signer, b"name", b"car-1"))
    key = Ed25519PublicKey.from_public_bytes(signer.public_key)
    assert read.key_id == b"name"
    assert read.is_genuine(key, b"car-1")
    assert not read.is_genuine(key, b"car-2")
    assert not read.is_genuine(Ed25519PublicKey.from_public_bytes(other.public_key), b"car-1")
