import random
import struct
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from shared import VERSION
from shared.bus import codec
from shared.bus.bus import Envelope
from shared.errors import BadRecording
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw
from shared.messages.operation import Mode, ModeState
from shared.recording import Recording, RecordingWriter
from shared.recording.index import chosen
from shared.recording.writer import without_users
from tests.support.bus.envelopes import sent, sent_bytes
from tests.support.rewritten import chunk, file_of, rewrite

START_NS = 1_790_000_000_000_000_000


def envelopes(count: int, *, seed: int = 1) -> list[Envelope]:
    rng = random.Random(seed)
    made = []
    for k in range(count):
        stamp = START_NS + k * 10_000_000
        if k % 3 == 0:
            raw = ImuRaw(received_ns=stamp - 1000, source="imu0", data=rng.randbytes(60))
            made.append(sent(raw, stamp, "sensors.imu", START_NS, k + 1))
        else:
            body = b'{"sampled_ns":%d,"yaw_rad":%f}' % (stamp, rng.random())
            made.append(sent_bytes("navigation/solution", body, stamp, "core.fusion", START_NS + 7, k + 1))
    return made


def record(path: Path, messages: list[Envelope], *, every: int = 25, close: bool = True) -> bytes:
    writer = RecordingWriter(path, vehicle="car", vehicle_toml='[vehicle]\nname = "car"\n')
    for k, envelope in enumerate(messages, 1):
        writer.write(envelope)
        if k % every == 0:
            writer.flush()
    if close:
        writer.close()
    else:
        writer.abandon()
    return path.read_bytes()


def read(path: Path) -> tuple[list[Envelope], list[str]]:
    with Recording(path) as recording:
        return list(recording), recording.problems


def chunk_ends(data: bytes, path: Path) -> list[int]:
    path.write_bytes(data)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]


def test_all_envelopes_are_read_equal_and_in_order(tmp_path: Path) -> None:
    messages = envelopes(200)
    record(tmp_path / "a.mcap", messages)

    assert read(tmp_path / "a.mcap") == (messages, [])


