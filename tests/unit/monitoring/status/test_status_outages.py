from services.monitoring.status.outages import LENGTH, OutageBook
from shared.messages import Outage

S = 10**9


def test_an_outage_is_open_until_what_was_lost_is_back() -> None:
    book = OutageBook()
    book.observe(10 * S, {"imu/raw": (8 * S, "no bytes")})
    assert book.open() == [Outage(what="imu/raw", since_ns=8 * S, until_ns=None, cause="no bytes")]
    book.observe(12 * S, {"imu/raw": (8 * S, "no bytes")})
    book.observe(15 * S, {})
    assert book.open() == []
    assert book.closed() == [Outage(what="imu/raw", since_ns=8 * S, until_ns=15 * S, cause="no bytes")]


def test_two_observers_of_one_loss_make_one_entry_and_the_health_process_words_it() -> None:
    book = OutageBook()
    book.observe(10 * S, {"imu/raw": (8 * S, "ours")})
    book.report(Outage(what="imu/raw", since_ns=9 * S, until_ns=None, cause="theirs"))
    assert [outage.cause for outage in book.open()] == ["theirs"]
    book.report(Outage(what="imu/raw", since_ns=9 * S, until_ns=14 * S, cause="theirs"))
    book.observe(15 * S, {})
    assert [(outage.cause, outage.until_ns) for outage in book.closed()] == [("theirs", 14 * S)]


def test_a_report_that_comes_after_our_own_entry_replaces_it() -> None:
    book = OutageBook()
    book.observe(10 * S, {"core.fusion": (8 * S, "ours")})
    book.observe(15 * S, {})
    book.report(Outage(what="core.fusion", since_ns=9 * S, until_ns=15 * S, cause="theirs"))
    assert [outage.cause for outage in book.closed()] == ["theirs"]


def test_a_second_loss_of_the_same_thing_is_a_second_entry() -> None:
    book = OutageBook()
    for start in (10, 60):
        book.observe(start * S, {"can/raw": (start * S, "unplugged")})
        book.observe((start + 5) * S, {})
    assert [outage.since_ns for outage in book.closed()] == [60 * S, 10 * S]


def test_a_dead_reporter_cannot_leave_an_outage_open() -> None:
    book = OutageBook()
    book.report(Outage(what="core.fusion", since_ns=S, until_ns=None, cause="theirs"))
    book.observe(2 * S, {})
    assert book.open() == []


def test_the_book_forgets_the_oldest() -> None:
    book = OutageBook()
    for i in range(LENGTH + 10):
        book.observe(100 * i * S, {"can/raw": (100 * i * S, "x")})
        book.observe((100 * i + 1) * S, {})
    assert len(book.closed()) == LENGTH
    assert book.closed()[-1].since_ns == 1000 * S
