"""The recorder: every message as it travelled, into files that leave room on the disk."""

import logging
import time
from collections.abc import Mapping

from pydantic import Field

from shared.bus.bus import Bus, Envelope, decoded
from shared.evidence import KeyFile, keys_folder
from shared.messages.explanation import QUOTED_LENGTH, Explanation, QuotedText, explain
from shared.messages.operation import ModeState, RecordingState
from shared.messages.power import LowReason
from shared.processes import Role
from shared.recording.folder import RecordingFolder
from shared.recording.writer import Opener, open_new
from shared.runtime.config import Section, parse_vehicle
from shared.topics import TOPICS
from shared.words.words import reason

from .codes import Code
from .quota import Quota
from .retention import Limits, decide, file_name

log = logging.getLogger(__name__)

CONNECT_S = 2.0  # after which a recorder without a broker opens its file as well
STATE_NS, RETRY_NS = 1_000_000_000, 5_000_000_000
PAUSE_S = 0.02  # between two looks at the bus: most of a message's cost is to wake up for it
BUSY = 16  # messages of one look, after which the next one follows at once


class Config(Section):
    """Where recordings go, how they are cut into files, and how much room they may take."""

    folder: str = Field(
        default="recordings",
        description="folder of the recordings, below the state folder unless absolute; made if its parent exists",
    )
    chunk_bytes: int = Field(
        default=256 * 1024, gt=0, le=8 * 1024**2, description="size of a chunk, the unit of compression and of reading"
    )
    flush_period_s: float = Field(
        default=0.5,
        gt=0,
        description="period of passing data to the operating system: what a crash of the recorder loses at most",
    )
    rotate_bytes: int = Field(default=256 * 1024**2, gt=0, description="size at which a new recording is begun")
    rotate_period_s: float = Field(default=3600.0, gt=0, description="duration after which a new recording is begun")
    maximum_total_bytes: int = Field(
        default=8 * 1024**3, gt=0, description="size of all recordings above which the oldest are deleted"
    )
    minimum_free_bytes: int = Field(
        default=512 * 1024**2, ge=0, description="free disk space below which the oldest recordings are deleted"
    )
    maximum_topic_bytes_per_s: float = Field(
        default=512 * 1024,
        gt=0,
        description="lasting rate of a topic, and half of that of a process, above which its messages are left out; an "
        "eighth of `maximum_total_bytes` may come at once. Uncompressed",
    )


POWER_ENDS: Mapping[LowReason | None, Code] = {
    LowReason.CHARGE: Code.CHARGE_ENDS,
    LowReason.AUTONOMY: Code.AUTONOMY_ENDS,
    LowReason.TIME: Code.BATTERY_TIME_ENDS,
}


