import errno
import os
import shutil
from pathlib import Path

import pytest
from pydantic import ValidationError

from services.monitoring.recorder.codes import Code
from services.monitoring.recorder.process import POWER_ENDS, Config, Process
from shared.bus.bus import Envelope
from shared.library.order import in_order, read_order
from shared.messages.explanation import QuotedText, explain
from shared.messages.operation import Mode, ModeState, RecordingState
from shared.messages.power import LowReason
from shared.recording import Recording
from shared.recording.reader import MAXIMUM_CHUNK
from shared.words.words import words
from tests.support.bus.envelopes import sent, sent_bytes
from tests.support.bus.fake_bus import FakeBus

START_NS = 1_790_000_000_000_000_000
EASY = Config(minimum_free_bytes=0)


def envelope(k: int) -> Envelope:
    return sent_bytes("mode/state", b'{"k":%d}' % k, START_NS + k, "controller.mode", 1, k)


class Script:
    """One message a call, for so many calls."""

    def __init__(self, calls: int) -> None:
        self.calls = calls

    def __call__(self, call: int) -> list[Envelope] | None:
        return [envelope(call)] if call < self.calls else None


def run(tmp_path: Path, config: Config, calls: int) -> list[RecordingState]:
    bus = FakeBus(tmp_path, Script(calls), start_ns=START_NS)
    Process(config).run(bus.as_bus())
    return [message for message in bus.published if isinstance(message, RecordingState)]


def recorded(folder: Path) -> list[int]:
    found = []
    for path in sorted(folder.glob("*.mcap")):
        with Recording(path) as recording:
            found += [message.sequence for message in recording]
    return found


def test_every_message_is_recorded_until_the_end(tmp_path: Path) -> None:
    states = run(tmp_path, EASY, 55)

    assert recorded(tmp_path / "recordings") == list(range(55))
    assert [path.name for path in (tmp_path / "recordings").iterdir()] == ["20260921T141320Z_car.mcap"]
    assert len(states) == 6
    assert states[-1].recording
    assert states[-1].file == "20260921T141320Z_car.mcap"
    assert states[-1].messages >= 44
    assert states[-1].dropped == 0


def test_what_was_flushed_is_in_the_file_while_it_is_written(tmp_path: Path) -> None:
    seen = []

    def script(call: int) -> list[Envelope] | None:
        if call == 30:
            seen.extend(recorded(tmp_path / "recordings"))
            return None
        return [envelope(call)]

    Process(EASY).run(FakeBus(tmp_path, script, start_ns=START_NS).as_bus())

    assert seen == list(range(len(seen)))
    assert len(seen) > 23  # half a second at ten messages a second may be missing


def test_a_new_file_begins_when_the_old_is_old_enough_and_none_is_lost(tmp_path: Path) -> None:
    run(tmp_path, Config(minimum_free_bytes=0, rotate_period_s=2.0), 55)

    assert len(list((tmp_path / "recordings").glob("*.mcap"))) == 3
    assert recorded(tmp_path / "recordings") == list(range(55))


def test_a_new_file_begins_when_the_old_is_large_enough(tmp_path: Path) -> None:
    run(tmp_path, Config(minimum_free_bytes=0, rotate_bytes=1), 30)

    assert len(list((tmp_path / "recordings").glob("*.mcap"))) == 3
    assert recorded(tmp_path / "recordings") == list(range(30))


