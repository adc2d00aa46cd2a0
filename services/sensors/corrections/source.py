"""One source of corrections: connects, waits, gives up and tries again, and says what it is doing."""

import random
from collections.abc import Callable
from typing import Protocol

from shared.messages.corrections import CorrectionSource, SourcePhase

from .address import Address, password_of
from .connection import Connection, SerialConnection, TcpConnection, context_of
from .fault import ConnectionEnded, SourceFault
from .gga import Position
from .mqtt import MqttDialogue
from .ntrip import NtripDialogue

CONNECT_S = 15.0  # for look-up, TCP, TLS and the answer
HANG_S = 20.0  # without a byte: base stations send every second, SPARTN services every five
UNLOCATED_HANG_S = 120.0  # of a caster that may wait for a position, and was told none yet
BACK_OFF_S = (2.0, 5.0, 10.0, 30.0, 60.0)
SPREAD = 0.2  # of the back-off, so that vehicles do not return to a caster all at once
STABLE_AFTER_S = 60.0  # of data, after which the back-off begins anew
# Corrections of all constellations at 1 Hz are 2 to 4 kB/s; a source that sends ten times that sends something else.
MOST_BYTES_S, BURST_BYTES = 32_768.0, 262_144.0


class Dialogue(Protocol):
    """What is said over a connection."""

    streaming: bool

    def request(self, gga: str | None = None) -> bytes:
        """What is sent first."""
        ...

    def feed(self, data: bytes) -> bytes:
        """Process received bytes; return those of the stream."""
        ...

    def answer(self, now_s: float) -> bytes:
        """What is to be sent by now."""
        ...

    def ended(self, fault: SourceFault) -> SourceFault:
        """Explain the end of the connection."""
        ...


class RawDialogue:
    """Nothing is said: the peer sends frames."""

    streaming = True

    def request(self, gga: str | None = None) -> bytes:
        """Nothing is sent."""
        return b""

    def feed(self, data: bytes) -> bytes:
        """All bytes are of the stream."""
        return data

    def answer(self, now_s: float) -> bytes:
        """Nothing is sent."""
        return b""

    def ended(self, fault: SourceFault) -> SourceFault:
        """The fault says all."""
        return fault


