import pytest

from cli.recordings.device_data import inputs_among, shifted
from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.messages.base import Message
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.vehicle import CanRaw
from tests.support.bus.envelopes import sent

SECOND = 1_000_000_000
THEN_NS = 1_600_000_000 * SECOND
SHIFT_NS = 190_000_000 * SECOND + 123_456_789


def moved(message: Message) -> Message:
    return shifted(sent(message, THEN_NS), SHIFT_NS)


def test_device_bytes_are_replayed_and_messages_derived_from_them_are_not() -> None:
    everything = {"gnss/raw", "gnss/fix", "gnss/satellites", "imu/raw", "imu/sample", "navigation/solution"}

    assert inputs_among(everything) == {"gnss/raw", "imu/raw"}


def test_measurements_are_replayed_where_their_bytes_are_missing() -> None:
    assert inputs_among({"imu/sample", "gnss/raw", "gnss/fix", "vehicle/speed"}) == {
        "imu/sample",
        "gnss/raw",
        "vehicle/speed",
    }


def test_states_solutions_and_commands_are_not_replayed() -> None:
    assert inputs_among({"mode/state", "navigation/solution", "gnss/configure", "gnss/write", "origin/state"}) == set()


def test_the_truth_of_a_simulation_is_replayed() -> None:
    assert inputs_among({"truth/state"}) == {"truth/state"}


def test_bytes_are_unchanged_and_their_stamp_is_shifted() -> None:
    raw = ImuRaw(received_ns=THEN_NS, source="imu0", data=b"\xfa\xff\0(1.2)")

    assert moved(raw) == raw.model_copy(update={"received_ns": THEN_NS + SHIFT_NS})


def test_all_stamps_of_a_measurement_are_shifted_and_gnss_time_is_unchanged() -> None:
    fix = GnssFix(
        sampled_ns=THEN_NS - 5, received_ns=THEN_NS, source="a", fix_type=FixType.THREE_D, gps_time_ns=7, utc_ns=THEN_NS
    )
    samples = ImuSamples(
        received_ns=THEN_NS,
        source="imu0",
        sampled_ns=(THEN_NS - 9, THEN_NS - 3),
        specific_force_body_m_s2=((0.0, 0.0, -9.8),) * 2,
        angular_rate_body_rad_s=((0.0, 0.0, 0.0),) * 2,
    )

    assert moved(fix) == fix.model_copy(
        update={"sampled_ns": THEN_NS - 5 + SHIFT_NS, "received_ns": THEN_NS + SHIFT_NS}
    )
    assert moved(samples) == samples.model_copy(
        update={
            "received_ns": THEN_NS + SHIFT_NS,
            "sampled_ns": (THEN_NS - 9 + SHIFT_NS, THEN_NS - 3 + SHIFT_NS),
        }
    )


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"(1600000000.250000) can0 7E8#03410D32\n", b"(1790000000.373456) can0 7E8#03410D32\n"),
        (b"(1600000000.250000000) can0 123#00\n", b"(1790000000.373456789) can0 123#00\n"),
        (b"(1600000000.9) a 1#\n(1600000001.0) b 2#\n", b"(1790000001.023456) a 1#\n(1790000001.123456) b 2#\n"),
    ],
)
def test_the_times_in_a_candump_log_are_shifted(before: bytes, after: bytes) -> None:
    message = moved(CanRaw(received_ns=THEN_NS, source="can0", data=before))

    assert isinstance(message, CanRaw)
    assert message.data == after


def test_an_undecodable_message_is_rejected() -> None:
    with pytest.raises(BadPayload):
        shifted(Envelope("gnss/fix", b"{", THEN_NS), SHIFT_NS)