def test_old_recordings_make_room_but_not_those_to_be_kept(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    for name in ("20200101T000000Z_car.mcap", "20200102T000000Z_car.mcap", "20200103T000000Z_car.mcap"):
        (folder / name).write_bytes(bytes(100_000))
    (folder / "20200101T000000Z_car.mcap.keep").touch()

    run(tmp_path, Config(minimum_free_bytes=0, maximum_total_bytes=210_000), 20)

    names = sorted(path.name for path in folder.glob("*.mcap"))
    assert names == ["20200101T000000Z_car.mcap", "20200103T000000Z_car.mcap", "20260921T141320Z_car.mcap"]


def codes_of(states: list[RecordingState]) -> set[str]:
    return {state.reason_code.code for state in states if state.reason_code is not None}


def test_a_disk_below_its_floor_is_not_written_to_and_the_state_says_why(tmp_path: Path) -> None:
    states = run(tmp_path, Config(minimum_free_bytes=1 << 60), 25)

    assert list((tmp_path / "recordings").iterdir()) == []
    assert not any(state.recording for state in states)
    assert codes_of(states[-1:]) == {Code.DISK_FULL} and states[-1].reason
    assert states[-1].dropped == 20


class Disk:
    """Files on a disk that is full while `full` is set: a simulated fault, the rest is real."""

    def __init__(self) -> None:
        self.full = False

    def open(self, path: Path) -> "DiskFile":
        return DiskFile(self, path)


class DiskFile:
    def __init__(self, disk: Disk, path: Path) -> None:
        self._disk, self._file = disk, path.open("xb", buffering=0)

    def write(self, data: memoryview) -> int | None:
        if not self._disk.full:
            return self._file.write(data)
        if len(data) > 20:
            return self._file.write(data[:20])
        raise OSError(errno.ENOSPC, "No space left on device")

    def truncate(self, size: int) -> int:
        return self._file.truncate(size)

    def seek(self, offset: int) -> int:
        return self._file.seek(offset)

    def fileno(self) -> int:
        return self._file.fileno()

    def close(self) -> None:
        self._file.close()


def test_a_full_disk_stops_the_recorder_with_a_reason_and_it_resumes_by_itself(tmp_path: Path) -> None:
    disk = Disk()

    def script(call: int) -> list[Envelope] | None:
        disk.full = 50 <= call < 100
        return [envelope(call)] if call < 200 else None

    bus = FakeBus(tmp_path, script, start_ns=START_NS)
    Process(EASY, disk.open).run(bus.as_bus())

    states = [message for message in bus.published if isinstance(message, RecordingState)]
    assert [state.recording for state in states[1:5]] == [True] * 4
    stopped = [state for state in states if not state.recording]
    assert 5 <= len(stopped) <= 10
    assert codes_of(stopped) <= {Code.CANNOT_WRITE, Code.CANNOT_USE_FOLDER}
    assert states[-1].recording
    assert states[-1].reason is None
    found = recorded(tmp_path / "recordings")
    assert found[:45] == list(range(45))
    assert found[-90:] == list(range(110, 200))
    assert found == sorted(set(found))
    assert states[-1].dropped == 200 - len(found)


def test_a_folder_that_cannot_be_made_is_a_reason_and_not_a_crash(tmp_path: Path) -> None:
    (tmp_path / "recordings").write_text("a file where the folder should be")

    states = run(tmp_path, EASY, 25)

    assert not states[-1].recording
    assert codes_of(states[-1:]) == {Code.CANNOT_USE_FOLDER}


def test_a_disk_that_is_not_mounted_is_a_reason_and_its_place_is_not_made(tmp_path: Path) -> None:
    states = run(tmp_path, Config(minimum_free_bytes=0, folder=str(tmp_path / "disk" / "recordings")), 25)

    assert [(state.recording, state.free_bytes) for state in states] == [(False, 0)] * len(states)
    assert codes_of(states) == {Code.CANNOT_USE_FOLDER}
    assert states[-1].reason_code is not None
    assert states[-1].reason_code.values["error"] == QuotedText(quoted="No such file or directory")
    assert states[-1].dropped == 20
    assert not (tmp_path / "disk").exists()


def test_recording_begins_once_the_disk_is_mounted_and_outlives_its_removal(tmp_path: Path) -> None:
    disk = tmp_path / "disk"

    def script(call: int) -> list[Envelope] | None:
        if call == 30:
            disk.mkdir()
        if call == 150:
            disk.rename(tmp_path / "elsewhere")
        return [envelope(call)] if call < 200 else None

    bus = FakeBus(tmp_path, script, start_ns=START_NS)
    Process(Config(minimum_free_bytes=0, folder=str(disk / "recordings"))).run(bus.as_bus())

    states = [message for message in bus.published if isinstance(message, RecordingState)]
    assert [state.recording for state in states] == [False] * 8 + [True] * 8 + [False] * 5
    assert recorded(tmp_path / "elsewhere" / "recordings") == list(range(80, 160))


def test_a_batch_that_a_failing_disk_cuts_short_is_counted_to_its_end(tmp_path: Path) -> None:
    disk = Disk()

    def script(call: int) -> list[Envelope] | None:
        disk.full = call == 5
        batch = [envelope(100 * call + k) for k in range(50)]
        return batch if call < 15 else None

    bus = FakeBus(tmp_path, script, start_ns=START_NS)
    Process(Config(minimum_free_bytes=0, chunk_bytes=500), disk.open).run(bus.as_bus())

    states = [message for message in bus.published if isinstance(message, RecordingState)]
    assert states[-1].dropped >= 50
    assert states[-1].dropped + states[-1].messages == 10 * 50, "all that came before the state was said"


@pytest.mark.parametrize(
    "setting",
    ["chunk_bytes", "flush_period_s", "rotate_bytes", "rotate_period_s", "maximum_total_bytes"],
)
def test_sizes_and_periods_are_above_zero(setting: str) -> None:
    for value in (0, -1):
        with pytest.raises(ValidationError, match="greater than 0"):
            Config.model_validate({setting: value})


def test_no_chunk_is_larger_than_the_reader_takes() -> None:
    with pytest.raises(ValidationError, match="less than or equal to"):
        Config(chunk_bytes=MAXIMUM_CHUNK)


def test_a_recording_left_by_a_crash_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    left = tmp_path / "recordings" / "20260921T141320Z_car.mcap"
    left.write_bytes(b"cut")

    run(tmp_path, EASY, 20)

    assert left.read_bytes() == b"cut"
    assert recorded(tmp_path / "recordings") == list(range(20))


def test_a_folder_outside_the_state_folder_is_taken(tmp_path: Path) -> None:
    run(tmp_path / "state", Config(minimum_free_bytes=0, folder=str(tmp_path / "disk")), 5)

    assert recorded(tmp_path / "disk") == list(range(5))


@pytest.mark.parametrize("calls", [0, 3])
def test_a_file_without_a_message_is_not_left_behind(tmp_path: Path, calls: int) -> None:
    run(tmp_path, EASY, calls)

    assert len(list((tmp_path / "recordings").iterdir())) == (1 if calls else 0)


@pytest.mark.parametrize(("role", "kept"), [("obu", 3), ("rsu", 1)])
def test_a_road_side_unit_records_nothing_that_describes_other_road_users(tmp_path: Path, role: str, kept: int) -> None:
    topics = ["toll/passage", "toll/tracks", "toll/delta"]
    messages = [sent_bytes(topic, b"{}", START_NS, sequence=n) for n, topic in enumerate(topics)]
    bus = FakeBus(tmp_path, lambda call: messages if call == 0 else None, start_ns=START_NS)
    bus.vehicle_toml = f'[vehicle]\nrole = "{role}"\n'
    Process(EASY).run(bus.as_bus())
    assert len(recorded(tmp_path / "recordings")) == kept


def test_a_clock_that_went_back_costs_the_oldest_by_order_of_making_and_not_the_present_drive(tmp_path: Path) -> None:
    """The present drive is dated before those that are there, and the next ones before it."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    for name in ("20300101T000000Z_car_10.mcap", "20300101T000000Z_car_2.mcap", "20300102T000000Z_car.mcap"):
        (folder / name).write_bytes(bytes(100_000))
    config = Config(minimum_free_bytes=0, maximum_total_bytes=210_000)

    run(tmp_path, config, 20)
    assert names_of(folder) == [
        "20300101T000000Z_car_10.mcap", "20300102T000000Z_car.mcap", "20260921T141320Z_car.mcap",
    ]  # fmt: skip
    (folder / "20260921T141320Z_car.mcap").write_bytes(bytes(90_000))
    (folder / "20200101T000000Z_copied.mcap").write_bytes(bytes(50_000))
    run(tmp_path, config, 20)
    assert names_of(folder) == [
        "20260921T141320Z_car.mcap", "20200101T000000Z_copied.mcap", "20260921T141320Z_car_2.mcap",
    ]  # fmt: skip


def names_of(folder: Path) -> list[str]:
    return in_order((path.name for path in folder.glob("*.mcap")), read_order(folder))


@pytest.mark.parametrize("stored", [b"\0" * 40, b"[1, {}]", b'{"a": 1}', b'["20300101', b""])
def test_an_order_that_cannot_be_read_is_made_anew(stored: bytes, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    (folder / "order.json").write_bytes(stored)
    for name in ("a_10.mcap", "a_2.mcap"):
        (folder / name).write_bytes(b"x")
    run(tmp_path, Config(minimum_free_bytes=0), 20)
    assert names_of(folder) == ["a_2.mcap", "a_10.mcap", "20260921T141320Z_car.mcap"]


@pytest.mark.parametrize("what", ["the folder", "the file", "replaced"])
def test_what_vanished_while_recording_is_an_outage_and_recording_resumes(what: str, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"

    def script(call: int) -> list[Envelope] | None:
        if call == 30:
            path = next(folder.glob("*.mcap"))
            shutil.rmtree(folder) if what == "the folder" else path.unlink()
            if what == "replaced":
                path.write_bytes(b"another file")
        return [envelope(call)] if call < 150 else None

    bus = FakeBus(tmp_path, script, start_ns=START_NS)
    Process(Config(minimum_free_bytes=0)).run(bus.as_bus())

    states = [message for message in bus.published if isinstance(message, RecordingState)]
    outage = [state for state in states if not state.recording]
    assert outage and "vanished" in (outage[0].reason or "")
    assert outage[0].now_ns - START_NS < 5 * 10**9, "it is noticed within two seconds of the thirtieth message"
    assert states[-1].recording and states[-1].reason is None
    for path in folder.glob("*.mcap"):
        if path.read_bytes() == b"another file":
            path.unlink()
    assert recorded(folder)[-1] == 149 and recorded(folder)[0] > 30


def test_the_entry_of_a_new_recording_is_written_to_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[Path] = []
    monkeypatch.setattr("shared.recording.folder._sync_path", synced.append)
    run(tmp_path, Config(minimum_free_bytes=0, rotate_period_s=2.0), 55)
    assert synced == [tmp_path / "recordings"] * 3, "once for each of three files"


def test_nothing_strange_in_the_folder_stops_the_recorder(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    (folder / "20200101T000000Z_dangling.mcap").symlink_to(tmp_path / "nowhere")
    (folder / "20260921T141320Z_car.mcap").symlink_to(folder / "nowhere either")
    (folder / "20200102T000000Z_folder.mcap").mkdir()
    (folder / "20200103T000000Z_round.mcap").symlink_to("20200103T000000Z_round.mcap")
    os.mkfifo(folder / "20200104T000000Z_pipe.mcap")
    states = run(tmp_path, EASY, 20)
    assert states[-1].recording and states[-1].file == "20260921T141320Z_car_2.mcap"


def test_a_recording_that_cannot_be_deleted_does_not_stop_the_deletion_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    for name in ("a.mcap", "b.mcap", "c.mcap"):
        (folder / name).write_bytes(bytes(100_000))
    unlink = Path.unlink

    def refuses(path: Path, **options: bool) -> None:
        if path.name == "a.mcap":
            raise PermissionError(1, "Operation not permitted")
        unlink(path, **options)

    monkeypatch.setattr(Path, "unlink", refuses)
    states = run(tmp_path, Config(minimum_free_bytes=0, maximum_total_bytes=210_000), 30)
    assert states[-1].recording
    assert names_of(folder) == ["a.mcap", "c.mcap", "20260921T141320Z_car.mcap"]


def mode_at(call: int, *, power_off: bool, retained: bool = False, why: LowReason | None = None) -> Envelope:
    state = ModeState(
        sampled_ns=START_NS, mode=Mode.SHUTTING_DOWN, since_ns=START_NS, reason="", power_off=power_off,
        power_off_reason=why,
    )  # fmt: skip
    return sent(state, START_NS + call, "controller.mode", 1, call, retained=retained)


def test_the_file_is_closed_before_the_power_ends_and_a_new_one_begins_when_it_is_back(tmp_path: Path) -> None:
    folder, finished = tmp_path / "recordings", []

    def script(call: int) -> list[Envelope] | None:
        if call == 35:
            (path,) = folder.glob("*.mcap")
            finished.append(path.read_bytes().endswith(b"\x89MCAP0\r\n"))  # the magic bytes behind the summary
        if call == 80:
            return None
        return [mode_at(call, power_off=20 <= call < 50)]

    bus = FakeBus(tmp_path, script, start_ns=START_NS)
    Process(EASY).run(bus.as_bus())
    states = [message for message in bus.published if isinstance(message, RecordingState)]
    assert finished == [True] and len(list(folder.glob("*.mcap"))) == 2
    assert [state.recording for state in states] == [True] * 3 + [False] * 3 + [True] * 3
    assert "about to end" in (states[4].reason or "")


def test_every_reason_of_a_low_battery_has_its_own_words() -> None:
    codes = [POWER_ENDS[reason] for reason in LowReason]
    assert len({words().detail(explain(code)) for code in codes}) == len(LowReason)


def test_a_recorder_that_stops_for_a_battery_that_lasts_too_short_says_so(tmp_path: Path) -> None:
    def script(call: int) -> list[Envelope] | None:
        return [mode_at(call, power_off=True, why=LowReason.AUTONOMY)] if call < 40 else None

    bus = FakeBus(tmp_path, script, start_ns=START_NS)
    Process(EASY).run(bus.as_bus())
    last = [message for message in bus.published if isinstance(message, RecordingState)][-1]
    assert last.reason_code is not None and last.reason_code.code == Code.AUTONOMY_ENDS


def test_a_mode_that_the_broker_has_kept_closes_nothing(tmp_path: Path) -> None:
    def script(call: int) -> list[Envelope] | None:
        return [mode_at(call, power_off=True, retained=True)] if call < 25 else None

    bus = FakeBus(tmp_path, script, start_ns=START_NS)
    Process(EASY).run(bus.as_bus())
    assert all(message.recording for message in bus.published if isinstance(message, RecordingState))
