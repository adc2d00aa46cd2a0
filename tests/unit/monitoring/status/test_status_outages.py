from services.monitoring.status.outages import LENGTH, OutageBook
from shared.messages.operation import Outage

S = 10**9


def observe(book: OutageBook, now_ns: int, found: dict[str, tuple[int, str]]) -> None:
    book.observe(now_ns, found, {what: cause for what, (_, cause) in found.items()})


def test_an_outage_is_open_until_what_was_lost_is_back() -> None:
    book = OutageBook()
    observe(book, 10 * S, {"imu/raw": (8 * S, "no bytes")})
    assert book.open() == [Outage(what="imu/raw", since_ns=8 * S, until_ns=None, cause="no bytes")]
    observe(book, 12 * S, {"imu/raw": (8 * S, "no bytes")})
    observe(book, 15 * S, {})
    assert book.open() == []
    assert book.closed() == [Outage(what="imu/raw", since_ns=8 * S, until_ns=15 * S, cause="no bytes")]


def test_two_observers_of_one_loss_make_one_entry_and_the_health_process_words_it() -> None:
    book = OutageBook()
    observe(book, 10 * S, {"imu/raw": (8 * S, "ours")})
    book.report(Outage(what="imu/raw", since_ns=9 * S, until_ns=None, cause="theirs"))
    assert [outage.cause for outage in book.open()] == ["theirs"]
    book.report(Outage(what="imu/raw", since_ns=9 * S, until_ns=14 * S, cause="theirs"))
    observe(book, 15 * S, {})
    assert [(outage.cause, outage.until_ns) for outage in book.closed()] == [("theirs", 14 * S)]


def test_a_report_that_comes_after_our_own_entry_replaces_it() -> None:
    book = OutageBook()
    observe(book, 10 * S, {"core.fusion": (8 * S, "ours")})
    observe(book, 15 * S, {})
    book.report(Outage(what="core.fusion", since_ns=9 * S, until_ns=15 * S, cause="theirs"))
    assert [outage.cause for outage in book.closed()] == ["theirs"]


def test_a_second_loss_of_the_same_thing_is_a_second_entry() -> None:
    book = OutageBook()
    for start in (10, 60):
        observe(book, start * S, {"can/raw": (start * S, "unplugged")})
        observe(book, (start + 5) * S, {})
    assert [outage.since_ns for outage in book.closed()] == [60 * S, 10 * S]


def test_a_dead_reporter_cannot_leave_an_outage_open() -> None:
    book = OutageBook()
    book.report(Outage(what="core.fusion", since_ns=S, until_ns=None, cause="theirs"))
    observe(book, 2 * S, {})
    assert book.open() == []
    observe(book, 400 * S, {"core.fusion": (399 * S, "ours")})
    assert [outage.since_ns for outage in book.open()] == [399 * S], "nor make a later one longer"


def test_the_book_forgets_the_oldest() -> None:
    book = OutageBook()
    for i in range(LENGTH + 10):
        observe(book, 100 * i * S, {"can/raw": (100 * i * S, "x")})
        observe(book, (100 * i + 1) * S, {})
    assert len(book.closed()) == LENGTH
    assert book.closed()[-1].since_ns == 1000 * S


def test_an_outage_whose_cause_becomes_known_goes_on_under_that_cause() -> None:
    book = OutageBook()
    book.observe(2 * S, {"imu/sample": (S, "parsers.imu says nothing")}, {"imu/sample": "parsers.imu says nothing"})
    silent = "parsers.imu is silent"
    book.observe(3 * S, {"parsers.imu": (S, silent)}, {"parsers.imu": silent, "imu/sample": silent})
    assert [(o.what, o.since_ns, o.cause) for o in book.open()] == [
        ("imu/sample", S, silent),
        ("parsers.imu", S, silent),
    ]
