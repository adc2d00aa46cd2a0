"""What the seals of a recording prove, and each way in which somebody may have changed it."""

import os
import random
import signal
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from shared.bus.bus import Envelope
from shared.evidence import KeyFile, KeyRing, Outcome, Signer
from shared.evidence.statement import signed
from shared.messages.operation import Origin, OriginKind
from shared.recording import Recording, RecordingWriter
from shared.recording.folder import RecordingFolder
from shared.recording.index import RecordingIndex
from shared.recording.proof import Proof, prove
from shared.recording.reader import records
from shared.recording.seals import KIND, SEAL, Seal, Sealer
from tests.support.bus.envelopes import sent
from tests.support.patience import HANGS_S
from tests.support.rewritten import MAGIC, rewrite
from tests.unit.shared.recording.test_recording import START_NS, FullDisk, envelopes

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def key(tmp_path_factory: pytest.TempPathFactory) -> KeyFile:
    return KeyFile(tmp_path_factory.mktemp("keys"))


def drive(count: int, *, kind: OriginKind = OriginKind.SIMULATED, seed: int = 1) -> list[Envelope]:
    origin = sent(Origin(now_ns=START_NS, kind=kind, name="urban", speed=1.0), START_NS, "sensors.simulator", 1, 1)
    return [origin, *envelopes(count, seed=seed)]


def record(path: Path, messages: list[Envelope], signer: Signer, *, close: bool = True, vehicle: str = "car") -> Path:
    sealer = Sealer(signer, vehicle=vehicle, started_ns=START_NS)
    writer = RecordingWriter(path, vehicle=vehicle, vehicle_toml="[vehicle]\n", sealer=sealer)
    for number, envelope in enumerate(messages, 1):
        writer.write(envelope)
        if number % 50 == 0:
            writer.flush()
    if close:
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    return path


