from cli.solve.inputs import inputs_of
from shared.bus.bus import Envelope
from shared.messages.base import Message
from shared.messages.gnss import FixType, GnssFix, GnssRaw
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.navigation import TruthState
from shared.messages.trust import TrustLevel, TrustState
from shared.runtime.config import parse_vehicle
from tests.support.bus.envelopes import sent
from tests.support.drives.tracks import solution

VEHICLE = parse_vehicle("")


def envelope(message: Message) -> Envelope:
    return sent(message, getattr(message, "received_ns", 0))


def fix(stamp: int) -> GnssFix:
    return GnssFix(sampled_ns=stamp, received_ns=stamp, source="gnss", fix_type=FixType.NONE)


def samples(stamp: int) -> ImuSamples:
    return ImuSamples(
        received_ns=stamp, source="imu", sampled_ns=(stamp,), specific_force_body_m_s2=((0.0, 0.0, -9.8),),
        angular_rate_body_rad_s=((0.0, 0.0, 0.0),),
    )  # fmt: skip


def test_typed_messages_are_used_in_order_of_arrival_without_recorded_solutions() -> None:
    found = inputs_of(map(envelope, [fix(30), samples(10), solution(0.0), samples(20)]))
    assert list(found.messages(VEHICLE)) == [samples(10), samples(20), fix(30)]
    assert found.topics == {"gnss/fix": 1, "imu/sample": 2, "navigation/solution": 1}


def test_a_recorded_verdict_is_not_fed_for_the_run_makes_its_own() -> None:
    verdict = TrustState(
        sampled_ns=15, state=TrustLevel.UNSAFE, since_ns=15, row=1, reasons=("recorded",), gnss_excluded=True,
        alert_limit_horizontal_m=10.0, alert_limit_vertical_m=20.0,
    )  # fmt: skip
    found = inputs_of(map(envelope, [samples(10), verdict, fix(30)]))
    assert list(found.messages(VEHICLE)) == [samples(10), fix(30)] and found.topics["trust/state"] == 1


def test_raw_bytes_replace_the_derived_messages_of_each_sensor() -> None:
    raw = GnssRaw(received_ns=5, source="gnss", data=b"$")
    found = inputs_of(map(envelope, [raw, fix(30), samples(10)]))
    assert list(found.messages(VEHICLE)) == [raw, samples(10)], (
        "the fix is made of the bytes again; the samples have no bytes"
    )
    both = inputs_of(map(envelope, [raw, samples(10), ImuRaw(received_ns=9, source="imu", data=b"\xfa")]))
    assert [type(message) for message in both.messages(VEHICLE)] == [GnssRaw, ImuRaw]


def test_raw_bytes_are_ordered_by_their_arrival_at_the_driver() -> None:
    late = GnssRaw(received_ns=7, source="gnss", data=b"$")
    found = inputs_of([envelope(samples(6)), envelope(samples(8)), sent(late, 9)])
    assert list(found.messages(VEHICLE)) == [samples(6), late, samples(8)]


def test_an_undecodable_message_is_counted_once() -> None:
    found = inputs_of([Envelope("gnss/fix", b"{", 0), envelope(samples(1))])
    for _ in range(2):
        assert list(found.messages(VEHICLE)) == [samples(1)]
    assert len(found.undecodable) == 1


def test_true_states_are_stored_separately() -> None:
    state = TruthState(
        sampled_ns=1, latitude_deg=1.0, longitude_deg=2.0, height_ellipsoid_m=3.0, velocity_ned_m_s=(0.0, 0.0, 0.0),
        roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0, angular_rate_body_rad_s=(0.0, 0.0, 0.0),
    )  # fmt: skip
    found = inputs_of([envelope(state), envelope(samples(1))])
    assert found.truth == [state] and list(found.messages(VEHICLE)) == [samples(1)]
