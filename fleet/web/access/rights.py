"""What each role may do, and which right each route needs: the one list that the guard decides by."""

from dataclasses import dataclass
from enum import StrEnum

from shared.page.access.table import WEBSOCKET, Row, row_of


class Right(StrEnum):
    """What a route may need."""

    PUBLIC = "public"  # without a login
    SIGNED_IN = "signed in"
    SEE = "see"  # positions, tracks, alarms
    PASSAGES = "passages"  # of toll
    OPERATE = "operate"
    ADMIN = "admin"


class Role(StrEnum):
    """Roles of accounts."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    TOLL = "toll"
    ADMIN = "admin"


GRANTED = {
    Role.VIEWER: frozenset({Right.SIGNED_IN, Right.SEE}),
    Role.OPERATOR: frozenset({Right.SIGNED_IN, Right.SEE, Right.OPERATE}),
    Role.TOLL: frozenset({Right.SIGNED_IN, Right.PASSAGES}),
    Role.ADMIN: frozenset(Right),
}
MEANING = {
    Role.VIEWER: "sees the map, vehicles with their tracks, and alarms",
    Role.OPERATOR: "besides, acknowledges alarms and watches vehicles",
    Role.TOLL: "sees passages of toll plazas, and neither positions nor tracks",
    Role.ADMIN: "besides all of these, enrols and revokes vehicles, manages accounts, reads the audit",
}


@dataclass(frozen=True)
class Visitor:
    """Somebody who has logged in."""

    account_id: int
    tenant_id: int
    tenant: str
    name: str
    role: Role
    csrf: str
    token_hash: bytes

    def may(self, right: Right) -> bool:
        """Whether the role includes a right."""
        return right is Right.PUBLIC or right in GRANTED[self.role]


ROWS = (
    Row("GET", "/login", Right.PUBLIC, "page of the login"),
    Row("GET", "/access/login.js", Right.PUBLIC, "its program"),
    Row("GET", "/unit/style.css", Right.PUBLIC, "its style, that of the unit's page"),
    Row("GET", "/style.css", Right.PUBLIC, "its style"),
    Row("GET", "/api/alive", Right.PUBLIC, "whether this process and its database work"),
    Row("GET", "/api/session", Right.PUBLIC, "who has logged in, with which role"),
    Row("POST", "/api/login", Right.PUBLIC, "open a session with name and password"),
    Row("POST", "/api/logout", Right.SIGNED_IN, "end the session"),
    Row("POST", "/api/page-error", Right.SIGNED_IN, "report an error of the page's program"),
    Row("GET", "/api/page-errors", Right.ADMIN, "how many were reported, and the newest"),
    Row("POST", "/api/password", Right.SIGNED_IN, "change the own password"),
    Row("GET", "/tiles/{zoom}/{x}/{y}.mvt", Right.SEE, "vehicles as vector tiles"),
    Row("GET", "/api/map", Right.SEE, "installed map"),
    Row("GET", "/map/{name:path}", Right.SEE, "tiles of the installed map"),
    Row("GET", "/api/vehicles", Right.SEE, "list of vehicles, and counts by verdict"),
    Row("GET", "/api/vehicles/{vehicle}", Right.SEE, "one vehicle with its events, gaps and keys"),
    Row("GET", "/api/vehicles/{vehicle}/trail", Right.SEE, "track of the last minutes"),
    Row("GET", "/api/passages", Right.PASSAGES, "charges of toll plazas"),
    Row("GET", "/api/alarms", Right.SEE, "alarms"),
    Row("POST", "/api/alarms/{alarm}/acknowledge", Right.OPERATE, "acknowledge an alarm"),
    Row("GET", "/api/web-hook", Right.ADMIN, "address that is told of alarms"),
    Row("POST", "/api/web-hook", Right.ADMIN, "change it"),
    Row("GET", "/api/enrolment", Right.ADMIN, "tokens, and keys of vehicles"),
    Row("POST", "/api/enrolment", Right.ADMIN, "make a token"),
    Row("POST", "/api/withdraw", Right.ADMIN, "end a token that nobody has used"),
    Row("POST", "/api/revoke", Right.ADMIN, "revoke the keys of a vehicle, or one key"),
    Row("GET", "/api/accounts", Right.ADMIN, "accounts"),
    Row("POST", "/api/accounts", Right.ADMIN, "add, change or disable an account"),
    Row("GET", "/api/audit", Right.ADMIN, "who did what"),
    Row(WEBSOCKET, "/ws", Right.SEE, "changes of verdicts and alarms, live"),
    Row("GET", "/vehicles/{vehicle}/live", Right.OPERATE, "page of a unit that is watched"),
    Row("GET", "/vehicles/{vehicle}/live/{rest:path}", Right.OPERATE, "page of a unit that is watched"),
    Row(WEBSOCKET, "/vehicles/{vehicle}/live/{rest:path}", Right.OPERATE, "state of a unit that is watched"),
    Row("GET", "/{name:path}", Right.SIGNED_IN, "files of the page"),
)


def needed(method: str, path: str) -> Right:
    """The right that a request needs; what no row describes needs the highest."""
    row = row_of(ROWS, method, path)
    return Right.ADMIN if row is None else row.right
