"""Changes the settings of the unit, and takes a change back that harms it.

The text that holds is written over the vehicle's file; every process listens to the digests that follow from it, and
ends by itself where its own differs, to be started again by whoever supervises it.
"""

import logging
import os
from datetime import UTC
from pathlib import Path

from pydantic import Field

from shared import shipped
from shared.bus.bus import Bus, decoded
from shared.errors import UserError
from shared.messages.explanation import QUOTED_LENGTH, Explanation, QuotedText, explain, process
from shared.messages.operation import DeadlineReport, ProcessHealth
from shared.messages.settings import (
    SettingsAction,
    SettingsAnswer,
    SettingsCatalogue,
    SettingsChange,
    SettingsCommand,
    SettingsStage,
    SettingsState,
    SettingsVersion,
)
from shared.recording.writer import without_users
from shared.runtime.config import Section
from shared.runtime.overlay import digest_of, settings_folder
from shared.settings.history import KEPT, Version
from shared.settings.question import Answer, Question
from shared.topics import on_request

from .checker import TIMEOUT_S, Checker, CheckFailedError
from .codes import Code
from .judge import Before, Rejects, outstanding, worse
from .store import Store, Watched

log = logging.getLogger(__name__)

NS = 1_000_000_000
STATE_NS, LOOK_NS, RETRY_NS = 10 * NS, 3 * NS, 30 * NS
RECENT_NS = 15 * NS  # of the report that a change is kept by
PERSISTS_S = 6.0  # that something is worse without a break, before the change is taken back
ACCESS = "monitoring.status"  # its settings decide who reaches the page
NOT_ACCESS = ("history_s", "map_file", "recordings", "clients_maximum")
GEOMETRY = ("vehicle.imu.", "vehicle.gnss.", "vehicle.rear_axle_body_m")


class Config(Section):
    """How long a change is watched."""

    watch_s: float = Field(
        default=60.0,
        ge=10.0,
        le=600.0,
        description="time after a change, from the start of the processes that it touches, in which it is taken back "
        "if the unit is worse; it is taken back too if they have not started in this time",
    )
    settle_s: float = Field(
        default=20.0, ge=2.0, le=120.0, description="time that processes have to start again before they are judged"
    )


