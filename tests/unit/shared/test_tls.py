"""A server of another kind is named in words, and not by lines of OpenSSL's source."""

import contextlib
import secrets
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fleet.admission.authority import Authority
from shared.errors import UserError
from shared.evidence.signer import FileSigner
from shared.fleet.enrolling import command_for, enrol, new_secret
from shared.tls import reason_of
from tests.support.patience import HANGS_S

TOKEN = "secret." + "ab" * 16


@contextlib.contextmanager
def answering(answer: bytes, wrap: Callable[[socket.socket], socket.socket] = lambda link: link) -> Iterator[int]:
    """A server that answers the first connection with these bytes; gives its port."""

    def serve() -> None:
        with contextlib.suppress(OSError), listening.accept()[0] as link, wrap(link) as wrapped:
            wrapped.recv(4096)
            wrapped.sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve)
        thread.start()
        yield listening.getsockname()[1]
        thread.join(HANGS_S)


def refusal(port: int, to: Path) -> str:
    with pytest.raises(UserError) as caught:
        enrol(f"https://127.0.0.1:{port}", TOKEN, "car-1", to, FileSigner(b"a" * 32))
    return str(caught.value)


@pytest.mark.parametrize("answer", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"SSH-2.0-OpenSSH_9.2\r\n"])
def test_a_server_without_tls_is_named_with_what_to_try(tmp_path: Path, answer: bytes) -> None:
    with answering(answer) as port:
        said = refusal(port, tmp_path)
    assert f"no answer of a centre at 127.0.0.1:{port}: it does not speak TLS" in said
    assert "check the network, and the address with its port" in said
    assert "_ssl.c" not in said and "SSL:" not in said


def test_a_server_that_ends_the_connection_is_named(tmp_path: Path) -> None:
    with answering(b"") as port:
        assert "it ended the connection without an answer; check" in refusal(port, tmp_path)


def test_a_server_with_tls_that_speaks_no_http_is_named(tmp_path: Path) -> None:
    certificate, key = Authority(tmp_path / "authority").server(("127.0.0.1",))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    with answering(b"220 mail\r\n", lambda link: context.wrap_socket(link, server_side=True)) as port:
        assert "it does not speak HTTP, so it is another kind of server" in refusal(port, tmp_path / "uplink")


def test_a_certificate_that_is_not_accepted_is_told_with_its_reason() -> None:
    error = ssl.SSLCertVerificationError(1, "[SSL: CERTIFICATE_VERIFY_FAILED] certificate verify failed (_ssl.c:1006)")
    error.reason, error.verify_message = "CERTIFICATE_VERIFY_FAILED", "certificate has expired"
    assert reason_of(error) == "its certificate is not accepted: certificate has expired"


def test_what_openssl_says_otherwise_is_told_without_its_source() -> None:
    error = ssl.SSLError(1, "[SSL: NO_SHARED_CIPHER] no shared cipher (_ssl.c:1006)")
    error.reason = "NO_SHARED_CIPHER"
    assert reason_of(error) == "TLS fails: no shared cipher"
    assert reason_of(ConnectionRefusedError(111, "Connection refused")) == "Connection refused"
    assert reason_of(TimeoutError()) == "it does not answer in time"


@pytest.mark.parametrize(("vehicle", "end"), [("car-7", " --name car-7"), (None, ""), ("", "")])
def test_the_command_of_a_token_names_the_vehicle_that_it_is_for(vehicle: str | None, end: str) -> None:
    assert command_for("https://centre.example:8444", TOKEN, vehicle) == (
        f"obu enrol https://centre.example:8444 {TOKEN}{end}"
    )


def test_no_token_is_an_option_of_a_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(secrets, "token_bytes", lambda size: b"\xfb" * size)
    assert secrets.token_urlsafe(24).startswith("-")  # as a token once was made
    assert new_secret().isalnum()
