"""One source against a fake caster, with a clock of the test's own."""

import socket
import ssl
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

import pytest

from cli.demo.local import free_port
from services.sensors.corrections import connection
from services.sensors.corrections import source as module
from services.sensors.corrections.address import parse
from services.sensors.corrections.gga import Position
from services.sensors.corrections.source import Source
from shared.messages.corrections import SourcePhase
from shared.messages.gnss import FixType, GnssFix
from shared.messages.trust import TrustLevel, TrustState
from tests.support.gnss.casters import FakeCaster, fake_caster, saying
from tests.support.gnss.frames import rtcm
from tests.support.patience import HANGS_S

NS = 1_000_000_000
DATA = rtcm(1005, 19)
ICY = b"ICY 200 OK\r\n\r\n"


class SourceWithClock:
    """A source whose clock the test moves; the network is real."""

    made: ClassVar[list["SourceWithClock"]] = []

    def __init__(self, url: str, **settings: str | float) -> None:
        self.made.append(self)
        self.position = Position()
        self.source = Source(parse(url, {"gga_period_s": 0.0, **settings}), self.position, jitter=lambda: 0.5)
        self.now_s = 1000.0
        self.data = b""

    def turn(self) -> None:
        self.data += self.source.turn(self.now_s, round(self.now_s * NS))

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + HANGS_S
        while not condition():
            assert time.monotonic() < deadline, self.source.statement(self.now_s)
            self.turn()
            time.sleep(0.002)

    def reaches(self, phase: SourcePhase) -> None:
        self.until(lambda: self.source.statement(self.now_s).phase is phase)

    @property
    def reason(self) -> str:
        return self.source.statement(self.now_s).reason

    @property
    def wait_s(self) -> float | None:
        return self.source.statement(self.now_s).next_attempt_s


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    while SourceWithClock.made:
        SourceWithClock.made.pop().source.release("end of the test")


def test_bytes_of_the_stream_arrive_and_the_end_is_followed_by_another_attempt() -> None:
    with fake_caster(saying(ICY + DATA)) as caster:
        run = SourceWithClock(caster.url())
        run.until(lambda: run.data == DATA)
        run.reaches(SourcePhase.WAITING)
        assert "closed the connection" in run.reason and run.wait_s == 2.0
        run.now_s += 2.1
        run.until(lambda: run.data == DATA * 2)


def test_a_caster_that_hangs_is_left_after_twenty_seconds() -> None:
    with fake_caster(saying(ICY + DATA, then_s=0.5)) as caster:
        run = SourceWithClock(caster.url())
        run.until(lambda: run.data == DATA)
        run.now_s += 19.0
        run.turn()
        assert run.source.statement(run.now_s).phase is SourcePhase.RECEIVING
        run.now_s += 2.0
        run.reaches(SourcePhase.WAITING)
        assert "sent nothing for 20 s" in run.reason


def test_a_wrong_password_is_tried_again_after_minutes_only() -> None:
    with fake_caster(saying(b"HTTP/1.1 401 Unauthorized\r\n\r\n")) as caster:
        run = SourceWithClock(caster.url(user="me"))
        run.reaches(SourcePhase.REFUSED)
        assert run.wait_s == 300.0 and "password_file" in run.reason
        for _ in range(50):
            run.now_s += 5.0
            run.turn()
        time.sleep(0.05)
        assert len(caster.requests) == 1


@pytest.mark.parametrize("answer", [b"ERROR - Bad Password\r\n", b"ERROR - Bad Password"])
def test_a_refusal_of_version_1_is_the_reason_alone(answer: bytes) -> None:
    with fake_caster(saying(answer)) as caster:
        run = SourceWithClock(caster.url(user="me"))
        run.reaches(SourcePhase.REFUSED)
        assert run.wait_s == 300.0 and "refuses user or password" in run.reason
        assert "is it an NTRIP caster" not in run.reason


def test_where_nothing_listens_no_caster_is_asked_about() -> None:
    run = SourceWithClock(f"ntrip://me@127.0.0.1:{free_port()}/M")
    run.reaches(SourcePhase.WAITING)
    assert "Connection refused; check the network, host and port" in run.reason
    assert "is it an NTRIP caster" not in run.reason


def test_the_delay_between_attempts_grows_to_a_minute() -> None:
    with fake_caster(saying(b"rubbish\r\n")) as caster:
        run = SourceWithClock(caster.url())
        waits = []
        for _ in range(6):
            run.reaches(SourcePhase.WAITING)
            waits.append(run.wait_s)
            run.now_s += (run.wait_s or 0.0) + 0.1
            run.turn()
        assert waits == [2.0, 5.0, 10.0, 30.0, 60.0, 60.0]


def test_an_old_caster_that_hangs_up_at_version_2_is_asked_in_version_1() -> None:
    with fake_caster(saying(b""), saying(ICY + DATA)) as caster:
        run = SourceWithClock(caster.url())
        run.reaches(SourcePhase.WAITING)
        run.now_s += 3.0
        run.until(lambda: run.data == DATA)
        assert b"HTTP/1.1" in caster.requests[0] and b"HTTP/1.0" in caster.requests[1]


def test_a_source_that_floods_is_left() -> None:
    def flood(connection: socket.socket, _request: bytes) -> None:
        connection.sendall(ICY + bytes(3_000_000))

    with fake_caster(flood) as caster:
        run = SourceWithClock(caster.url())
        run.reaches(SourcePhase.WAITING)
        assert "far more than corrections need" in run.reason and len(run.data) <= module.BURST_BYTES


