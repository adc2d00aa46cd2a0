"""Which pictures of a lane's camera are kept: a charge deletes its own at once, and every picture has an end."""

import hashlib

from shared.messages.explanation import Explanation, explain
from shared.messages.toll import LaneTraffic, PictureAction, PictureOrder, PictureState, PictureSummary
from shared.toll.plaza import Plaza
from shared.words.words import reason

from .codes import Code
from .store import Row, Store

NS = 1_000_000_000
ORDERS_AT_ONCE = 100
LISTED = 50
RESEND_NS, RESEND_LONGEST_NS = 15 * NS, 60 * NS  # sensors.plaza itself repeats an order for ten seconds
CAMERA_NS = 10 * NS  # without a state of the camera, after which nothing is sent again
BEGIN_NS = 60 * NS  # after a start, in which a camera may still speak
UNSENT, SENT, ANSWERED = 0, 1, 2  # of the column `sent`
# Outcomes of a pulse that say that an unknown vehicle owes something; in a mixed lane it may pay there.
OWES = {"missed", "unregistered", "undecided"}
DISPUTED = {"review", "suspect"}


class Pictures:
    """Orders to the cameras; every method that changes something runs inside a transaction of the store."""

    def __init__(self, store: Store, plaza: Plaza, *, undecided_s: float, kept_days: float) -> None:
        self._store, self._plaza = store, plaza
        self._undecided_ns, self._kept_ns = round(undecided_s * NS), round(kept_days * 86_400 * NS)
        self._again: dict[tuple[str, str], tuple[int, int]] = {}  # next time and pause, by picture and action
        self._camera_ns: int | None = None  # time of the newest state of the camera
        self._since_ns: int | None = None
        self.failed = 0  # as the camera's process counts
        self._mixed = {lane.name for lane in plaza.lanes if lane.traffic is LaneTraffic.MIXED}

    def take(self, lane: str, since_ns: int, number: int, pulse_ns: int) -> None:
        """Order a picture of the vehicle of a pulse; without a decision the camera deletes it."""
        self._order(
            picture_of(self._plaza.name, lane, since_ns, number), lane, pulse_ns, PictureAction.TAKE,
            pulse_ns + self._undecided_ns, None,
        )  # fmt: skip

    def charged(self, pulse: Row) -> None:
        """Delete the picture of a charged vehicle."""
        self._decide(pulse, PictureAction.DELETE, explain(Code.PICTURE_CHARGED))

    def disputed(self, pulse: Row) -> None:
        """Keep the picture that decides a review."""
        self._decide(pulse, PictureAction.KEEP, explain(Code.PICTURE_REVIEW))

    def settle(self, pulse: Row, outcome: str) -> None:
        """Keep or delete the picture of a pulse by its lane and its final outcome."""
        if outcome in DISPUTED:
            self.disputed(pulse)
        elif outcome in OWES and pulse["lane"] not in self._mixed:
            self._decide(pulse, PictureAction.KEEP, explain(Code.PICTURE_OWES))
        else:
            self._decide(pulse, PictureAction.DELETE, explain(Code.PICTURE_SETTLED))

    def note(self, state: PictureState, now_ns: int) -> None:
        """Take what a camera has answered: these orders are carried out."""
        self._camera_ns, self.failed = now_ns, state.failed
        for answer in state.answered:
            self._again.pop((answer.picture, answer.action.value), None)
            self._store.execute(
                "UPDATE picture SET sent = ? WHERE picture = ? AND action = ?", ANSWERED, answer.picture, answer.action
            )

    def expire(self, now_ns: int) -> None:
        """Delete the pictures whose time is over, and forget those that are deleted.

        Deleted is what the camera has answered, or what has reached its end. Without any camera an order is all.
        """
        self._since_ns = now_ns if self._since_ns is None else self._since_ns
        self._store.execute(
            "UPDATE picture SET action = ?, sent = 0, reason = NULL WHERE until_ns < ? AND action <> ?",
            PictureAction.DELETE, now_ns, PictureAction.DELETE,
        )  # fmt: skip
        has_camera = self._camera_ns is not None or now_ns - self._since_ns < BEGIN_NS
        self._store.execute(
            "DELETE FROM picture WHERE action = ? AND (sent = ? OR (sent = ? AND (? OR until_ns < ?)))",
            PictureAction.DELETE, ANSWERED, SENT, not has_camera, now_ns,
        )  # fmt: skip
        if self._again:
            waiting = {row["picture"] for row in self._store.rows("SELECT picture FROM picture WHERE sent = 1")}
            self._again = {key: value for key, value in self._again.items() if key[0] in waiting}

    def due(self, now_ns: int) -> list[PictureOrder]:
        """List the orders that are not published yet, and again, after growing pauses, those without an answer."""
        rows = self._store.rows("SELECT * FROM picture WHERE NOT sent ORDER BY pulse_ns LIMIT ?", ORDERS_AT_ONCE)
        if self._camera_ns is not None and now_ns - self._camera_ns < CAMERA_NS:
            unanswered = self._store.rows("SELECT * FROM picture WHERE sent = 1 ORDER BY pulse_ns")
            again = [row for row in unanswered if self._again.get((row["picture"], row["action"]), (0, 0))[0] <= now_ns]
            rows += again[: ORDERS_AT_ONCE - len(rows)]
        for row in rows:
            key = row["picture"], row["action"]
            pause_ns = min(2 * self._again[key][1], RESEND_LONGEST_NS) if key in self._again else RESEND_NS
            self._again[key] = now_ns + pause_ns, pause_ns
        return [
            PictureOrder(
                sampled_ns=now_ns, plaza=self._plaza.name, lane=row["lane"], picture=row["picture"],
                pulse_ns=row["pulse_ns"], action=PictureAction(row["action"]), until_ns=row["until_ns"],
                reason_code=_code(row),
            )
            for row in rows
        ]  # fmt: skip

    def sent(self, order: PictureOrder) -> None:
        """Note that an order is published; a kill before that repeats it."""
        self._store.execute(
            "UPDATE picture SET sent = 1 WHERE picture = ? AND action = ?", order.picture, order.action.value
        )

    def kept(self) -> tuple[PictureSummary, ...]:
        """The newest pictures that are kept."""
        rows = self._store.rows(
            "SELECT * FROM picture WHERE action = ? ORDER BY pulse_ns DESC LIMIT ?", PictureAction.KEEP, LISTED
        )
        return tuple(
            PictureSummary(
                lane=row["lane"], pulse_ns=row["pulse_ns"], until_ns=row["until_ns"], reason_code=code,
                reason=reason(code) if code else "",
            )
            for row in rows
            for code in [_code(row)]
        )  # fmt: skip

    def count(self, action: PictureAction) -> int:
        """Number of pictures with an order."""
        row = self._store.row("SELECT COUNT(*) AS n FROM picture WHERE action = ?", action)
        return int(row["n"]) if row else 0

    def _decide(self, pulse: Row, action: PictureAction, why: Explanation) -> None:
        picture = picture_of(self._plaza.name, pulse["lane"], pulse["since_ns"], pulse["number"])
        until_ns = pulse["sampled_ns"] + (self._kept_ns if action is PictureAction.KEEP else self._undecided_ns)
        row = self._store.row("SELECT action FROM picture WHERE picture = ?", picture)
        if row is None or row["action"] in (action, PictureAction.DELETE):
            return
        self._order(picture, pulse["lane"], pulse["sampled_ns"], action, until_ns, why)

    def _order(
        self, picture: str, lane: str, pulse_ns: int, action: PictureAction, until_ns: int, why: Explanation | None
    ) -> None:
        self._store.execute(
            "INSERT OR REPLACE INTO picture (picture, lane, pulse_ns, until_ns, action, reason) "
            "VALUES (?, ?, ?, ?, ?, ?)",
            picture, lane, pulse_ns, until_ns, action.value, why.model_dump_json() if why else None,
        )  # fmt: skip


def picture_of(plaza: str, lane: str, since_ns: int, number: int) -> str:
    """Name the picture of a pulse: who holds the camera's store learns nothing from it."""
    return hashlib.sha256(f"picture:{plaza}:{lane}:{since_ns}:{number}".encode()).hexdigest()


def _code(row: Row) -> Explanation | None:
    return Explanation.model_validate_json(row["reason"]) if row["reason"] else None
