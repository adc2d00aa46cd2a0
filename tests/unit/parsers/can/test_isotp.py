"""The receiver of ISO 15765-2 against can-isotp, an independent sender, and against damaged sequences."""

from collections import Counter, deque

import isotp
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.parsers.can.candump import CanFrame
from services.parsers.can.isotp import FRAME_TIMEOUT_NS, MAX_MESSAGES, MessageJoiner
from services.parsers.can.standards import vin_of_answer

MS = 1_000_000
FLOW_CONTROL = isotp.CanMessage(arbitration_id=0x7E0, dlc=3, data=b"\x30\x00\x00")


def sent(payload: bytes, padding: int | None = None) -> list[bytes]:
    """Data of the frames that can-isotp sends for a message."""
    frames: list[bytes] = []
    inbox: deque[isotp.CanMessage] = deque()

    def transmit(message: isotp.CanMessage) -> None:
        frames.append(bytes(message.data))
        if message.data[0] >> 4 == 1:
            inbox.append(FLOW_CONTROL)

    layer = isotp.TransportLayerLogic(
        rxfn=lambda timeout: inbox.popleft() if inbox else None,
        txfn=transmit,
        address=isotp.Address(isotp.AddressingMode.Normal_11bits, rxid=0x7E0, txid=0x7E8),
        params={"tx_padding": padding, "stmin": 0},
    )
    layer.send(payload)
    while layer.transmitting() or not frames:
        layer.process()
    return frames


def joined(frames: list[bytes], rejects: Counter[str], step_ns: int = MS) -> list[bytes]:
    joiner = MessageJoiner(rejects)
    found = (joiner.take(CanFrame(k * step_ns, "can0", 0x7E8, False, data)) for k, data in enumerate(frames))
    return [message for message in found if message is not None]


@given(st.integers(1, 400), st.sampled_from([None, 0x00, 0x55, 0xAA]), st.randoms(use_true_random=False))
@settings(max_examples=40, deadline=None)
def test_messages_of_an_independent_sender_are_joined(length: int, padding: int | None, random_: object) -> None:
    payload = bytes(k * 7 % 256 for k in range(length))
    rejects = Counter[str]()
    assert joined(sent(payload, padding), rejects) == [payload]
    assert not rejects


def test_the_longest_message_is_joined() -> None:
    payload = bytes(k * 11 % 251 for k in range(4095))
    assert joined(sent(payload), Counter()) == [payload]


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_a_missing_frame_is_a_reject(missing: int) -> None:
    frames, rejects = sent(bytes(40)), Counter[str]()
    del frames[missing]
    assert not joined(frames, rejects)
    assert rejects == {"isotp_order": 1}


def test_a_late_frame_is_a_reject() -> None:
    rejects = Counter[str]()
    assert not joined(sent(bytes(12)), rejects, FRAME_TIMEOUT_NS + 1)
    assert rejects == {"isotp_timeout": 1}


@pytest.mark.parametrize("data", ["", "00", "0741", "100441424344454647", "1000414243444546", "10", "2141"])
def test_contradictory_lengths_give_no_message(data: str) -> None:
    rejects = Counter[str]()
    assert not joined([bytes.fromhex(data)], rejects)
    assert rejects.total() == (data[:1] in {"0", "1"})


def test_messages_that_never_end_are_bounded_and_make_room_when_they_are_old() -> None:
    rejects = Counter[str]()
    joiner = MessageJoiner(rejects)
    first = bytes.fromhex("100A414243444546")
    for identifier in range(3 * MAX_MESSAGES):
        joiner.take(CanFrame(0, "can0", identifier, False, first))
    assert len(joiner._messages) == MAX_MESSAGES and rejects["isotp_full"] == 2 * MAX_MESSAGES
    later = 2 * FRAME_TIMEOUT_NS
    joiner.take(CanFrame(later, "can0", 0x7E8, False, first))
    assert joiner.take(CanFrame(later, "can0", 0x7E8, False, b"\x21abcd")) == b"ABCDEFabcd"


@pytest.mark.parametrize(
    ("text", "vin"),
    [
        (b"WP0ZZZ99ZTS392124", "WP0ZZZ99ZTS392124"), (b"\x00\x00\x00WP0ZZZ99ZTS3921", None),
        (b"WP0ZZZ99ZTS39212O", None), (b"WP0ZZZ99ZTS39212", None), (b"\xff" * 17, None), (b"", None),
    ],
)  # fmt: skip
def test_a_vin_is_seventeen_characters_of_iso_3779(text: bytes, vin: str | None) -> None:
    assert vin_of_answer(b"\x49\x02\x01" + text) == vin


def test_a_frame_within_a_message_that_is_shorter_than_eight_bytes_ends_it() -> None:
    rejects: Counter[str] = Counter()
    first, second, *rest = sent(bytes(range(40)))
    assert joined([first, second[:5], *rest], rejects) == [] and rejects["isotp_length"] == 1
    assert joined([first, second, *rest], rejects) == [bytes(range(40))]
