"""The key of a unit: made at first use, replaced with its public key kept, and refused where it is damaged."""

import os
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

from shared.evidence import EvidenceError, KeyFile, KeyRing, Signer
from shared.evidence.signer import is_signature
from shared.evidence.statement import canonical, is_genuine, signed

DAY_NS = 86_400_000_000_000


def test_a_key_is_made_at_first_use_and_readable_by_its_owner_only(tmp_path: Path) -> None:
    key = KeyFile(tmp_path / "keys")
    signer: Signer = key.signer()
    assert stat.S_IMODE(key.path.stat().st_mode) == 0o400
    assert stat.S_IMODE(key.folder.stat().st_mode) == 0o700
    assert KeyFile(tmp_path / "keys").signer().key_id == signer.key_id
    assert [public_key.key_id for public_key in key.ring.keys] == [signer.key_id]
    assert sorted(path.name for path in key.folder.iterdir()) == ["evidence.key", "ring.json"]


def test_processes_that_start_together_get_one_key(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        ids = set(pool.map(lambda _: KeyFile(tmp_path / "keys").signer().key_id, range(16)))
    assert len(ids) == 1


def test_other_programs_read_the_key_files(tmp_path: Path) -> None:
    """The PEM of both keys is written by hand: the library that the files are for must agree."""
    key = KeyFile(tmp_path)
    signer = key.signer()
    private = load_pem_private_key(key.path.read_bytes(), None)
    public = load_pem_public_key(key.ring.keys[0].pem().encode())
    signature = private.sign(b"drive")  # type: ignore[union-attr, call-arg]
    assert signature == signer.sign(b"drive")
    public.verify(signature, b"drive")  # type: ignore[union-attr, call-arg]


def test_a_signature_is_of_one_key_and_one_text(tmp_path: Path) -> None:
    one, other = KeyFile(tmp_path / "a").signer(), KeyFile(tmp_path / "b").signer()
    signature = one.sign(b"text")
    assert is_signature(one.public_key, signature, b"text")
    assert not is_signature(one.public_key, signature, b"texu")
    assert not is_signature(other.public_key, signature, b"text")
    assert not is_signature(one.public_key, b"short", b"text")
    assert not is_signature(b"short", signature, b"text")


def test_a_rotated_key_stays_in_the_ring_and_ends_a_day_later(tmp_path: Path) -> None:
    key = KeyFile(tmp_path)
    old = key.signer()
    new = key.rotate(10 * DAY_NS)
    assert key.signer().key_id == new.key_id != old.key_id
    assert [public_key.key_id for public_key in key.ring.keys] == [old.key_id, new.key_id]
    assert key.ring.accepts(old.key_id, old.public_key.hex(), 11 * DAY_NS)
    assert not key.ring.accepts(old.key_id, old.public_key.hex(), 11 * DAY_NS + 1)
    assert key.ring.accepts(new.key_id, new.public_key.hex(), 99 * DAY_NS)
    assert not key.ring.accepts(old.key_id, new.public_key.hex(), 0)


def test_a_running_process_uses_the_new_key_after_a_rotation(tmp_path: Path) -> None:
    running = KeyFile(tmp_path)
    before = running.signer().key_id
    after = KeyFile(tmp_path).rotate(DAY_NS).key_id
    assert running.signer().key_id == after != before


@pytest.mark.parametrize("text", ["", "no key", "-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n"])
def test_a_damaged_key_is_not_replaced_in_silence(tmp_path: Path, text: str) -> None:
    (tmp_path / "evidence.key").write_text(text)
    with pytest.raises(EvidenceError, match="obu evidence-key rotate"):
        KeyFile(tmp_path).signer()
    assert (tmp_path / "evidence.key").read_text() == text


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"keys": [{"key": "00", "public_key": "00"}]}'])
def test_a_damaged_ring_is_one_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "ring.json").write_text(text)
    with pytest.raises(EvidenceError, match="--key"):
        _ = KeyFile(tmp_path).ring


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EvidenceError, match="cannot use the key"):
        KeyFile(tmp_path / "file" / "keys").signer()


def test_public_keys_are_read_of_pem_and_of_rings(tmp_path: Path) -> None:
    keys = [KeyFile(tmp_path / name) for name in ("a", "b", "c")]
    ids = [key.signer().key_id for key in keys]
    (tmp_path / "two.pub").write_text("# comment\n" + keys[0].ring.keys[0].pem() + keys[1].ring.keys[0].pem())
    ring = KeyRing.of_files([tmp_path / "two.pub", tmp_path / "c" / "ring.json"])
    assert [key.key_id for key in ring.keys] == ids
    with pytest.raises(ValueError, match="no Ed25519 public key"):
        KeyRing.of_files([keys[0].path])


def test_a_statement_is_genuine_until_anything_of_it_changes(tmp_path: Path) -> None:
    fields = signed("test", {"b": "2", "a": "1"}, KeyFile(tmp_path / "a").signer())
    assert is_genuine("test", fields)
    assert not is_genuine("other", fields)
    for name in fields:
        assert not is_genuine("test", {**fields, name: fields[name] + "0"})
        assert not is_genuine("test", {k: v for k, v in fields.items() if k != name})
    assert not is_genuine("test", {**fields, "signature": fields["signature"].upper()})
    other = KeyFile(tmp_path / "b").signer()
    assert not is_genuine("test", {**fields, "public_key": other.public_key.hex()})
    assert canonical("test", {"a": "1", "b": "2"}) == canonical("test", {"b": "2", "a": "1", "signature": "x"})


def test_a_process_that_signs_nothing_does_not_load_the_library() -> None:
    text = (
        "import sys, shared.recording, shared.recording.folder, services.monitoring.recorder.process;"
        "sys.exit(any(name.startswith('cryptography') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", text], env=dict(os.environ), check=False).returncode == 0
