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
from shared.runtime.config import Section
from shared.runtime.overlay import digest_of, settings_folder
from shared.settings.history import KEPT
from shared.settings.question import Answer, Question
from shared.topics import on_request

from .checker import Checker, CheckFailedError
from .codes import Code
from .judge import Before, Rejects, outstanding, worse
from .store import Store, Watched

log = logging.getLogger(__name__)

NS = 1_000_000_000
STATE_NS, LOOK_NS = 10 * NS, 3 * NS
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
        self._answer: Answer | None = None  # description of what holds
        self._report: DeadlineReport | None = None
        self._watched: Watched | None = None
        self._decided: Watched | None = None  # the newest one that was kept: it can be taken back
        self._begun_ns: int | None = None  # when all processes that a change touches had started again
        self._worse_ns: int | None = None  # since when it is worse
        self._newest: SettingsChange | None = None
        self._problem: Explanation | None = None
        self._state_ns = self._look_ns = 0
        self._seen = ""  # digest of the vehicle's file

    def run(self, bus: Bus) -> None:
        """Work until `bus.stopping`."""
        self._bus = bus
        name = os.environ.get("OBU_VEHICLE", "")
        self._store = Store(shipped(Path(name)) if name else Path(os.devnull), settings_folder(bus.state_dir))
        if name:
            self._begin()
        else:
            self._problem = explain(Code.NO_FILE)
        while not bus.stopping:
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
        """Take up what an earlier life of this process was about."""
        watched = self._store.watched()
        try:
            text, _ = self._store.text()
            if self._store.set_aside():
                self._problem = explain(Code.EDITED)
            self._seen = digest_of(self._store.shipped_text())
        except (UserError, OSError) as error:
            self._problem = _quoted(Code.CANNOT_WRITE, error)
            return
        if watched is not None and watched.text == text:
            self._watch(watched)  # the processes have started again with it, as after a power cut
        elif watched is not None:
            self._close(watched, SettingsStage.REFUSED, (explain(Code.INTERRUPTED),))
        self._describe()

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
            self._answer_with(command, SettingsStage.REFUSED, (why,))
        else:
            self._ask(command)

    def _refusal(self, command: SettingsCommand) -> Explanation | None:
        """Why a command cannot be taken at all."""
        if not self._seen:
            return self._problem or explain(Code.NO_FILE)
        if self._checker.is_busy or (self._watched is not None and command.action is not SettingsAction.CHECK):
            until_ns = (self._watched.change.until_ns if self._watched else None) or self._bus.now_ns()
            return explain(Code.BUSY, remaining_s=max(until_ns - self._bus.now_ns(), 0) / NS)
        versions = self._store.history.versions()
        if command.action is SettingsAction.RESTORE and not 1 <= (command.version or 0) <= len(versions):
            return explain(Code.NO_VERSION, versions_number=len(versions))
        return None

    def _ask(self, command: SettingsCommand | None) -> None:
        """Let a change be checked, or without one what holds be described."""
        try:
            text, _ = self._store.text()
            versions = self._store.history.versions()
            restored = command is not None and command.action is SettingsAction.RESTORE
            self._checker.ask(
                Question(
                    path=str(self._store.shipped),
                    text=text,
                    changes=command.changes if command is not None and not restored else {},
                    replacement=versions[command.version - 1].text() if restored else None,  # type: ignore[union-attr,operator]
                    earlier=tuple(version.text() for version in versions),
                )
            )
            self._asked = command
        except (UserError, OSError) as error:
            self._asked = command
            self._failed(error)

    def _describe(self) -> None:
        if not self._checker.is_busy:
            self._ask(None)

    def _failed(self, error: Exception) -> None:
        why = _quoted(Code.CHECK_FAILED, error)
        if self._asked is not None:
            self._answer_with(self._asked, SettingsStage.REFUSED, (why,))
            self._asked = None
        else:
            self._problem = why
            self._publish_state()

    def _found(self, answer: Answer) -> None:
        command, self._asked = self._asked, None
        if command is None:
            if answer.refusals:
                self._problem = answer.refusals[0]
            else:
                self._answer = answer
                self._bus.publish(SettingsCatalogue(sampled_ns=self._bus.now_ns(), settings=answer.settings))
            self._publish_state()
        elif answer.refusals:
            self._answer_with(command, SettingsStage.REFUSED, answer.refusals[:16])
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
        text, changed = self._store.text()
        watched = Watched(
            change=change, text=answer.text, former=text if changed else None, fresh=before.fresh,
            restarts=dict(before.restarts),
        )  # fmt: skip
        try:
            self._store.watch(watched)
            self._store.change(answer.text, text)
        except OSError as error:
            self._answer_with(command, SettingsStage.REFUSED, (_quoted(Code.CANNOT_WRITE, error),))
            return
        self._problem = None
        self._watch(watched)
        self._hold(answer)
        log.info("%s changed %s", command.by, ", ".join(names) or "the text of the settings")

    def _watch(self, watched: Watched) -> None:
        until_ns = self._bus.now_ns() + round(self._config.watch_s * NS)
        change = watched.change.model_copy(update={"until_ns": until_ns})
        self._watched, self._decided, self._newest = watched.model_copy(update={"change": change}), None, change
        self._begun_ns = self._worse_ns = None
        self._bus.also(on_request(self._bus.process))
        self._rejects = Rejects()
        self._rejects.begin()

    def _hold(self, answer: Answer) -> None:
        """Announce the digests of the text that holds, and its values."""
        counts = (len(answer.differences), *answer.counts)[:KEPT]  # the text before is the newest of the earlier ones
        self._answer = answer.model_copy(update={"counts": counts})
        self._bus.publish(SettingsCatalogue(sampled_ns=self._bus.now_ns(), settings=answer.settings))
        self._publish_state()

    def _judge(self, report: DeadlineReport) -> None:
        """Compare with before, once the processes have started again and had time to settle."""
        watched, now_ns = self._watched, self._bus.now_ns()
        if watched is None or watched.change.until_ns is None:
            return
        before = Before(watched.fresh, watched.restarts)
        if self._begun_ns is None and not outstanding(before, watched.change.touched, report):
            self._begun_ns = now_ns
            change = watched.change.model_copy(update={"until_ns": now_ns + round(self._config.watch_s * NS)})
            self._watched, self._newest = watched.model_copy(update={"change": change}), change
            self._publish_state()
        if self._begun_ns is None or now_ns - self._begun_ns < self._config.settle_s * NS:
            return
        since_s = (now_ns - self._begun_ns) / NS
        reasons = worse(before, watched.change.touched, report, self._rejects, since_s)
        if not reasons:
            self._worse_ns = None
            return
        self._worse_ns = self._worse_ns or now_ns
        if now_ns - self._worse_ns >= PERSISTS_S * NS:
            self._revert(watched, reasons)

    def _decide(self, watched: Watched) -> None:
        """Keep a change at the end of its time, unless it has not been confirmed, or processes have not started."""
        if watched.change.confirmation:
            self._revert(watched, (explain(Code.UNCONFIRMED, watched_s=self._config.watch_s),))
        elif self._begun_ns is None and self._report is not None:
            before = Before(watched.fresh, watched.restarts)
            missing = outstanding(before, watched.change.touched, self._report)
            self._revert(watched, tuple(explain(Code.PROCESS_DOWN, process(name)) for name in missing))
        elif self._worse_ns is None:
            self._close(watched, SettingsStage.KEPT, ())
            self._publish_state()

    def _confirm(self, command: SettingsCommand) -> None:
        if self._watched is None or not self._watched.change.confirmation:
            self._answer_with(command, SettingsStage.REFUSED, (explain(Code.NO_CHANGE),))
            return
        change = self._watched.change.model_copy(update={"confirmation": False})
        self._watched, self._newest = self._watched.model_copy(update={"change": change}), change
        try:
            self._store.watch(self._watched)
        except OSError as error:
            log.warning("the confirmation is not kept over a restart: %s", error)
        self._publish_state()

    def _take_back_asked(self, command: SettingsCommand) -> None:
        watched = self._watched or self._decided
        if watched is None or self._checker.is_busy:
            self._answer_with(command, SettingsStage.REFUSED, (explain(Code.NO_CHANGE),))
            return
        self._revert(watched, (explain(Code.ASKED),))

    def _revert(self, watched: Watched, reasons: tuple[Explanation, ...]) -> None:
        """Let the text before a change hold again."""
        try:
            text, _ = self._store.text()
            self._store.change(watched.former, text)
        except (UserError, OSError) as error:
            self._problem = _quoted(Code.CANNOT_WRITE, error)
            self._publish_state()
            return
        self._close(watched, SettingsStage.TAKEN_BACK, reasons)
        log.warning("took back the change of %s: %s", watched.change.by, ", ".join(one.code for one in reasons))
        self._checker.close()
        self._asked = None
        self._describe()  # the digests follow with its answer

    def _close(self, watched: Watched, stage: SettingsStage, reasons: tuple[Explanation, ...]) -> None:
        update = {"stage": stage, "reasons": reasons, "until_ns": None, "confirmation": False}
        self._newest = watched.change.model_copy(update=update)
        self._decided = watched if stage is SettingsStage.KEPT else None
        self._watched = self._worse_ns = None
        self._bus.also(())
        try:
            self._store.watch(None)
        except OSError as error:
            log.warning("the decision is not kept over a restart: %s", error)

    def _look(self) -> None:
        """Notice that the vehicle's file, or the text over it, was changed by somebody else."""
        if not self._seen or self._checker.is_busy:
            return
        try:
            digest = digest_of(self._store.shipped_text())
            if digest != self._seen:
                self._seen = digest
                self._store.set_aside()
                self._problem = explain(Code.EDITED)
                self._describe()
            elif self._answer is not None and self._store.text()[0] != self._answer.text:
                self._describe()  # as by `obu config set`
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
                        differing=counts[number - 1] if number <= len(counts) else 0,
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
    return explain(code, error=QuotedText(quoted=str(error)[:QUOTED_LENGTH]))