class Process:
    """Carries out one command after the other; nothing is written before it was checked."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._checker, self._rejects = Checker(), Rejects()
        self._asked: SettingsCommand | None = None  # of the open question; None: it describes what holds
        self._about = "", ""  # text and digest of the vehicle's file that the newest question is about
        self._answer: Answer | None = None  # description of what holds
        self._report: DeadlineReport | None = None
        self._watched: Watched | None = None
        self._decided: Watched | None = None  # the newest one that was kept: it can be taken back
        self._begun_ns: int | None = None  # when all processes that a change touches had started again
        self._worse_ns: int | None = None  # since when it is worse
        self._newest: SettingsChange | None = None
        self._problem: Explanation | None = None
        self._state_ns = self._look_ns = self._retry_ns = 0
        self._seen = ""  # digest of the vehicle's file

    def run(self, bus: Bus) -> None:
        """Work until `bus.stopping`."""
        self._bus = bus
        name = os.environ.get("OBU_VEHICLE", "")
        self._store = Store(shipped(Path(name)) if name else Path(os.devnull), settings_folder(bus.state_dir))
        self._problem = None if name else explain(Code.NO_FILE)
        while not bus.stopping:
            if name and not self._seen and bus.now_ns() >= self._retry_ns:
                self._begin()
            for envelope in bus.receive(0.1 if self._checker.is_busy else 0.5):
                message = decoded(bus, envelope)
                if isinstance(message, SettingsCommand):
                    self._command(message)
                elif isinstance(message, DeadlineReport):
                    self._report = message
                    self._judge(message)
                elif isinstance(message, ProcessHealth):
                    self._rejects.note(message)
            self._work()
        self._checker.close()

    def _begin(self) -> None:
        """Take up what an earlier life of this process was about; a file that cannot be read is tried again."""
        self._retry_ns = self._bus.now_ns() + RETRY_NS
        try:
            if self._store.set_aside():
                self._problem = explain(Code.EDITED)
            text, _ = self._store.text()
            self._seen = digest_of(self._store.shipped_text())
        except (UserError, OSError) as error:
            self._problem = _quoted(Code.CANNOT_WRITE, error)
            return
        if watched := self._store.watched():
            self._take_up(watched, text)
        self._describe()

    def _take_up(self, watched: Watched, text: str) -> None:
        """Go on with a change that was watched, decided or being written when this process ended."""
        stage = watched.change.stage
        if watched.text != text:
            was_reverted = stage is SettingsStage.TAKEN_BACK
            reasons = watched.change.reasons if was_reverted else (explain(Code.INTERRUPTED),)
            self._close(watched, SettingsStage.TAKEN_BACK if was_reverted else SettingsStage.REFUSED, reasons)
        elif stage is SettingsStage.KEPT:
            self._decided, self._newest = watched, watched.change
        elif stage is SettingsStage.TAKEN_BACK:
            self._revert(watched, watched.change.reasons)
        else:
            self._watch(watched)  # the processes have started again with it, as after a power cut

    def _work(self) -> None:
        now_ns = self._bus.now_ns()
        try:
            found = self._checker.answer()
        except CheckFailedError as error:
            self._failed(error)
            found = None
        if found is not None:
            self._found(found)
        if self._watched is not None and now_ns >= (self._watched.change.until_ns or 0):
            self._decide(self._watched)
        if now_ns >= self._look_ns:
            self._look_ns = now_ns + LOOK_NS
            self._look()
        if now_ns >= self._state_ns:
            self._publish_state()

    def _command(self, command: SettingsCommand) -> None:
        if command.action is SettingsAction.CONFIRM:
            self._confirm(command)
        elif command.action is SettingsAction.TAKE_BACK:
            self._take_back_asked(command)
        elif (why := self._refusal(command)) is not None:
            self._refuse(command, why)
        else:
            self._bus.also(on_request(self._bus.process))  # what is rejected now is what it was before the change
            self._ask(command)

    def _refusal(self, command: SettingsCommand) -> Explanation | None:
        """Why a command cannot be taken at all."""
        if not self._seen:
            return self._problem or explain(Code.NO_FILE)
        if self._checker.is_busy or (self._watched is not None and command.action is not SettingsAction.CHECK):
            return self._busy()
        versions = self._store.history.versions()
        if command.action is SettingsAction.RESTORE and not 1 <= (command.version or 0) <= len(versions):
            return explain(Code.NO_VERSION, versions_number=len(versions))
        return None

    def _busy(self) -> Explanation:
        until_ns = self._watched.change.until_ns if self._watched is not None else None
        left_s = TIMEOUT_S if until_ns is None else max(until_ns - self._bus.now_ns(), 0) / NS
        return explain(Code.BUSY, remaining_s=left_s)

    def _refuse(self, command: SettingsCommand, *why: Explanation) -> None:
        self._answer_with(command, SettingsStage.REFUSED, why[:16])
        if self._watched is None:
            self._bus.also(())

    def _ask(self, command: SettingsCommand | None) -> None:
        """Let a change be checked, or without one what holds be described."""
        self._asked = command
        try:
            if self._store.set_aside():
                self._problem = explain(Code.EDITED)
            text, _ = self._store.text()
            self._about = text, digest_of(self._store.shipped_text())
            versions = self._store.history.versions()
            restored = command.version if command and command.action is SettingsAction.RESTORE else None
            self._checker.ask(
                Question(
                    path=str(self._store.shipped),
                    text=text,
                    changes=command.changes if command is not None and restored is None else {},
                    replacement=None if restored is None else versions[restored - 1].text(),
                    earlier=tuple(_text_of(version) for version in versions),
                )
            )
        except (UserError, OSError) as error:
            self._failed(error)

    def _describe(self) -> None:
        if not self._checker.is_busy:
            self._ask(None)

    def _failed(self, error: Exception) -> None:
        command, self._asked = self._asked, None
        why = _quoted(Code.CHECK_FAILED, error)
        if command is not None:
            self._refuse(command, why)
        else:
            self._problem, self._retry_ns = why, self._bus.now_ns() + RETRY_NS
            self._publish_state()

    def _found(self, answer: Answer) -> None:
        command, self._asked = self._asked, None
        if command is None:
            if answer.refusals:
                self._problem = answer.refusals[0]
            else:
                self._answer = answer
                if self._problem is not None and self._problem.code != Code.EDITED:
                    self._problem = None  # of a text that could not be read or checked before
                self._bus.publish(SettingsCatalogue(sampled_ns=self._bus.now_ns(), settings=answer.settings))
            self._publish_state()
        elif answer.refusals:
            self._refuse(command, *answer.refusals)
        elif command.action is SettingsAction.CHECK:
            self._answer_with(command, SettingsStage.CHECKED, (), answer)
        else:
            self._apply(command, answer)

    def _apply(self, command: SettingsCommand, answer: Answer) -> None:
        """Write a change that was checked, and watch what follows."""
        now_ns, before = self._bus.now_ns(), Before.of(self._report)
        names = [one.name for one in answer.differences]
        change = self._change(command, SettingsStage.WATCHED, (), answer).model_copy(
            update={
                "until_ns": now_ns + round(self._config.watch_s * NS),
                "confirmation": any(_is_access(name) for name in names),
                "offered": any(name.startswith(GEOMETRY) for name in names),
            }
        )
        try:
            text, changed = self._store.text()
            if (text, digest_of(self._store.shipped_text())) != self._about:  # while it was checked
                self._refuse(command, explain(Code.MEANWHILE))
                return
            watched = Watched(
                change=change, text=answer.text, former=text if changed else None, fresh=before.fresh,
                restarts=dict(before.restarts),
            )  # fmt: skip
            self._store.watch(watched)
            self._store.change(answer.text, text)
        except (UserError, OSError) as error:
            self._forget_watched()
            self._refuse(command, _quoted(Code.CANNOT_WRITE, error))
            return
        self._problem = None
        self._rejects.begin()
        self._watch(watched)
        self._hold(answer)
        log.info("%s changed %s", command.by, ", ".join(names) or "the text of the settings")

    def _watch(self, watched: Watched) -> None:
        until_ns = self._bus.now_ns() + round(self._config.watch_s * NS)
        change = watched.change.model_copy(update={"until_ns": until_ns})
        self._watched, self._decided, self._newest = watched.model_copy(update={"change": change}), None, change
        self._begun_ns = self._worse_ns = None
        self._bus.also(on_request(self._bus.process))

    def _hold(self, answer: Answer) -> None:
        """Announce the digests of the text that holds, and its values."""
        counts = (len(answer.differences), *answer.counts)[:KEPT]  # the text before is the newest of the earlier ones
        self._answer = answer.model_copy(update={"counts": counts})
        self._about = answer.text, self._about[1]
        self._bus.publish(SettingsCatalogue(sampled_ns=self._bus.now_ns(), settings=answer.settings))
        self._publish_state()

    def _outstanding(self, watched: Watched) -> tuple[str, ...]:
        return outstanding(self._rejects.lives, watched.change)

    def _judge(self, report: DeadlineReport) -> None:
        """Compare with before, once the processes have started again and had time to settle."""
        watched, now_ns = self._watched, self._bus.now_ns()
        if watched is None or watched.change.until_ns is None:
            return
        if self._begun_ns is None and not self._outstanding(watched):
            self._begun_ns = now_ns
            change = watched.change.model_copy(update={"until_ns": now_ns + round(self._config.watch_s * NS)})
            self._watched, self._newest = watched.model_copy(update={"change": change}), change
            self._publish_state()
        if self._begun_ns is None or now_ns - self._begun_ns < self._config.settle_s * NS:
            return
        before, since_s = Before(watched.fresh, watched.restarts), (now_ns - self._begun_ns) / NS
        reasons = worse(before, watched.change, report, self._rejects, since_s)
        if not reasons:
            self._worse_ns = None
            return
        self._worse_ns = self._worse_ns or now_ns
        if now_ns - self._worse_ns >= PERSISTS_S * NS and now_ns >= self._retry_ns:
            self._revert(watched, reasons)

    def _decide(self, watched: Watched) -> None:
        """Keep a change at the end of its time, where it was compared, is no worse, and is confirmed."""
        now_ns = self._bus.now_ns()
        if now_ns < self._retry_ns:
            return
        is_compared = self._report is not None and now_ns - self._report.now_ns < RECENT_NS
        if watched.change.confirmation:
            self._revert(watched, (explain(Code.UNCONFIRMED, watched_s=self._config.watch_s),))
        elif not is_compared:
            self._revert(watched, (explain(Code.NOT_COMPARED),))
        elif self._begun_ns is None:
            missing = self._outstanding(watched)
            self._revert(watched, tuple(explain(Code.PROCESS_DOWN, process(name)) for name in missing))
        elif self._worse_ns is None:
            self._close(watched, SettingsStage.KEPT, ())
            self._publish_state()

    def _confirm(self, command: SettingsCommand) -> None:
        watched = self._watched
        if watched is None or not watched.change.confirmation:
            self._refuse(command, explain(Code.NO_CHANGE))
            return
        if waiting := self._outstanding(watched):  # who confirms now has come by the way that is about to end
            self._refuse(command, explain(Code.NOT_STARTED, process(waiting[0])))
            return
        change = watched.change.model_copy(update={"confirmation": False})
        self._watched, self._newest = watched.model_copy(update={"change": change}), change
        try:
            self._store.watch(self._watched)
        except OSError as error:
            log.warning("the confirmation is not kept over a restart: %s", error)
        self._publish_state()

    def _take_back_asked(self, command: SettingsCommand) -> None:
        watched = self._watched or self._decided
        if watched is None:
            self._refuse(command, explain(Code.NO_CHANGE))
        elif self._checker.is_busy:
            self._refuse(command, self._busy())
        else:
            self._revert(watched, (explain(Code.ASKED),))

    def _revert(self, watched: Watched, reasons: tuple[Explanation, ...]) -> None:
        """Let the text before a change hold again; one that was written since then stays."""
        change = watched.change.model_copy(update={"stage": SettingsStage.TAKEN_BACK, "reasons": reasons})
        try:
            text, _ = self._store.text()
            if text == watched.text:
                self._store.watch(watched.model_copy(update={"change": change}))  # before it is: see `_take_up`
                self._store.change(watched.former, text)
            else:
                reasons = (explain(Code.MEANWHILE),)
        except (UserError, OSError) as error:
            self._problem, self._retry_ns = _quoted(Code.CANNOT_WRITE, error), self._bus.now_ns() + RETRY_NS
            self._publish_state()
            return
        self._close(watched, SettingsStage.TAKEN_BACK, reasons)
        log.warning("took back the change of %s: %s", watched.change.by, ", ".join(one.code for one in reasons))
        self._checker.close()
        if self._asked is not None:
            self._refuse(self._asked, self._busy())
        self._describe()  # the digests follow with its answer

    def _close(self, watched: Watched, stage: SettingsStage, reasons: tuple[Explanation, ...]) -> None:
        update = {"stage": stage, "reasons": reasons, "until_ns": None, "confirmation": False}
        self._newest = watched.change.model_copy(update=update)
        self._watched = self._worse_ns = self._decided = None
        self._bus.also(())
        if stage is SettingsStage.KEPT:
            self._decided = watched.model_copy(update={"change": self._newest})
            try:
                self._store.watch(self._decided)
            except OSError as error:
                log.warning("the decision is not kept over a restart: %s", error)
        else:
            self._forget_watched()

    def _forget_watched(self) -> None:
        try:
            self._store.watch(None)
        except OSError as error:
            log.warning("the decision is not kept over a restart: %s", error)

    def _look(self) -> None:
        """Notice that the vehicle's file, or the text over it, was changed by somebody else."""
        if not self._seen or self._checker.is_busy:
            return
        now_ns = self._bus.now_ns()
        try:
            digest = digest_of(self._store.shipped_text())
            if digest != self._seen:
                self._seen = digest
                self._store.set_aside()
                self._problem = explain(Code.EDITED)
                if (ended := self._watched or self._decided) is not None:
                    self._close(ended, SettingsStage.TAKEN_BACK, (explain(Code.EDITED),))
                self._describe()
            elif self._store.text()[0] != self._about[0]:
                self._describe()  # as by `obu config set`
            elif self._answer is None and now_ns >= self._retry_ns:
                self._describe()  # a first description that failed
        except (UserError, OSError) as error:
            self._problem = _quoted(Code.CANNOT_WRITE, error)

    def _change(
        self, command: SettingsCommand, stage: SettingsStage, reasons: tuple[Explanation, ...], answer: Answer | None
    ) -> SettingsChange:
        return SettingsChange(
            request_id=command.request_id, by=command.by, stage=stage, begun_ns=self._bus.now_ns(), reasons=reasons,
            differences=answer.differences[:64] if answer else (), touched=answer.touched if answer else (),
        )  # fmt: skip

    def _answer_with(
        self, command: SettingsCommand, stage: SettingsStage, reasons: tuple[Explanation, ...],
        answer: Answer | None = None,
    ) -> None:  # fmt: skip
        change = self._change(command, stage, reasons, answer)
        self._bus.publish(SettingsAnswer(sampled_ns=self._bus.now_ns(), change=change))

    def _publish_state(self) -> None:
        now_ns = self._bus.now_ns()
        self._state_ns = now_ns + STATE_NS
        counts = self._answer.counts if self._answer else ()
        versions = self._store.history.versions() if self._seen else []
        try:
            changed = bool(self._seen) and self._store.text()[1]
        except UserError:
            changed = False
        self._bus.publish(
            SettingsState(
                sampled_ns=now_ns,
                digests=self._answer.digests if self._answer else {},
                change=self._newest,
                versions=tuple(
                    SettingsVersion(
                        number=number,
                        replaced_ns=round(version.replaced.astimezone(UTC).timestamp() * NS),
                        differing=counts[number - 1] if number <= len(counts) else None,
                    )
                    for number, version in enumerate(versions, 1)
                ),
                changed=changed,
                problem=self._problem,
            )
        )


def _is_access(name: str) -> bool:
    return name.startswith(f"{ACCESS}.") and not name.endswith(NOT_ACCESS)


def _quoted(code: Code, error: Exception) -> Explanation:
    return explain(code, error=QuotedText(quoted=without_users(str(error))[:QUOTED_LENGTH]))


def _text_of(version: Version) -> str:
    """Text of an earlier version; that of one that cannot be read is empty, which is no vehicle's file to compare."""
    try:
        return version.text()
    except UserError:
        return "unreadable ["
