from services.commands.solving.inputs import inputs_of
from shared.bus import Envelope
from shared.codec import encode, topic_name
from shared.messages import FixType, GnssFix, GnssRaw, ImuRaw, ImuSamples, Message
from tests.support.tracks import solution


def envelope(message: Message) -> Envelope:
    payload, properties = encode(message)
    return Envelope(topic_name(message), payload, properties, 0)


def fix(stamp: int) -> GnssFix:
    return GnssFix(sampled_ns=stamp, received_ns=stamp, source="gnss", fix_type=FixType.NONE)


def samples(stamp: int) -> ImuSamples:
    return ImuSamples(
        received_ns=stamp, source="imu", sampled_ns=(stamp,), specific_force_body_m_s2=((0.0, 0.0, -9.8),),
        angular_rate_body_rad_s=((0.0, 0.0, 0.0),),
    )  # fmt: skip


def test_typed_messages_are_used_in_order_of_arrival_and_old_solutions_are_not() -> None:
    found = inputs_of(map(envelope, [fix(30), samples(10), solution(0.0), samples(20)]))
    assert found.messages == [samples(10), samples(20), fix(30)]
    assert found.topics == {"gnss/fix": 1, "imu/sample": 2, "navigation/solution": 1}


def test_raw_bytes_replace_what_was_made_of_them_one_sensor_at_a_time() -> None:
    raw = GnssRaw(received_ns=5, source="gnss", data=b"$")
    found = inputs_of(map(envelope, [raw, fix(30), samples(10)]))
    assert found.messages == [raw, samples(10)], "the fix is made of the bytes again; the samples have no bytes"
    both = inputs_of(map(envelope, [raw, samples(10), ImuRaw(received_ns=9, source="imu", data=b"\xfa")]))
    assert [type(message) for message in both.messages] == [GnssRaw, ImuRaw]


def test_a_message_that_cannot_be_decoded_is_counted() -> None:
    found = inputs_of([Envelope("gnss/fix", b"{", {}, 0), envelope(samples(1))])
    assert found.undecodable == 1 and len(found.messages) == 1