class Process:
    """Writes message by message without decoding; a full disk stops it with a reason until there is room."""

    def __init__(self, config: Config, opener: Opener = open_new) -> None:
        self._config, self._opener = config, opener
        self._limits = Limits(config.maximum_total_bytes, config.minimum_free_bytes)
        self._quota = Quota(config.maximum_topic_bytes_per_s, config.maximum_total_bytes)
        self._kept_out: set[str] = set()
        self._reason: Explanation | None = None
        self._power_ends = False
        self._opened_ns = self._flush_ns = self._state_ns = self._retry_ns = 0

    def run(self, bus: Bus) -> None:
        """Record until `bus.stopping`; a road-side unit keeps nothing that describes other road users."""
        if parse_vehicle(bus.vehicle_toml).role is Role.RSU:
            self._kept_out = {topic.name for topic in TOPICS if topic.personal}
        key = KeyFile(keys_folder(bus.state_dir))
        self._folder = RecordingFolder(bus.state_dir / self._config.folder, self._opener, key.signer)
        waiting = envelopes = _connect(bus)
        while not bus.stopping:
            if bus.now_ns() >= self._state_ns:
                self._state_ns = bus.now_ns() + STATE_NS
                self._enforce_limits(bus)
                bus.publish(self._state(bus))
            if len(envelopes) < BUSY:
                time.sleep(PAUSE_S)
            envelopes = [*waiting, *bus.receive(0.1)]
            waiting = []
            self._write(envelopes, bus)
            self._close_before_power_off(bus, envelopes)
        self._write(bus.receive(0.0), bus)
        self._close()

    def _write(self, envelopes: list[Envelope], bus: Bus) -> None:
        now_ns = bus.now_ns()
        admitted = self._quota.admitted((e for e in envelopes if e.topic not in self._kept_out), now_ns)
        if self._quota.left_out:
            bus.rejects["flood"] = self._quota.left_out
        try:
            self._folder.write(admitted)
            if now_ns >= self._flush_ns:
                self._flush_ns = now_ns + round(self._config.flush_period_s * 1e9)
                self._folder.flush()
        except OSError as error:
            self._stop(explain(Code.CANNOT_WRITE, error=_quoted(error.strerror)), now_ns)

    def _close_before_power_off(self, bus: Bus, envelopes: list[Envelope]) -> None:
        """Close the file when the mode says that the power ends; a mode that the broker has kept is of another time."""
        for envelope in envelopes:
            if envelope.topic != "mode/state" or envelope.retained:
                continue
            mode = decoded(bus, envelope)
            if not isinstance(mode, ModeState) or bool(mode.power_off) is self._power_ends:
                continue
            self._power_ends = bool(mode.power_off)
            if mode.power_off:
                try:
                    self._folder.close_on_disk()
                except OSError as error:
                    log.warning("left a recording that may not be on the disk: %s", error.strerror)
                self._stop(explain(POWER_ENDS.get(mode.power_off_reason, Code.POWER_ENDS)), bus.now_ns())
            else:
                self._retry_ns = 0

    def _enforce_limits(self, bus: Bus) -> None:
        """Make room, and begin a file where there is none or the one in progress is long enough."""
        folder, now_ns = self._folder, bus.now_ns()
        aged = now_ns - self._opened_ns >= self._config.rotate_period_s * 1e9
        try:
            if aged or folder.open_bytes >= self._config.rotate_bytes:
                folder.close()
            verdict = decide(folder.stored(), folder.free_bytes, self._limits, open_name=folder.open_name)
            folder.delete(verdict.delete)
            if verdict.refusal:
                self._stop(verdict.refusal, now_ns)
            elif not folder.open_name and now_ns >= self._retry_ns and not self._power_ends:
                folder.open(file_name(now_ns, bus.vehicle), vehicle=bus.vehicle, vehicle_toml=bus.vehicle_toml,
                            chunk_bytes=self._config.chunk_bytes, now_ns=now_ns)  # fmt: skip
                self._opened_ns, self._reason = now_ns, None
                if folder.unsigned:
                    bus.last_error = folder.unsigned[:400]
            folder.sync()  # so that a power cut costs no more than a second or two
        except OSError as error:
            why = explain(Code.CANNOT_USE_FOLDER, folder=_quoted(folder.path), error=_quoted(error.strerror))
            self._stop(why, now_ns)

    def _stop(self, why: Explanation, now_ns: int) -> None:
        if self._reason is None or why.code != self._reason.code:
            log.warning("%s", reason(why))
        self._reason, self._retry_ns = why, now_ns + RETRY_NS
        self._close()

    def _close(self) -> None:
        """Finish the file in progress as far as the disk lets us: the reader needs no summary."""
        try:
            self._folder.close()
        except OSError as error:
            log.warning("left a recording without its summary: %s", error.strerror)

    def _state(self, bus: Bus) -> RecordingState:
        folder, flood = self._folder, self._quota.complaint(bus.now_ns())
        return RecordingState(
            now_ns=bus.now_ns(), recording=folder.open_name is not None, file=folder.open_name,
            bytes_written=folder.bytes_written, messages=folder.messages, dropped=folder.lost + bus.dropped,
            free_bytes=folder.free_bytes, left_out=self._quota.left_out,
            reason=None if self._reason is None else reason(self._reason), reason_code=self._reason,
            flood=None if flood is None else reason(flood), flood_code=flood,
        )  # fmt: skip


def _quoted(text: object) -> QuotedText:
    return QuotedText(quoted=str(text)[-QUOTED_LENGTH:])


def _connect(bus: Bus) -> list[Envelope]:
    """Subscribe before the first file is opened, which reads the key that signs: what others send meanwhile waits."""
    arrived: list[Envelope] = []
    until_s = time.monotonic() + CONNECT_S
    while not bus.stopping and not bus.connected and time.monotonic() < until_s:
        arrived += bus.receive(0.05)
    return arrived