def test_a_port_without_a_caster_and_an_unknown_host_are_said() -> None:
    run = SourceWithClock(f"ntrip://127.0.0.1:{free_port()}/M")
    run.reaches(SourcePhase.WAITING)
    assert "cannot connect" in run.reason
    run = SourceWithClock("ntrip://no-such-host.invalid/M")
    run.reaches(SourcePhase.WAITING)
    assert "cannot find no-such-host.invalid" in run.reason


def test_each_address_of_a_host_has_its_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first refuses; the second does not answer: a server whose queue of connections is full; the third does."""
    with (
        fake_caster(saying(ICY + DATA, then_s=0.2)) as caster,
        socket.create_server(("127.0.0.1", 0), backlog=0) as deaf,
        socket.create_connection(deaf.getsockname()),
    ):
        ports = (free_port(), deaf.getsockname()[1], caster.port)
        rows = [(socket.AF_INET, socket.SOCK_STREAM, 0, "", ("127.0.0.1", port)) for port in ports]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_args, **_options: rows)
        monkeypatch.setattr(connection, "ADDRESS_S", 0.1)
        run = SourceWithClock(caster.url())
        run.until(lambda: run.data == DATA)


def fix(now_s: float, **values: object) -> GnssFix:
    stamp = round(now_s * NS)
    return GnssFix.model_validate({
        "sampled_ns": stamp, "received_ns": stamp, "source": "gnss0", "fix_type": FixType.THREE_D,
        "latitude_deg": 48.117300, "longitude_deg": -11.516667, "utc_ns": 45_319 * NS, **values,
    })  # fmt: skip


def verdict(now_s: float, state: TrustLevel) -> TrustState:
    return TrustState(
        sampled_ns=round(now_s * NS), state=state, since_ns=0, row=0, reasons=(), alert_limit_horizontal_m=10.0,
        alert_limit_vertical_m=20.0,
    )  # fmt: skip


def listening(caster: list[FakeCaster]) -> Callable[[socket.socket, bytes], None]:
    def answer(connection: socket.socket, _request: bytes) -> None:
        connection.sendall(ICY)
        caster[0].listen(connection, 2.0)

    return answer


def test_a_caster_is_told_the_position_periodically_and_never_while_the_verdict_is_unsafe() -> None:
    known: list[FakeCaster] = []
    with fake_caster(listening(known)) as caster:
        known.append(caster)
        run = SourceWithClock(caster.url(), gga_period_s=10.0)
        run.position.note(verdict(run.now_s, TrustLevel.UNSAFE))
        run.position.note(fix(run.now_s))
        run.until(lambda: len(caster.requests) == 1)
        for _ in range(20):
            run.turn()
            time.sleep(0.005)
        assert b"GPGGA" not in caster.requests[0] + caster.received
        run.position.note(verdict(run.now_s, TrustLevel.SAFE))
        run.until(lambda: caster.received.count(b"$GPGGA") == 1)
        assert (
            caster.received
            == b"$GPGGA,123519.00,4807.03800,N,01131.00002,W,1,00,1.0,0.00,M,0.00,M,,*" + caster.received[-4:]
        )
        run.now_s += 9.0
        run.position.note(fix(run.now_s))
        run.turn()
        run.now_s += 1.1
        run.until(lambda: caster.received.count(b"$GPGGA") == 2)


def test_an_old_fix_or_one_without_a_position_is_not_told() -> None:
    position = Position()
    position.note(fix(1000.0))
    assert position.gga(1005 * NS) and position.location(1005 * NS) == (48.1173, -11.516667)
    assert position.gga(1011 * NS) is None
    position = Position()
    position.note(fix(1000.0, fix_type=FixType.NONE))
    assert position.gga(1000 * NS) is None


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a certificate of its own authority for 127.0.0.1."""
    import shutil
    import subprocess

    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed: apt install openssl")
    path = tmp_path_factory.mktemp("tls") / "caster.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
         "-subj", "/CN=caster", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", path, "-out", f"{path}.crt"],
        check=True, capture_output=True,
    )  # fmt: skip
    return path


@pytest.mark.parametrize("trusted", [True, False])
def test_tls_is_spoken_with_a_caster_whose_certificate_is_trusted_and_with_no_other(
    certificate: Path, trusted: bool
) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(f"{certificate}.crt", certificate)

    def answer(connection: socket.socket, _request: bytes) -> None:
        with context.wrap_socket(connection, server_side=True) as encrypted:
            encrypted.recv(4096)
            encrypted.sendall(ICY + DATA)
            encrypted.settimeout(1.0)
            encrypted.recv(1)

    def tolerant(connection: socket.socket, request: bytes) -> None:
        with suppress(OSError):  # the client has left
            answer(connection, request)

    with fake_caster(tolerant) as caster:
        caster.raw = True
        run = SourceWithClock(
            caster.url().replace("ntrip:", "ntrips:"), **({"ca_file": f"{certificate}.crt"} if trusted else {})
        )
        if trusted:
            run.until(lambda: run.data == DATA)
        else:
            run.reaches(SourcePhase.WAITING)
            assert "is not who it should be" in run.reason and run.data == b""
            assert run.wait_s == 30.0 and "is it an NTRIP caster" not in run.reason