@pytest.fixture(scope="module")
def signed_file(key: KeyFile, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """25 s of messages: a front, two seals on the way, and the end."""
    return record(tmp_path_factory.mktemp("drive") / "a.mcap", drive(2500), key.signer())


def check(path: Path, ring: KeyRing) -> Proof:
    with Recording(path) as recording:
        return prove(recording, ring)


def check_bytes(data: bytes, folder: Path, key: KeyFile) -> Proof:
    path = folder / "changed.mcap"
    path.write_bytes(data)
    return check(path, key.ring)


def parts(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, begin and end of each record of the data section."""
    found, position = [], len(MAGIC)
    while True:
        opcode, length = struct.unpack_from("<BQ", data, position)
        found.append((opcode, position, position + 9 + length))
        position += 9 + length
        if opcode == Opcode.DATA_END:
            return found


def test_a_recording_is_verified_and_says_whose_it_is(signed_file: Path, key: KeyFile) -> None:
    proof = check(signed_file, key.ring)
    assert proof.outcome is Outcome.VERIFIED
    assert proof.proven is not None and proof.first is not None
    assert (proof.proven.vehicle, proof.proven.origin, proof.proven.number) == ("car", "simulated", 3)
    assert proof.proven.messages == 2501 and proof.proven.last
    assert proof.first.started_ns == START_NS and proof.first.origin == "unknown"


def test_a_signed_recording_is_an_ordinary_one(signed_file: Path) -> None:
    messages = drive(2500)
    with Recording(signed_file) as recording:
        assert list(recording) == messages
        assert recording.problems == []
        index = RecordingIndex(recording)
        assert list(index.between(0, START_NS * 2)) == messages
        assert recording.topics == {envelope.topic for envelope in messages}
    with signed_file.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == 2501
        assert [metadata.name for metadata in reader.iter_metadata()] == ["obu", *[SEAL] * 4]


def test_a_seal_is_written_every_ten_seconds(signed_file: Path) -> None:
    with signed_file.open("rb") as file:
        seals = [Seal.of(metadata.metadata) for metadata in make_reader(file).iter_metadata() if metadata.name == SEAL]
    assert all(seal is not None for seal in seals)
    until = [(seal.until_ns - START_NS) / 1e9 for seal in seals if seal]
    assert until == [0.0, 10.0, 20.0, 24.99]


@pytest.mark.parametrize("step", [11, pytest.param(1, marks=pytest.mark.slow)])
def test_every_changed_byte_of_a_short_recording_is_named(tmp_path: Path, key: KeyFile, step: int) -> None:
    data = record(tmp_path / "a.mcap", drive(4), key.signer()).read_bytes()
    outcomes: dict[int, Outcome] = {}
    for place in range(0, len(data), step):
        changed = bytearray(data)
        changed[place] ^= 1 << place % 8
        outcomes[place] = check_bytes(bytes(changed), tmp_path, key).outcome
    # The last eight bytes say that the file was closed.
    assert {place for place, outcome in outcomes.items() if outcome is Outcome.CUT} <= set(
        range(len(data) - len(MAGIC), len(data))
    )
    assert set(outcomes.values()) <= {Outcome.EDITED, Outcome.CUT}


@settings(max_examples=150, deadline=None)
@given(place=st.floats(0.0, 1.0, exclude_max=True), value=st.integers(1, 255))
def test_a_changed_byte_of_a_long_recording_is_named(
    signed_file: Path, key: KeyFile, tmp_path_factory: pytest.TempPathFactory, place: float, value: int
) -> None:
    data = bytearray(signed_file.read_bytes())
    data[int(place * len(data))] ^= value
    outcome = check_bytes(bytes(data), tmp_path_factory.getbasetemp(), key).outcome
    assert outcome in (Outcome.EDITED, Outcome.CUT)


def test_an_edit_is_located_between_two_seals(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    data = bytearray(signed_file.read_bytes())
    chunks = [(begin, end) for opcode, begin, end in parts(bytes(data)) if opcode == Opcode.CHUNK]
    begin, end = chunks[len(chunks) // 2]
    data[(begin + end) // 2] ^= 1
    proof = check_bytes(bytes(data), tmp_path, key)
    assert proof.outcome is Outcome.EDITED
    assert "between 2026-09-21 14:13:30 UTC and 2026-09-21 14:13:40 UTC" in proof.sentences[0]
    assert f"the bytes {begin} to " in proof.sentences[0]
    assert len(proof.sentences) == 2 and proof.sentences[1] == "proven until 2026-09-21 14:13:30 UTC only"


@pytest.mark.parametrize("cut", [0.05, 0.3, 0.5, 0.75, 0.97])
def test_a_cut_recording_is_proven_until_its_last_seal(
    signed_file: Path, key: KeyFile, tmp_path: Path, cut: float
) -> None:
    data = signed_file.read_bytes()
    length = int(cut * len(data))
    proof = check_bytes(data[:length], tmp_path, key)
    assert proof.outcome is Outcome.CUT
    ends = [end for _, _, end in seals_of(data) if end <= length]
    assert proof.proven is not None and proof.proven.number == len(ends) - 1


def seals_of(data: bytes) -> list[tuple[int, int, int]]:
    name = SEAL.encode()
    return [part for part in parts(data) if data[part[1] + 13 : part[1] + 13 + len(name)] == name]


def test_a_cut_of_the_index_leaves_all_messages_proven(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    proof = check_bytes(signed_file.read_bytes()[:-100], tmp_path, key)
    assert proof.outcome is Outcome.CUT and "all messages are proven" in proof.text


def test_the_tail_cut_and_closed_again_is_edited(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    """The last ten seconds are removed, and a whole index written behind the rest."""
    data = signed_file.read_bytes()
    *_, end = seals_of(data)
    footer = struct.pack("<BQQQ", 2, 20, 0, 0)
    closing = struct.pack("<BQI", Opcode.DATA_END, 4, 0) + footer + struct.pack("<I", zlib.crc32(footer)) + MAGIC
    proof = check_bytes(data[: end[1]] + closing, tmp_path, key)
    assert proof.outcome is Outcome.EDITED and "without its last seal" in proof.text


def test_a_removed_chunk_is_named(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    data = signed_file.read_bytes()
    chunks = [part for part in parts(data) if part[0] in (Opcode.CHUNK, Opcode.MESSAGE_INDEX)]
    begins = [place for place, part in enumerate(chunks) if part[0] == Opcode.CHUNK]
    first, following = chunks[begins[5]][1], chunks[begins[6]][1]
    proof = check_bytes(data[:first] + data[following:], tmp_path, key)
    assert proof.outcome is Outcome.EDITED and "some were removed or added" in proof.text


def test_removed_ten_seconds_with_their_seal_are_named(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    data = signed_file.read_bytes()
    found = seals_of(data)
    proof = check_bytes(data[: found[1][2]] + data[found[2][2] :], tmp_path, key)
    assert proof.outcome is Outcome.EDITED
    assert "removed: what was recorded from 2026-09-21 14:13:30 UTC to 2026-09-21 14:13:44 UTC" in proof.text


def test_parts_of_two_recordings_of_one_key_do_not_make_one(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    data = signed_file.read_bytes()
    other = record(tmp_path / "b.mcap", drive(2500, seed=2), key.signer()).read_bytes()
    here = seals_of(data)
    there = seals_of(other)
    proof = check_bytes(data[: here[1][2]] + other[there[1][2] :], tmp_path, key)
    assert proof.outcome is Outcome.EDITED and "a part of another recording" in proof.text


def test_bytes_added_behind_the_end_are_named(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    data = signed_file.read_bytes()
    found = seals_of(data)
    chunk = next(part for part in parts(data) if part[0] == Opcode.CHUNK)
    end = found[-1][2]
    added = data[:end] + data[chunk[1] : chunk[2]]
    assert check_bytes(added, tmp_path, key).outcome is Outcome.EDITED
    assert check_bytes(added + data[end:], tmp_path, key).outcome is Outcome.EDITED
    assert check_bytes(data + b"x", tmp_path, key).outcome is not Outcome.VERIFIED


def resigned(path: Path, to: Path, change: Callable[[Envelope], Envelope], signer: Signer | None) -> Path:
    """Write a recording anew with other messages, with seals of a key that somebody has at hand, or without."""
    sealer = Sealer(signer, vehicle="car", started_ns=START_NS) if signer else None
    writer = RecordingWriter(to, vehicle="car", vehicle_toml="[vehicle]\n", sealer=sealer)
    with Recording(path) as recording:
        for envelope in recording:
            writer.write(change(envelope))
    writer.close()
    return to


def as_live(envelope: Envelope) -> Envelope:
    return envelope._replace(payload=envelope.payload.replace(b'"simulated"', b'"live"'))


def test_a_simulated_drive_that_is_made_live_is_not_verified(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    """Whoever writes it anew has no key of the unit: it is of an unknown key, or unsigned."""
    foreign = KeyFile(tmp_path / "keys").signer()
    forged = resigned(signed_file, tmp_path / "b.mcap", as_live, foreign)
    proof = check(forged, key.ring)
    assert proof.outcome is Outcome.FOREIGN and foreign.key_id in proof.text
    assert check(resigned(signed_file, tmp_path / "c.mcap", as_live, None), key.ring).outcome is Outcome.UNSIGNED


def test_a_message_replaced_and_hashed_anew_under_the_old_seals_is_edited(
    signed_file: Path, key: KeyFile, tmp_path: Path
) -> None:
    """All digests are computed anew; the signatures remain those of the unit."""
    foreign = KeyFile(tmp_path / "keys").signer()
    forged = resigned(signed_file, tmp_path / "b.mcap", as_live, foreign).read_bytes()
    with signed_file.open("rb") as file:
        old = [metadata.metadata for metadata in make_reader(file).iter_metadata() if metadata.name == SEAL]
    with (tmp_path / "b.mcap").open("rb") as file:
        new = [metadata.metadata for metadata in make_reader(file).iter_metadata() if metadata.name == SEAL]
    for before, after in zip(old, new, strict=True):
        for name in ("signature", "key", "public_key"):
            forged = forged.replace(after[name].encode(), before[name].encode())
    assert check_bytes(forged, tmp_path, key).outcome is Outcome.EDITED


def test_the_origin_in_a_seal_cannot_be_changed(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    data = signed_file.read_bytes()
    assert data.count(b"simulated") >= 3
    changed = data.replace(b"simulated", b"live real")
    proof = check_bytes(changed, tmp_path, key)
    assert proof.outcome is Outcome.EDITED and "its signature does not fit it" in proof.text


@pytest.mark.parametrize("name", ["vehicle", "library"])
def test_the_front_cannot_be_changed(signed_file: Path, key: KeyFile, tmp_path: Path, name: str) -> None:
    data = signed_file.read_bytes()
    if name == "vehicle":
        changed = data.replace(b"[vehicle]\n", b"[Vehicle]\n", 1)
    else:
        changed = data.replace(b"\x03\x00\x00\x00obu", b"\x03\x00\x00\x00abc", 1).replace(
            b"[vehicle]\n", b"[Vehicle]\n"
        )
    assert changed != data
    assert check_bytes(changed, tmp_path, key).outcome is Outcome.EDITED


def with_index(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """Change the index alone, with a checksum that holds."""
    end = len(data) - len(MAGIC) - 29
    _, _, start, offsets, _ = struct.unpack("<BQQQI", data[end : end + 29])
    index = change(data[start:end])
    footer = struct.pack("<BQQQ", 2, 20, start, offsets)
    return data[:start] + index + footer + struct.pack("<I", zlib.crc32(index + footer)) + MAGIC


def swapped_chunks(index: bytes) -> bytes:
    """Let one entry lead to the chunk of another."""
    found = [(opcode, content) for opcode, content in records(index)]
    places = [place for place, (opcode, _) in enumerate(found) if opcode == Opcode.CHUNK_INDEX]
    one, other = places[1], places[-1]
    a, b = found[one][1], found[other][1]
    found[one] = Opcode.CHUNK_INDEX, a[:16] + b[16:24] + a[24:]
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in found)


def without_a_chunk(index: bytes) -> bytes:
    found = [(opcode, content) for opcode, content in records(index)]
    place = next(place for place, (opcode, _) in enumerate(found) if opcode == Opcode.CHUNK_INDEX)
    del found[place]
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in found)


def other_topics(index: bytes) -> bytes:
    return index.replace(b"navigation/solution", b"navigation/Solution")


def other_count(index: bytes) -> bytes:
    found = [(opcode, content) for opcode, content in records(index)]
    return b"".join(
        struct.pack("<BQ", opcode, len(content))
        + (struct.pack("<Q", 7) + content[8:] if opcode == Opcode.STATISTICS else content)
        for opcode, content in found
    )


@pytest.mark.parametrize("change", [swapped_chunks, without_a_chunk, other_topics, other_count])
def test_an_index_that_leads_elsewhere_is_named(
    signed_file: Path, key: KeyFile, tmp_path: Path, change: Callable[[bytes], bytes]
) -> None:
    data = signed_file.read_bytes()
    assert with_index(data, lambda index: index) == data
    proof = check_bytes(with_index(data, change), tmp_path, key)
    assert proof.outcome is Outcome.EDITED and "index" in proof.text


def test_another_vehicles_recording_is_of_an_unknown_key_until_its_key_is_accepted(
    key: KeyFile, tmp_path: Path
) -> None:
    other = KeyFile(tmp_path / "keys")
    path = record(tmp_path / "a.mcap", drive(50), other.signer(), vehicle="van")
    assert check(path, key.ring).outcome is Outcome.FOREIGN
    (tmp_path / "van.pub").write_text(other.ring.keys[0].pem())
    assert check(path, KeyRing.of_files([tmp_path / "van.pub"])).outcome is Outcome.VERIFIED


def test_a_recording_of_a_former_key_stays_verified(tmp_path: Path) -> None:
    key = KeyFile(tmp_path / "keys")
    path = record(tmp_path / "a.mcap", drive(50), key.signer())
    key.rotate(START_NS + 60_000_000_000)
    assert check(path, key.ring).outcome is Outcome.VERIFIED


def test_a_former_key_signs_nothing_new(tmp_path: Path) -> None:
    key = KeyFile(tmp_path / "keys")
    stolen = key.signer()
    key.rotate(START_NS - 2 * 86_400_000_000_000)
    proof = check(record(tmp_path / "a.mcap", drive(50), stolen), key.ring)
    assert proof.outcome is Outcome.FOREIGN and "was replaced" in proof.text


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_recording_that_another_tool_packed_anew_is_rewritten_and_its_messages_proven(
    signed_file: Path, key: KeyFile, tmp_path: Path, compression: CompressionType
) -> None:
    rewrite(signed_file, tmp_path / "b.mcap", compression)
    proof = check(tmp_path / "b.mcap", key.ring)
    assert proof.outcome is Outcome.REWRITTEN
    assert "the 2501 messages until" in proof.text and "mcap" in proof.text
    assert check(tmp_path / "b.mcap", KeyRing()).outcome is Outcome.FOREIGN


def repacked(path: Path, to: Path, change: Callable[[int, bytes], bytes | None]) -> Path:
    """Write a recording anew with another library; a message that `change` makes None is left out."""
    with path.open("rb") as source, to.open("wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start(library="another tool")
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        for file in reader.iter_attachments():
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        numbers: dict[int, int] = {}
        for count, (_, channel, message) in enumerate(reader.iter_messages(log_time_order=False)):
            if channel.id not in numbers:
                numbers[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, 0)
            if (payload := change(count, message.data)) is not None:
                writer.add_message(numbers[channel.id], message.log_time, payload, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return to


def test_a_recording_packed_anew_with_other_messages_is_edited(signed_file: Path, key: KeyFile, tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    assert check(repacked(signed_file, path, lambda _, data: data), key.ring).outcome is Outcome.REWRITTEN
    proof = check(repacked(signed_file, path, lambda n, data: None if n == 1500 else data), key.ring)
    assert proof.outcome is Outcome.EDITED and "messages between 2026-09-21 14:13:30 UTC" in proof.text
    changed = check(repacked(signed_file, path, lambda n, data: data + b" " if n == 2400 else data), key.ring)
    assert changed.outcome is Outcome.EDITED and "2026-09-21 14:13:40 UTC and" in changed.text


def redescribed(path: Path, to: Path, **changes: Any) -> Path:
    """Write a recording anew with other descriptions: `schema`, `channel` change one, `twice` adds one of a topic."""
    with path.open("rb") as source, to.open("wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start(library="another tool")
        for _ in range(changes.get("unused", 0)):  # other numbers than those of the unit
            writer.register_schema("unused", "jsonschema", b"{}")
        for one in reader.iter_metadata():
            writer.add_metadata(one.name, one.metadata)
        for file in reader.iter_attachments():
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        numbers: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.id not in numbers:
                name, encoding, data = changes.get("schema", lambda *one: one)(
                    schema.name, schema.encoding, schema.data
                )
                topic, metadata = channel.topic, changes.get("metadata", channel.metadata)
                made = writer.register_schema(name, encoding, data)
                numbers[channel.id] = writer.register_channel(topic, channel.message_encoding, made, metadata)
            writer.add_message(numbers[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return to


@pytest.mark.parametrize(
    ("changes", "outcome", "said"),
    [
        ({}, Outcome.REWRITTEN, "are those that were signed; verify the original"),
        ({"unused": 3}, Outcome.REWRITTEN, "are those that were signed; verify the original"),
        ({"schema": lambda n, e, d: (n, e, d + b" ")}, Outcome.EDITED, "schemas or channels are not those"),
        ({"schema": lambda n, e, d: (n, e, d.replace(b"_m_s", b"_km_h"))}, Outcome.EDITED, "are not those"),
        ({"schema": lambda n, e, d: (f"other.{n}", e, d)}, Outcome.EDITED, "schemas or channels are not those"),
        ({"schema": lambda n, e, d: (n, "protobuf", d)}, Outcome.EDITED, "schemas or channels are not those"),
        ({"metadata": {"data": "base64 of something else"}}, Outcome.EDITED, "schemas or channels are not those"),
    ],
)
def test_a_recording_packed_anew_with_other_schemas_is_edited(
    changes: dict[str, Any], outcome: Outcome, said: str, signed_file: Path, key: KeyFile, tmp_path: Path
) -> None:
    proof = check(redescribed(signed_file, tmp_path / "b.mcap", **changes), key.ring)
    assert proof.outcome is outcome and said in proof.text


def test_a_recording_without_seals_is_unsigned(tmp_path: Path, key: KeyFile) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap", vehicle="car")
    for envelope in drive(20):
        writer.write(envelope)
    writer.close()
    assert check(tmp_path / "a.mcap", key.ring).outcome is Outcome.UNSIGNED


def test_a_copy_of_our_own_tools_says_what_it_is(tmp_path: Path, key: KeyFile) -> None:
    RecordingWriter(tmp_path / "a.mcap", copied_by="`obu record repair`").close()
    proof = check(tmp_path / "a.mcap", key.ring)
    assert proof.outcome is Outcome.REWRITTEN and "obu record repair" in proof.text


def test_a_full_disk_while_sealing_leaves_a_cut_recording(tmp_path: Path, key: KeyFile) -> None:
    """The room ends in each of the writes of 25 s, also within a seal; what is on the disk is proven up to a seal."""
    whole = record(tmp_path / "whole.mcap", drive(2500), key.signer())
    data = whole.read_bytes()
    found = seals_of(data)
    rooms = [end - 10 for _, _, end in found[1:]] + random.Random(1).sample(range(5000, len(data)), 12)
    for number, room in enumerate(rooms):
        path = tmp_path / f"{number}.mcap"
        disk: list[FullDisk] = []

        def opened(at: Path, room: int = room, disk: list[FullDisk] = disk) -> FullDisk:
            disk.append(FullDisk(at, room))
            return disk[0]

        sealer = Sealer(key.signer(), vehicle="car", started_ns=START_NS)
        writer = RecordingWriter(path, vehicle="car", vehicle_toml="[vehicle]\n", sealer=sealer, opener=opened)
        with pytest.raises(OSError, match="No space"):
            for count, envelope in enumerate(drive(2500), 1):
                writer.write(envelope)
                if count % 50 == 0:
                    writer.flush()
            writer.close()
        writer.abandon()
        proof = check(path, key.ring)
        assert proof.outcome is Outcome.CUT, (room, proof.text)


def test_room_that_comes_back_gives_a_whole_recording(tmp_path: Path, key: KeyFile) -> None:
    """A write that failed is tried again: the chain is that of the bytes in the file."""
    disk: list[FullDisk] = []

    def opened(path: Path) -> FullDisk:
        disk.append(FullDisk(path, 60_000))
        return disk[0]

    sealer = Sealer(key.signer(), vehicle="car", started_ns=START_NS)
    writer = RecordingWriter(tmp_path / "a.mcap", vehicle="car", sealer=sealer, opener=opened)
    failures = 0
    for envelope in drive(2500):
        try:
            writer.write(envelope)
        except OSError:
            failures += 1
            disk[0].room = 10_000_000
    writer.close()
    assert failures == 1
    assert check(tmp_path / "a.mcap", key.ring).outcome is Outcome.VERIFIED


def test_a_recorder_that_is_killed_leaves_a_recording_that_is_proven_until_its_last_seal(
    tmp_path: Path, key: KeyFile
) -> None:
    """SIGKILL comes after the second seal, in the middle of the following ten seconds."""
    script = (
        "import sys\n"
        "from pathlib import Path\n"
        "from shared.evidence import KeyFile\n"
        "from shared.recording import RecordingWriter\n"
        "from shared.recording.seals import Sealer\n"
        "from tests.unit.shared.recording.test_proof import START_NS, drive\n"
        "signer = KeyFile(Path(sys.argv[2])).signer()\n"
        "writer = RecordingWriter(Path(sys.argv[1]), vehicle='car',\n"
        "                         sealer=Sealer(signer, vehicle='car', started_ns=START_NS))\n"
        "for count, envelope in enumerate(drive(1600), 1):\n"
        "    writer.write(envelope)\n"
        "    if count % 50 == 0:\n"
        "        writer.flush()\n"
        "print('written', flush=True)\n"
        "sys.stdin.read()\n"
    )
    path = tmp_path / "a.mcap"
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(path), str(key.folder)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == b"written\n"
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=HANGS_S)
    proof = check(path, key.ring)
    assert proof.outcome is Outcome.CUT
    assert "proven until 2026-09-21 14:13:30 UTC, then cut" in proof.text
    assert "bytes behind its last seal are not proven" in proof.text


def test_successive_files_of_a_recorder_name_each_other(tmp_path: Path, key: KeyFile) -> None:
    folder = RecordingFolder(tmp_path / "drives", signer=key.signer)
    folder.stored()
    for number in range(3):
        folder.open(f"{number}", vehicle="car", vehicle_toml="", chunk_bytes=4096, now_ns=START_NS)
        folder.write(drive(50))
        folder.close()
    proofs = [check(tmp_path / "drives" / f"{number}.mcap", key.ring) for number in range(3)]
    assert [proof.outcome for proof in proofs] == [Outcome.VERIFIED] * 3
    first, second, third = (proof.first for proof in proofs)
    assert first is not None and second is not None and third is not None
    assert first.previous == ""
    assert (second.previous, third.previous) == (proofs[0].digest, proofs[1].digest)


def test_a_recorder_without_a_usable_key_records_and_says_why(tmp_path: Path) -> None:
    (tmp_path / "keys").write_text("a file where the folder should be")
    folder = RecordingFolder(tmp_path / "drives", signer=KeyFile(tmp_path / "keys").signer)
    folder.stored()
    folder.open("a", vehicle="car", vehicle_toml="", chunk_bytes=4096)
    folder.write(drive(50))
    folder.close()
    assert folder.unsigned is not None and "cannot use the key" in folder.unsigned
    assert check(tmp_path / "drives" / "a.mcap", KeyRing()).outcome is Outcome.UNSIGNED


@pytest.mark.parametrize(
    ("field", "value"),
    [("chain", "no digest"), ("chain", "ff " * 3), ("previous", "zz"), ("number", "9" * 5000), ("messages", "-1"),
     ("until_ns", "9" * 40), ("vehicle", "\x1b[2J"), ("recording", "")],
)  # fmt: skip
def test_a_seal_that_somebody_has_made_up_is_no_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, field: str, value: str
) -> None:
    """Anybody can sign any fields with a key of their own."""
    key = KeyFile(tmp_path / "keys")
    original = Sealer.seal

    def seal(self: Sealer, *, last: bool = False) -> dict[str, str]:
        return signed(KIND, {**original(self, last=last), field: value}, key.signer())

    monkeypatch.setattr(Sealer, "seal", seal)
    proof = check(record(tmp_path / "a.mcap", drive(1100), key.signer()), KeyRing())
    assert proof.outcome in (Outcome.EDITED, Outcome.FOREIGN)
    assert proof.text.isprintable()


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_an_index_of_any_bytes_with_a_checksum_that_holds_is_named(
    signed_file: Path, key: KeyFile, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Who edits the index computes its checksum anew."""
    whole = signed_file.read_bytes()

    def change(index: bytes) -> bytes:
        changed = bytearray(index)
        for _ in range(data.draw(st.integers(1, 4))):
            changed[data.draw(st.integers(0, len(index) - 1))] ^= data.draw(st.integers(1, 255))
        return bytes(changed)

    changed = with_index(whole, change)
    if changed != whole:
        assert check_bytes(changed, tmp_path_factory.getbasetemp(), key).outcome is Outcome.EDITED
