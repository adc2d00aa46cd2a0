"""Messages of a recording for Foxglove, read by the reader of the MCAP library."""

import json
from math import atan2, cos, pi, sin
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import NavigationSolution
from shared.recording import Recording
from shared.recording.channels import RAW_FORMATS
from shared.recording.foxglove import Foxglove, quaternion_enu_from_flu
from shared.topics import TOPICS
from tests.support.bus.envelopes import sent
from tests.support.drives.meridian import (
    BEGIN_NS,
    LATITUDE_DEG,
    LONGITUDE_DEG,
    NORTH_M_S,
    SECOND,
    messages,
    record,
    solution,
)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("drive") / "drive.mcap", 10)


def test_every_message_for_foxglove_follows_the_schema_of_its_channel(drive: Path) -> None:
    counts: dict[str, int] = {}
    with drive.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if not channel.topic.startswith("foxglove/"):
                continue
            assert schema is not None and (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            described = json.loads(schema.data)
            described["required"], described["additionalProperties"] = list(described["properties"]), False
            jsonschema.validate(json.loads(message.data), described)
            counts[schema.name] = counts.get(schema.name, 0) + 1
    assert counts == {
        "foxglove.LocationFix": 100 + 10, "foxglove.PoseInFrame": 100, "foxglove.FrameTransform": 100,
    }  # fmt: skip


def test_track_and_attitude_are_those_of_the_solutions(drive: Path) -> None:
    with drive.open("rb") as file:
        found = {
            (channel.topic, message.log_time): json.loads(message.data)
            for _, channel, message in make_reader(file).iter_messages()
        }
    at_ns = BEGIN_NS + 5 * SECOND
    fix, transform = found["foxglove/solution", at_ns], found["foxglove/transform", at_ns]
    assert (fix["longitude"], fix["timestamp"]) == (LONGITUDE_DEG, {"sec": at_ns // SECOND, "nsec": 0})
    assert fix["latitude"] > LATITUDE_DEG
    assert transform["translation"]["y"] == pytest.approx(5 * NORTH_M_S, rel=1e-4), "y is north"
    assert transform["translation"]["x"] == pytest.approx(0.0, abs=1e-6)
    assert (transform["parent_frame_id"], transform["child_frame_id"]) == ("map", "base_link")


@pytest.mark.parametrize(("roll", "pitch", "yaw"), [(0.0, 0.0, 0.0), (0.1, -0.2, 1.3), (-0.7, 0.4, -2.9)])
def test_the_attitude_between_the_frames_of_ros_is_that_of_rotation_matrices(
    roll: float, pitch: float, yaw: float
) -> None:
    ned_from_frd = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    enu_from_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    frd_from_flu = np.diag([1.0, -1.0, -1.0])
    found = Rotation.from_quat(quaternion_enu_from_flu(roll, pitch, yaw)).as_matrix()
    np.testing.assert_allclose(found, enu_from_ned @ ned_from_frd @ frd_from_flu, atol=1e-12)
    forward = found @ [1.0, 0.0, 0.0]
    assert atan2(forward[1], forward[0]) == pytest.approx(atan2(sin(pi / 2 - yaw), cos(pi / 2 - yaw)))


def test_the_recording_reader_omits_foxglove_messages(drive: Path) -> None:
    with Recording(drive) as recording:
        assert len(list(recording)) == len(messages(10))
        assert not recording.problems


def test_the_channels_of_raw_bytes_name_their_content() -> None:
    assert set(RAW_FORMATS) == {topic.name for topic in TOPICS if topic.is_raw}


def test_positions_are_stamped_in_utc_as_the_receiver_stated_it() -> None:
    behind_ns, made = 3600 * SECOND, Foxglove()
    fix = GnssFix(
        sampled_ns=BEGIN_NS - behind_ns, received_ns=BEGIN_NS - behind_ns, source="gnss0", fix_type=FixType.THREE_D,
        latitude_deg=LATITUDE_DEG, longitude_deg=LONGITUDE_DEG, utc_ns=BEGIN_NS,
    )  # fmt: skip
    told: list[GnssFix | NavigationSolution] = [fix, solution(BEGIN_NS - behind_ns + SECOND)]
    found = {
        topic: json.loads(payload)["timestamp"]["sec"] * SECOND
        for sequence, message in enumerate(told, 1)
        for topic, payload in made.messages(sent(message, message.sampled_ns, "parsers.gnss", 1, sequence))
    }
    assert found["foxglove/gnss_fix"] == BEGIN_NS and found["foxglove/solution"] == BEGIN_NS + SECOND
    assert found["foxglove/pose"] == found["foxglove/transform"] == BEGIN_NS - behind_ns + SECOND
