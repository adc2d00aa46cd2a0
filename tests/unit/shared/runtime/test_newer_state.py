"""Files of the state folder that a newer version has written: each is read, left out, or refused by a sentence.

The list of these files is in docs/how-to/upgrade.md. The ledger's is in test_ledger_process.py.
"""

import json
import logging
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import cast

import pytest
from mcap.writer import Writer

from cli.recordings.common import open_recording, vehicle_of
from services.monitoring.status.history.history_file import HistoryFile
from services.monitoring.status.history.track import Track, TrackRow
from services.monitoring.status.state import State
from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.access.tokens import Tokens
from shared import VERSION, is_newer
from shared.bus import codec
from shared.bus.bus import Bus, Envelope
from shared.errors import ConfigError, UserError
from shared.evidence.signer import EvidenceError, KeyFile
from shared.library.order import ORDER_FILE, read_order
from shared.library.summary import SUFFIX, RecordingSummary, read_summary
from shared.messages.base import Message
from shared.messages.gnss import GnssRaw
from shared.messages.navigation import LastPosition
from shared.recording import Recording, RecordingWriter
from shared.runtime.clock import boot_id, fixed_offset_ns
from shared.runtime.last_end import FOLDER, LastEnd
from shared.runtime.live import LiveReactor
from tests.support.bus.envelopes import sent, sent_bytes
from tests.support.cases import each
from tests.support.data import REPOSITORY
from tests.support.patience import HANGS_S

NOW_NS = 1_800_000_000_000_000_000


class SilentBus:
    """A bus on which nothing comes."""

    process, incarnation, sequence, connected, stopping = "controller.mode", 1, 1, True, True
    last_error: str | None = None
    dropped = 0

    def __init__(self, state_dir: Path) -> None:
        self.state_dir = state_dir
        self.rejects: Counter[str] = Counter()
        self.published: list[Message] = []

    def now_ns(self) -> int:
        return NOW_NS

    def receive(self, _timeout_s: float) -> list[Envelope]:
        return []

    def publish(self, message: Message, **_at_once: bool) -> None:
        self.published.append(message)

    def flush(self) -> None:
        """There is nothing to write."""


class Listener:
    """Notes what it is given."""

    def __init__(self) -> None:
        self.rejects: Counter[str] = Counter()
        self.seen: list[Message] = []

    def handle(self, message: Message) -> list[Message]:
        self.seen.append(message)
        return []


def restored(folder: Path, saved: dict[str, object]) -> tuple[SilentBus, Listener]:
    (folder / "saved-navigation-last_position.json").write_text(json.dumps(saved))
    bus, process = SilentBus(folder), Listener()
    LiveReactor(process, cast(Bus, bus)).run()
    return bus, process


def position() -> dict[str, object]:
    place = LastPosition(
        sampled_ns=NOW_NS, latitude_deg=48.0, longitude_deg=9.0, height_ellipsoid_m=500.0, yaw_rad=0.5,
        position_sd_ned_m=(1.0, 1.0, 2.0), yaw_sd_rad=0.1,
    )  # fmt: skip
    return cast("dict[str, object]", json.loads(codec.encode(place)))


def test_a_saved_message_with_a_new_field_is_read(tmp_path: Path) -> None:
    bus, process = restored(tmp_path, {**position(), "of_the_future": [1, 2]})
    assert [type(message) for message in process.seen if isinstance(message, LastPosition)] == [LastPosition]
    assert not bus.rejects


def test_a_saved_message_whose_field_has_another_form_is_left_out_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        bus, process = restored(tmp_path, {**position(), "latitude_deg": {"value": 48.0, "sd": 0.1}})
    assert not process.seen
    assert bus.rejects["saved state"] == 1
    assert "ignored the saved navigation/last_position" in caplog.text


def test_a_message_that_was_saved_in_another_boot_is_of_an_earlier_life(tmp_path: Path) -> None:
    for boot, earlier in ((None, False), (boot_id(), False), ("0f2d", True)):
        _, process = restored(tmp_path, {**position(), **({"boot": boot} if boot else {})})
        [found] = [message for message in process.seen if isinstance(message, LastPosition)]
        assert (found.earlier_life, found.boot) == (earlier, None)


def test_lines_of_the_history_that_are_not_known_are_left_out_and_counted(tmp_path: Path) -> None:
    file = HistoryFile(tmp_path / "status.history.jsonl")
    file.append([{"kind": "of the future", "ns": NOW_NS}])
    assert State("car", (), NOW_NS, 60.0).restore(file.read()) == 1


def test_rows_of_the_track_that_are_not_known_are_left_out_and_counted(tmp_path: Path) -> None:
    file = HistoryFile(tmp_path / "status.track.jsonl")
    row = TrackRow(NOW_NS - 1_000_000_000, "SAFE", aided=True)._asdict()
    file.append([row, {**row, "time_ns": NOW_NS, "fused": {"wgs84": [48.0, 9.0]}}])
    track = Track()
    assert track.restore(file.read(), NOW_NS) == 1
    assert track.rows[0].time_ns == NOW_NS - 1_000_000_000


def test_a_file_of_tokens_lets_nobody_in_and_stays(tmp_path: Path) -> None:
    tokens = Tokens(tmp_path)
    secret = tokens.add("workshop", Right.VIEW)
    content = {**json.loads(tokens.path.read_text()), "keys": ["of the future"]}
    tokens.path.write_text(json.dumps(content))
    assert Tokens(tmp_path).find(secret) is None
    with pytest.raises(UserError, match="of this version; move it away"):
        tokens.add("guest", Right.VIEW)
    assert json.loads(tokens.path.read_text()) == content