class Source:
    """The connection to one source; `turn` does all the work and never blocks.

    Parameters
    ----------
    address : Address
        Where it is.
    position : Position
        What an NTRIP caster is told of the vehicle.
    jitter : callable
        Gives random numbers from 0 to 1.
    """

    def __init__(self, address: Address, position: Position, jitter: Callable[[], float] = random.random) -> None:
        self.address = address
        self.wanted_since_s: float | None = None
        self.connection: Connection | None = None
        self.fault: str | None = None  # of the last attempt, until bytes come
        self._position, self._jitter = position, jitter
        self._dialogue: Dialogue = RawDialogue()
        self.phase, self._reason = SourcePhase.IDLE, "not needed yet"
        self._received_bytes = self._connections = self._attempts = 0
        self._version = address.version or 2
        self._next_s = 0.0  # time of the next attempt
        self._begun_s = self._heard_s = self._streaming_s = 0.0
        self._asked = self._told = False
        self._gga_due_s = 0.0
        self._allowance, self._allowed_s = BURST_BYTES, 0.0

    def turn(self, now_s: float, now_ns: int) -> bytes:
        """Do what is due; return the bytes of the stream.

        Parameters
        ----------
        now_s : float
            [s] Monotonic clock.
        now_ns : int
            [ns] OBU time line, of the positions.
        """
        if self.wanted_since_s is None:
            self.wanted_since_s = now_s
        try:
            return self._turn(now_s, now_ns)
        except ConnectionEnded as fault:
            self._lose(self._dialogue.ended(fault), now_s)
        except SourceFault as fault:
            self._lose(fault, now_s)
        return b""

    def release(self, reason: str) -> None:
        """Close the connection, since it is not needed."""
        self._close()
        self.wanted_since_s = self.fault = None
        self.phase, self._reason = SourcePhase.IDLE, reason

    def statement(self, now_s: float) -> CorrectionSource:
        """State what the source is doing."""
        waits = self.phase in (SourcePhase.WAITING, SourcePhase.REFUSED)
        return CorrectionSource(
            source=self.address.name, phase=self.phase, reason=self._reason[:400],
            received_bytes=self._received_bytes, connections=self._connections,
            next_attempt_s=round(max(self._next_s - now_s, 0.0), 1) if waits else None,
        )  # fmt: skip

    def _turn(self, now_s: float, now_ns: int) -> bytes:
        if self.connection is None:
            if now_s < self._next_s:
                return b""
            self._begin(now_s, now_ns)
        assert self.connection is not None
        if not self.connection.opened():
            self._check_silence(now_s)
            return b""
        if not self._asked:
            self._ask(now_s, now_ns)
        received = self.connection.read()
        if received:
            self._heard_s = now_s
        stream = self._dialogue.feed(received) if received else b""
        self._note(stream, now_s)
        if answer := self._dialogue.answer(now_s):
            self.connection.write(answer)
        self._tell(now_s, now_ns)
        self._check_silence(now_s)
        return stream

    def _begin(self, now_s: float, now_ns: int) -> None:
        address = self.address
        self._begun_s = self._heard_s = now_s
        self._asked = self._told = False
        self._streaming_s, self._allowance, self._allowed_s = 0.0, BURST_BYTES, now_s
        self.phase, self._reason = SourcePhase.CONNECTING, "connecting"
        self._dialogue = RawDialogue()
        if address.is_ntrip:
            location = self._position.location(now_ns)
            self._dialogue = NtripDialogue(address, password_of(address), self._version, location)
        elif address.topics:
            self._dialogue = MqttDialogue(address, password_of(address))
        self.connection = SerialConnection(address) if address.scheme == "serial" else TcpConnection(
            address, context_of(address)
        )  # fmt: skip

    def _ask(self, now_s: float, now_ns: int) -> None:
        assert self.connection is not None
        gga = self._position.gga(now_ns) if self.address.gga_period_s else None
        self.connection.write(self._dialogue.request(gga))
        self._asked = True
        self._connections += 1
        self._heard_s = now_s
        if self.phase is SourcePhase.CONNECTING:
            self.phase, self._reason = SourcePhase.CONNECTED, "connected, no data yet"

    def _note(self, stream: bytes, now_s: float) -> None:
        """Account for bytes of the stream; a source that floods is left."""
        self._allowance = min(self._allowance + (now_s - self._allowed_s) * MOST_BYTES_S, BURST_BYTES) - len(stream)
        self._allowed_s = now_s
        if self._allowance < 0.0:
            raise SourceFault(
                f"{self.address.name} sends more than {MOST_BYTES_S / 1000:.0f} kB/s, far more than corrections need"
            )
        if not stream:
            return
        self._received_bytes += len(stream)
        self.phase, self._reason, self.fault = SourcePhase.RECEIVING, "receiving", None
        self._streaming_s = self._streaming_s or now_s
        if now_s - self._streaming_s >= STABLE_AFTER_S:
            self._attempts = 0

    def _tell(self, now_s: float, now_ns: int) -> None:
        """Send the position to a caster, at first and periodically."""
        period_s = self.address.gga_period_s
        if not (period_s and self.address.is_ntrip and self._dialogue.streaming and now_s >= self._gga_due_s):
            if not self._told:
                self._gga_due_s = min(self._gga_due_s, now_s)
            return
        sentence = self._position.gga(now_ns)
        if sentence is None:
            return
        assert self.connection is not None
        self.connection.write(sentence.encode())
        self._told, self._gga_due_s = True, now_s + period_s

    def _check_silence(self, now_s: float) -> None:
        if self.phase is SourcePhase.CONNECTING and now_s - self._begun_s > CONNECT_S:
            raise SourceFault(f"cannot connect to {self._where()}: no answer; check the network, host and port")
        waits = self.address.is_ntrip and self.address.gga_period_s and not self._told and not self._streaming_s
        limit_s = UNLOCATED_HANG_S if waits and self._dialogue.streaming else HANG_S
        if now_s - self._heard_s > limit_s:
            raise ConnectionEnded(f"{self._where()} sent nothing for {limit_s:.0f} s")

    def _where(self) -> str:
        return f"{self.address.host}:{self.address.port}" if self.address.host else self.address.name

    def _lose(self, fault: SourceFault, now_s: float) -> None:
        """Close the connection until the next attempt."""
        self._close()
        if fault.older and self.address.version is None:
            self._version = 1 if self._version == 2 else 2
        elif self.address.version is None and not fault.refused and not self._streaming_s:
            self._version = 2
        wait_s = fault.wait_s
        if wait_s is None:
            wait_s = BACK_OFF_S[min(self._attempts, len(BACK_OFF_S) - 1)]
            self._attempts += 1
        self._next_s = now_s + wait_s * (1.0 + SPREAD * (2.0 * self._jitter() - 1.0))
        self.fault = str(fault)
        self.phase = SourcePhase.REFUSED if fault.refused else SourcePhase.WAITING
        self._reason = self.fault

    def _close(self) -> None:
        if self.connection is not None:
            self.connection.close()
            self.connection = None
