import zlib

from shared.page.stream.clients import QUEUE_FRAMES, Clients, Frame


def test_a_full_house_admits_nobody() -> None:
    clients = Clients(2)
    assert clients.enter() and clients.enter()
    assert clients.enter() is None


def test_leaving_makes_room() -> None:
    clients = Clients(1)
    first = clients.enter()
    assert first is not None
    clients.leave(first)
    assert clients.enter() is not None


def test_everyone_is_given_the_same_frame() -> None:
    clients = Clients(2)
    watching = [clients.enter(), clients.enter()]
    frame = Frame(b"frame")
    clients.broadcast(frame)
    assert all(client is not None and client.frames.get_nowait() is frame for client in watching)


def test_a_browser_that_does_not_read_is_let_go_and_the_others_go_on() -> None:
    clients = Clients(2)
    slow, quick = clients.enter(), clients.enter()
    assert slow is not None and quick is not None
    for number in range(QUEUE_FRAMES + 1):
        frame = Frame(str(number).encode())
        clients.broadcast(frame)
        assert quick.frames.get_nowait() is frame
    assert len(clients) == 1
    taken = [slow.frames.get_nowait() for _ in range(QUEUE_FRAMES)]
    assert taken[-1] is None, "the last word tells the sender to end"


def test_a_frame_is_compressed_once_for_all() -> None:
    frame = Frame(b"frame" * 100)
    assert zlib.decompress(frame.packed) == frame.plain
    assert frame.packed is frame.packed
    assert len(frame.packed) < len(frame.plain) / 10