def test_a_key_of_another_kind_is_refused_and_stays(tmp_path: Path) -> None:
    keys = KeyFile(tmp_path)
    keys.signer()
    keys.path.chmod(0o600)
    keys.path.write_text("-----BEGIN FUTURE KEY-----\nAAAA\n-----END FUTURE KEY-----\n")
    with pytest.raises(EvidenceError, match="cannot use the key"):
        KeyFile(tmp_path).signer()
    assert "FUTURE" in keys.path.read_text()


def test_a_ring_with_new_facts_about_its_keys_is_read(tmp_path: Path) -> None:
    keys = KeyFile(tmp_path)
    key_id = keys.signer().key_id
    (ring,) = tmp_path.glob("*.json")
    content = json.loads(ring.read_text())
    ring.chmod(0o600)
    ring.write_text(json.dumps({**content, "version": 9, "keys": [{**key, "holder": "x"} for key in content["keys"]]}))
    assert KeyFile(tmp_path).ring.find(key_id) is not None


@pytest.mark.parametrize("text", ['{"version": 9, "order": ["b.mcap"]}', "order = 1"])
def test_an_order_of_another_form_is_left_out(tmp_path: Path, text: str) -> None:
    (tmp_path / ORDER_FILE).write_text(text)
    assert read_order(tmp_path) == []


def test_a_summary_of_another_version_is_computed_anew(tmp_path: Path) -> None:
    path = tmp_path / f"drive.mcap{SUFFIX}"
    summary = RecordingSummary(size_bytes=10, begin_ns=NOW_NS, end_ns=NOW_NS)
    path.write_text(summary.model_dump_json())
    assert read_summary(path, 10) == summary
    path.write_text(summary.model_copy(update={"version": 99}).model_dump_json())
    assert read_summary(path, 10) is None


def test_a_time_line_of_another_form_is_replaced(tmp_path: Path) -> None:
    (tmp_path / f"clock-{boot_id()}").write_text('{"offset_ns": 5}')
    assert fixed_offset_ns(tmp_path) == fixed_offset_ns(tmp_path) != 5


def test_what_a_process_has_left_is_text_of_any_form(tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FOLDER / "core.fusion.txt").write_bytes(b'\xff\x00{"ended": "of the future"}')
    end = LastEnd(tmp_path, "core.fusion")
    end.begin()
    end.close()
    assert list((tmp_path / FOLDER).iterdir()) == []


def recording_of(path: Path, version: str, vehicle_toml: str = "") -> Path:
    """A recording by that version, with a message on a topic that this one does not have."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="obu")
        writer.add_metadata("obu", {"vehicle": "car", "version": version})
        writer.add_attachment(0, 0, "vehicle.toml", "application/toml", vehicle_toml.encode())
        channel = writer.register_channel("navigation/of_the_future", "cbor", 0)
        writer.add_message(channel, NOW_NS, b"\xa1\x61x\x01", NOW_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_messages_of_a_newer_recording_are_left_out_with_what_to_do(tmp_path: Path) -> None:
    with Recording(recording_of(tmp_path / "drive.mcap", "99.0.0")) as recording:
        assert list(recording) == []
        (problem,) = recording.problems
    assert problem == (
        f"1 messages could not be decoded; version 99.0.0 recorded it, and this is {VERSION}: update this program"
    )


@pytest.mark.parametrize(("version", "said"), [("99.0.0", True), (VERSION, False)])
def test_a_vehicle_file_of_a_newer_recording_is_refused_with_what_to_do(
    tmp_path: Path, version: str, said: bool
) -> None:
    path = recording_of(tmp_path / "drive.mcap", version, "[core.future]\nx = 1\n")
    with open_recording(path) as recording, pytest.raises(ConfigError, match="is no process") as error:
        vehicle_of(recording, None)
    assert ("update this program" in str(error.value)) is said


def test_a_setting_of_a_newer_version_is_refused_with_what_to_do_by_solve(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="obu")
        writer.add_metadata("obu", {"vehicle": "car", "version": "99.0.0"})
        text = b"[core.fusion]\nof_the_future = 1\n"
        writer.add_attachment(0, 0, "vehicle.toml", "application/toml", text)
        channel = writer.register_channel("gnss/raw", "json", 0)
        raw = GnssRaw(received_ns=NOW_NS, source="gnss0", data=b"x")
        writer.add_message(channel, NOW_NS, sent(raw, NOW_NS, "sensors.gnss", 1, 1).payload, NOW_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    done = subprocess.run(
        [sys.executable, "-m", "cli", "solve", str(path), "--out", str(tmp_path / "out")],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=HANGS_S, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert "of_the_future" in done.stderr
    assert "update this program" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


def test_a_recording_says_which_version_wrote_it(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "drive.mcap", vehicle="car")
    writer.write(sent_bytes("mode/state", b'{"a":1}', NOW_NS, "controller.mode", 1, 1))
    writer.close()
    with Recording(tmp_path / "drive.mcap") as recording:
        assert recording.metadata["obu"]["version"] == VERSION
        assert recording.newer == ""


@each(("version", "newer"), [
    (VERSION, False), ("0.0.9", False), ("0.1.1", True), ("0.10.0", True), ("1", True), ("", False), ("next", False),
    ("9" * 5000, False),
])  # fmt: skip
def test_versions_are_compared_by_their_numbers(version: str, newer: bool) -> None:
    assert is_newer(version) is newer