def test_a_recording_of_version_0_1_opens_with_its_senders_and_devices(tmp_path: Path) -> None:
    """Version 0.1 had the sender, and the device and stamp of raw bytes, in the channel."""
    state = ModeState(sampled_ns=START_NS, mode=Mode.BOOT, since_ns=0, reason="test")
    raw = GnssRaw(received_ns=START_NS - 5, source="gnss0", data=b"\xb5\x62")
    with (tmp_path / "old.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("", "obu")
        for topic, encoding, metadata, data, published_ns in (
            ("mode/state", "json", {"from": "controller.mode", "life": "7"}, codec.encode(state), START_NS),
            ("gnss/raw", "application/octet-stream", {"from": "sensors.gnss", "life": "7", "source": "gnss0"}, raw.data,
             raw.received_ns),
            ("irregular", "application/octet-stream", {}, b'{"topic":"mode/state"}\n{}', START_NS),
        ):  # fmt: skip
            channel = writer.register_channel(topic, encoding, 0, metadata)
            writer.add_message(channel, START_NS, data, published_ns, sequence=9)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates it by half

    expected = [sent(state, START_NS, "controller.mode", 7, 9), sent(raw, START_NS, "sensors.gnss", 7, 9)]
    found, problems = read(tmp_path / "old.mcap")
    assert found == expected
    assert len(problems) == 1


def test_a_full_chunk_is_written_without_a_flush(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap", chunk_bytes=4096)
    for envelope in envelopes(200):
        writer.write(envelope)
    writer.abandon()

    assert writer.messages > 150
    assert len(read(tmp_path / "a.mcap")[0]) == writer.messages


def test_the_plain_mcap_reader_opens_a_closed_file(tmp_path: Path) -> None:
    messages = envelopes(200)
    record(tmp_path / "a.mcap", messages)

    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        plain = [
            (channel.topic, message.data, message.log_time, schema and schema.name)
            for schema, channel, message in reader.iter_messages()
        ]
        summary = reader.get_summary()
        attachments = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        metadata = {entry.name: entry.metadata for entry in reader.iter_metadata()}
    names = {"imu/raw": "ImuRaw", "navigation/solution": "NavigationSolution"}
    assert plain == [(m.topic, m.payload, m.received_ns, names[m.topic]) for m in messages]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 200
    assert summary.statistics.message_start_time == messages[0].received_ns
    assert summary.statistics.message_end_time == messages[-1].received_ns
    assert attachments == {"vehicle.toml": b'[vehicle]\nname = "car"\n'}
    assert metadata == {"obu": {"vehicle": "car", "version": VERSION}}


def test_the_message_index_points_at_its_messages(tmp_path: Path) -> None:
    data = record(tmp_path / "a.mcap", envelopes(20), every=10)
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for index in summary.chunk_indexes:
        assert len(index.message_index_offsets) == 2
        for channel, offset in index.message_index_offsets.items():
            assert struct.unpack_from("<BQH", data, offset)[::2] == (7, channel)


def test_a_cut_at_any_byte_gives_a_prefix_that_holds_every_whole_chunk(tmp_path: Path) -> None:
    messages = envelopes(60)
    data = record(tmp_path / "whole.mcap", messages, every=20)
    ends = chunk_ends(data, tmp_path / "whole.mcap")
    cut = tmp_path / "cut.mcap"
    for length in sorted({*range(0, len(data), 7), *(end + k for end in ends for k in range(-9, 10))}):
        cut.write_bytes(data[:length])
        found, problems = read(cut)

        assert found == messages[: len(found)]
        assert len(found) >= 20 * sum(length >= end for end in ends)
        assert problems


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 1.0), st.integers(1, 400))
def test_a_cut_of_a_larger_file_gives_a_prefix(
    tmp_path_factory: pytest.TempPathFactory, part: float, every: int
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    messages = envelopes(800)
    data = record(folder / "whole.mcap", messages, every=every)
    (folder / "cut.mcap").write_bytes(data[: int(part * len(data))])

    found, _ = read(folder / "cut.mcap")

    assert found == messages[: len(found)]


def test_a_cut_inside_a_large_chunk_still_gives_its_first_blocks(tmp_path: Path) -> None:
    noise = [GnssRaw(received_ns=1, source="g", data=random.Random(k).randbytes(1000)) for k in range(200)]
    messages = [sent(raw, START_NS + k, "sensors.gnss", 1, k) for k, raw in enumerate(noise)]
    writer = RecordingWriter(tmp_path / "a.mcap", chunk_bytes=1 << 20)
    for envelope in messages:
        writer.write(envelope)
    writer.flush()
    writer.abandon()
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(data[:-30_000])

    found, problems = read(tmp_path / "a.mcap")

    assert 80 < len(found) < 200
    assert found == messages[: len(found)]
    assert problems == [f"the recording was not closed: it ends at byte {len(data) - 30_000}"]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 500), st.integers(0, 1000))
