from services.monitoring.recorder.codes import Code
from services.monitoring.recorder.retention import Limits, Verdict, decide, file_name
from shared.messages.explanation import explain
from shared.recording.folder import StoredRecording
from tests.support.cases import each

LIMITS = Limits(maximum_total_bytes=100, minimum_free_bytes=50)
FILES = [StoredRecording("c", 30), StoredRecording("a", 30), StoredRecording("b", 30)]


def test_nothing_goes_while_both_limits_hold() -> None:
    assert decide(FILES, 50, LIMITS) == Verdict()


def test_the_oldest_go_first_and_no_more_than_needed() -> None:
    assert decide([*FILES, StoredRecording("d", 45)], 1000, LIMITS) == Verdict(delete=("a", "b"))


def test_low_room_on_the_disk_lets_the_oldest_go() -> None:
    assert decide(FILES, 19, LIMITS) == Verdict(delete=("a", "b"))


def test_a_kept_recording_stays_and_the_next_goes() -> None:
    assert decide([StoredRecording("a", 30, kept=True), *FILES[::2]], 30, LIMITS) == Verdict(delete=("b",))


def test_the_recording_in_progress_counts_but_stays() -> None:
    assert decide([StoredRecording("a", 80), StoredRecording("b", 30)], 1000, LIMITS, open_name="a") == Verdict(
        delete=("b",)
    )


def test_kept_recordings_over_the_quota_stop_the_recorder() -> None:
    verdict = decide(
        [StoredRecording("a", 101_000_000, kept=True), StoredRecording("b", 5)], 1000, Limits(100_000_000, 0)
    )

    assert verdict == Verdict(refusal=explain(Code.OVER_QUOTA, maximum_total_bytes=100_000_000))


def test_nothing_is_deleted_where_that_would_not_be_enough() -> None:
    verdict = decide(FILES, 0, Limits(10**9, 500_000_000))

    assert verdict == Verdict(refusal=explain(Code.DISK_FULL, free_bytes=0, minimum_free_bytes=500_000_000))


@each("free_bytes", range(0, 200, 7))
@each("kept", range(8))
def test_after_the_deletions_both_limits_hold_or_recording_is_refused(free_bytes: int, kept: int) -> None:
    files = [StoredRecording(f"{k}", 20 + 13 * k, kept=bool(kept >> k & 1)) for k in range(3)]

    verdict = decide(files, free_bytes, LIMITS)

    gone = sum(file.size_bytes for file in files if file.name in verdict.delete)
    left = sum(file.size_bytes for file in files) - gone
    assert (verdict.refusal is None) == (left <= 100 and free_bytes + gone >= 50)
    assert not verdict.refusal or not verdict.delete
    assert not any(file.kept for file in files if file.name in verdict.delete)


def test_names_sort_by_time_and_hold_nothing_that_a_path_could_misread() -> None:
    assert file_name(1_790_000_000_000_000_000, "../Käfer 1") == "20260921T141320Z_---K-fer-1"
    assert file_name(10**18, "b") < file_name(10**18 + 10**9, "a")
    assert len(file_name(10**18, "x" * 300) + "_12.mcap") < 64
