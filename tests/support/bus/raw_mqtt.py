"""An MQTT 3.1.1 client of bare bytes, for packets that a valid client does not send."""

import socket


def string(text: str) -> bytes:
    """Write a UTF-8 string with its length."""
    raw = text.encode()
    return len(raw).to_bytes(2) + raw


def packet(first: int, body: bytes) -> bytes:
    """Write a packet of less than 16 kB."""
    size = len(body)
    return bytes((first, size) if size < 128 else (first, size % 128 | 128, size // 128)) + body


def connect_packet(client_id: str, user: str, password: str | None = None) -> bytes:
    """Write a CONNECT with clean session, keep-alive 60 s, a user name and perhaps a password."""
    head = string("MQTT") + (b"\x04\x82\0\x3c" if password is None else b"\x04\xc2\0\x3c")
    fields = (client_id, user) if password is None else (client_id, user, password)
    return packet(0x10, head + b"".join(map(string, fields)))


def subscribe(pattern: str, qos: int = 0) -> bytes:
    """Write a SUBSCRIBE with packet identifier 1."""
    return packet(0x82, b"\0\1" + string(pattern) + bytes((qos,)))


def connect(port: int, client_id: str, user: str) -> socket.socket:
    """Connect and read the CONNACK of the broker."""
    raw = socket.create_connection(("127.0.0.1", port), timeout=2)
    raw.sendall(connect_packet(client_id, user))
    answer = raw.recv(200)
    assert answer[0] == 0x20, answer
    assert answer[3] == 0, answer
    return raw


def read_all(raw: socket.socket, silent_after_s: float = 0.3) -> bytes:
    """Read until the other side is silent or has closed."""
    raw.settimeout(silent_after_s)
    chunks = []
    try:
        while chunk := raw.recv(1 << 20):
            chunks.append(chunk)
    except (TimeoutError, ConnectionResetError):
        pass
    return b"".join(chunks)