def test_invalid_bytes_in_the_middle_lose_only_the_chunks_that_they_overwrite(
    tmp_path_factory: pytest.TempPathFactory, where: int, length: int, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("garbage")
    messages = envelopes(200)
    data = bytearray(record(folder / "a.mcap", messages, every=20))
    ends = chunk_ends(bytes(data), folder / "a.mcap")
    start = 8 + where % (ends[-1] - 8)
    garbage = random.Random(seed).randbytes(length)
    data[start : start + length] = garbage[: len(data) - start]
    (folder / "a.mcap").write_bytes(data)

    found, _ = read(folder / "a.mcap")

    begins = [0, *ends[:-1]]
    for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        if end <= start or begin >= start + length:
            assert messages[20 * k : 20 * k + 20] == [m for m in found if m in messages[20 * k : 20 * k + 20]]
    assert [m for m in messages if m in found] == found


def test_inserted_bytes_are_skipped_and_counted(tmp_path: Path) -> None:
    messages = envelopes(100)
    data = record(tmp_path / "a.mcap", messages, every=20)
    middle = chunk_ends(data, tmp_path / "a.mcap")[1]
    (tmp_path / "a.mcap").write_bytes(data[:middle] + b"\x06garbage" * 50 + data[middle:])

    found, problems = read(tmp_path / "a.mcap")

    assert found == messages
    assert len(problems) == 1
    assert problems[0].startswith(f"damage: skipped the bytes {middle} to ")


def test_zeros_after_a_power_cut_lose_no_message_before_them(tmp_path: Path) -> None:
    messages = envelopes(60)
    data = record(tmp_path / "a.mcap", messages, every=20, close=False)
    (tmp_path / "a.mcap").write_bytes(data + bytes(8192))

    found, problems = read(tmp_path / "a.mcap")

    assert found == messages
    assert problems == [f"the recording was not closed: it ends at byte {len(data) + 8192}"]


def test_without_the_first_chunk_the_others_are_read(tmp_path: Path) -> None:
    messages = envelopes(60)
    data = bytearray(record(tmp_path / "a.mcap", messages, every=20))
    end = chunk_ends(bytes(data), tmp_path / "a.mcap")[0]
    data[end - 40 : end] = bytes(40)
    (tmp_path / "a.mcap").write_bytes(data)

    assert read(tmp_path / "a.mcap")[0] == messages[20:]


def test_a_file_that_is_no_recording_gives_a_problem_and_no_message(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x06\x07 not a recording" * 1000)

    found, problems = read(tmp_path / "a.mcap")

    assert found == []
    assert problems[0] == "the file does not begin like an MCAP recording"


def test_a_missing_file_is_a_bad_recording(tmp_path: Path) -> None:
    with pytest.raises(BadRecording, match=r"cannot read .*: No such file"):
        Recording(tmp_path / "missing.mcap")


def test_a_recording_can_be_read_twice(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", envelopes(30))
    with Recording(tmp_path / "a.mcap") as recording:
        assert list(recording) == list(recording)
        assert recording.position == recording.size


def test_a_second_recording_never_overwrites_the_first(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", envelopes(3))
    with pytest.raises(FileExistsError):
        RecordingWriter(tmp_path / "a.mcap")


class FullDisk:
    """A file with room for some bytes, whose last write is partial, as on a full disk."""

    def __init__(self, path: Path, room: int) -> None:
        self._file = path.open("xb", buffering=0)
        self.room = room

    def write(self, data: memoryview) -> int | None:
        if not self.room:
            raise OSError(28, "No space left on device")
        part = data[: self.room]
        self.room -= len(part)
        return self._file.write(part)

    def truncate(self, size: int) -> int:
        return self._file.truncate(size)

    def seek(self, offset: int) -> int:
        return self._file.seek(offset)

    def fileno(self) -> int:
        return self._file.fileno()

    def close(self) -> None:
        self._file.close()


def test_a_full_disk_leaves_the_chunks_before_it_and_no_part_of_the_next(tmp_path: Path) -> None:
    messages = envelopes(100)
    writer = RecordingWriter(tmp_path / "a.mcap", opener=lambda path: FullDisk(path, 8000))
    with pytest.raises(OSError, match="No space left"):
        for k, envelope in enumerate(messages, 1):
            writer.write(envelope)
            if k % 10 == 0:
                writer.flush()
    writer.abandon()

    found, _ = read(tmp_path / "a.mcap")

    assert 0 < len(found) == writer.messages < 100
    assert found == messages[: len(found)]
    assert (tmp_path / "a.mcap").stat().st_size == writer.bytes_written


def test_provenance_is_read_as_it_was_written(tmp_path: Path) -> None:
    provenance = {"name": "a drive", "mapping": "# of\ntwo lines"}
    RecordingWriter(tmp_path / "a.mcap", vehicle="car", provenance=provenance).close()
    with Recording(tmp_path / "a.mcap") as recording:
        assert recording.metadata == {"obu": {"vehicle": "car", "version": VERSION}, "provenance": provenance}
    with (tmp_path / "a.mcap").open("rb") as file:
        assert {record.name for record in make_reader(file).iter_metadata()} == {"obu", "provenance"}


def test_messages_rejected_by_a_full_disk_are_written_once_there_is_room(tmp_path: Path) -> None:
    messages = envelopes(100)
    disk: list[FullDisk] = []

    def opened(path: Path) -> FullDisk:
        disk.append(FullDisk(path, 2500))
        return disk[0]

    writer = RecordingWriter(tmp_path / "a.mcap", opener=opened)
    for envelope in messages[:50]:
        writer.write(envelope)
    with pytest.raises(OSError, match="No space left"):
        writer.flush()
    assert (writer.messages, writer.pending) == (0, 50)
    disk[0].room = 1_000_000
    for envelope in messages[50:]:
        writer.write(envelope)
    writer.close()

    assert (writer.messages, writer.pending) == (100, 0)
    assert read(tmp_path / "a.mcap") == (messages, [])
    chunk_ends((tmp_path / "a.mcap").read_bytes(), tmp_path / "a.mcap")


def test_without_a_summary_a_lost_chunk_loses_the_channels_that_begin_in_it(tmp_path: Path) -> None:
    """mcap's writer describes a channel once, and the summary, which does so again, is missing after a power cut."""
    messages = envelopes(60)
    other = [sent_bytes("mode/state", b'{"a":1}', START_NS + k, "controller.mode", 1, k) for k in range(20)]
    record(tmp_path / "closed.mcap", [*messages[:20], *other, *messages[20:]], every=20)
    data = record(tmp_path / "a.mcap", [*messages[:20], *other, *messages[20:]], every=20, close=False)
    end = chunk_ends((tmp_path / "closed.mcap").read_bytes(), tmp_path / "closed.mcap")[0]
    (tmp_path / "a.mcap").write_bytes(data[: end - 40] + bytes(40) + data[end:])

    found, problems = read(tmp_path / "a.mcap")

    assert found == other
    assert problems[-1] == "40 messages could not be decoded"


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_recording_that_another_tool_has_rewritten_holds_the_same(
    tmp_path: Path, compression: CompressionType
) -> None:
    messages = envelopes(100)
    record(tmp_path / "a.mcap", messages)
    rewrite(tmp_path / "a.mcap", tmp_path / "b.mcap", compression)
    found, problems = read(tmp_path / "b.mcap")
    assert found == messages and not problems
    with Recording(tmp_path / "b.mcap") as recording:
        assert recording.attachments["vehicle.toml"] == b'[vehicle]\nname = "car"\n', "behind the messages"
        assert recording.metadata["obu"]["vehicle"] == "car" and recording.topics
        assert list(chosen(recording, ("imu/raw",))) == [message for message in messages if message.topic == "imu/raw"]


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_rewritten_recording_that_was_cut_gives_what_is_whole(tmp_path: Path, compression: CompressionType) -> None:
    messages = envelopes(2000)
    record(tmp_path / "a.mcap", messages)
    rewrite(tmp_path / "a.mcap", tmp_path / "b.mcap", compression)
    data = (tmp_path / "b.mcap").read_bytes()
    (tmp_path / "c.mcap").write_bytes(data[: len(data) // 2])
    found, problems = read(tmp_path / "c.mcap")
    assert 500 < len(found) < 1500 and found == messages[: len(found)]
    assert "was not closed" in problems[0]


def test_chunks_of_an_unknown_compression_are_said(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(file_of(chunk(b"brotli", 1000, b"x" * 100)))
    found, problems = read(tmp_path / "a.mcap")
    assert not found and "chunks packed with 'brotli' are not read: zstd, lz4 and none are" in problems


ZEROS = bytes(16 << 20)


@pytest.mark.parametrize(("name", "data"), [("zstd", zstandard.compress(ZEROS)), ("lz4", lz4.frame.compress(ZEROS))])
def test_chunks_that_unpack_to_gigabytes_are_an_error_before_they_do(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / "a.mcap").write_bytes(file_of(*[chunk(name.encode(), len(ZEROS), data)] * 100))
    with pytest.raises(BadRecording, match=r"bytes unpack to \d{2} MB or more, over 100 times their size"):
        read(tmp_path / "a.mcap")


def test_a_chunk_beyond_the_limit_is_not_unpacked_and_said(tmp_path: Path) -> None:
    data = zstandard.compress(bytes(40 << 20))
    (tmp_path / "a.mcap").write_bytes(file_of(chunk(b"zstd", 40 << 20, data), chunk(b"zstd", 3 << 30, data)))
    found, problems = read(tmp_path / "a.mcap")
    assert not found and "a chunk that unpacks to 42 MB is not read: 16 MB at most" in problems


def test_users_and_passwords_in_urls_of_the_vehicles_file_are_not_recorded() -> None:
    text = 'sources = ["ntrip://me:hunter2@caster.example.org/M", "tcp://a.example.org:5"]\nmail = "a@b.example.org"\n'
    assert without_users(text) == text.replace("me:hunter2@", "")
