"""Which right each route of the unit's page needs: the one list that the guard decides by."""

from shared.page.access.table import SAFE_METHODS, WEBSOCKET, Row, row_of

from .rights import Right

ROWS = (
    Row("GET", "/login", Right.PUBLIC, "page of the login"),
    Row("GET", "/access/login.js", Right.PUBLIC, "its program"),
    Row("GET", "/style.css", Right.PUBLIC, "its style, that of the dashboard"),
    Row("POST", "/api/login", Right.PUBLIC, "open a session with a token"),
    Row("POST", "/api/logout", Right.VIEW, "end the session"),
    Row("GET", "/api/session", Right.PUBLIC, "who has logged in, with which role"),
    Row("GET", "/api/tokens", Right.ADMIN, "list of tokens and logins"),
    Row("POST", "/api/tokens", Right.ADMIN, "add or revoke a token"),
    Row("GET", "/api/alive", Right.PUBLIC, "whether the unit runs: health check of a container"),
    Row("GET", "/api/solution", Right.VIEW, "newest position"),
    Row("GET", "/api/history", Right.VIEW, "history of the position"),
    Row("GET", "/api/trust", Right.VIEW, "verdict and monitors"),
    Row("GET", "/api/hypotheses", Right.VIEW, "hypotheses"),
    Row("GET", "/api/health", Right.VIEW, "topics and processes against their deadlines"),
    Row("GET", "/api/outages", Right.VIEW, "outages"),
    Row("GET", "/api/state", Right.VIEW, "everything at once"),
    Row("GET", "/api/topics/{name:path}", Right.VIEW, "one topic"),
    Row("GET", "/metrics", Right.VIEW, "metrics for Prometheus"),
    Row("GET", "/api/series", Right.VIEW, "series of fields"),
    Row("GET", "/api/fields/{name:path}", Right.VIEW, "fields of a topic"),
    Row("GET", "/api/gnss", Right.VIEW, "GNSS receivers"),
    Row("GET", "/api/gnss/tracks", Right.VIEW, "tracks of satellites"),
    Row(WEBSOCKET, "/ws/series", Right.VIEW, "series of fields, live"),
    Row("GET", "/api/simulation", Right.VIEW, "possible attacks"),
    Row("POST", "/api/simulation/attack", Right.OPERATE, "start or stop an attack"),
    Row("GET", "/api/replay", Right.VIEW, "position of a replay"),
    Row("POST", "/api/replay", Right.OPERATE, "control a replay"),
    Row("GET", "/api/recordings", Right.VIEW, "list of recordings"),
    Row("POST", "/api/recordings", Right.OPERATE, "keep, release, replay, solve; `delete` needs admin"),
    Row("GET", "/api/recordings/{name}", Right.OPERATE, "download a recording"),
    Row("GET", "/api/recordings/{name}/report", Right.VIEW, "report of a solution"),
    Row("POST", "/api/command", Right.OPERATE, "command to the unit; `confirm_position` needs admin"),
    Row("GET", "/api/settings", Right.VIEW, "settings, without passwords, and the newest change"),
    Row("POST", "/api/settings", Right.ADMIN, "check, change, confirm, take back, restore settings"),
    Row("POST", "/api/draft", Right.OPERATE, "draft the mapping of a file for `obu import`"),
    Row("GET", "/api/support", Right.ADMIN, "collect and download diagnostics"),
    Row("GET", "/api/set-up", Right.VIEW, "steps of the set-up, and what the newest drive has shown"),
    Row("GET", "/api/set-up/certificate", Right.ADMIN, "make and download the certificate of the installation"),
    Row("GET", "/api/set-up/qr.svg", Right.VIEW, "code that opens a centre's page Enrolment with the unit's name"),
    Row("POST", "/api/set-up", Right.OPERATE, "confirm a step, survey the newest drive"),
    Row("POST", "/api/page-error", Right.VIEW, "report an error of the page's program"),
    Row("GET", "/api/track", Right.VIEW, "track of the drive"),
    Row("GET", "/api/track.gpx", Right.VIEW, "track as GPX"),
    Row("GET", "/api/track.kml", Right.VIEW, "track as KML"),
    Row("GET", "/api/map", Right.VIEW, "installed map"),
    Row("GET", "/map/tiles.pmtiles", Right.VIEW, "file of the map"),
    Row("GET", "/map/tiles/{zoom}/{x}/{y}", Right.VIEW, "tile of the map"),
    Row("GET", "/api/events", Right.VIEW, "server-sent events"),
    Row("GET", "/api/viewers", Right.VIEW, "number of connected clients"),
    Row(WEBSOCKET, "/ws", Right.VIEW, "state of the dashboard, live"),
    Row("GET", "/asyncapi.json", Right.VIEW, "contract of the bus"),
    Row("GET", "/openapi.json", Right.VIEW, "description of this interface"),
    Row("GET", "/", Right.VIEW, "dashboard"),
    Row("GET", "/docs", Right.VIEW, "description of this interface, as a page"),
    Row("GET", "/lib/{name}", Right.VIEW, "libraries of the dashboard"),
    Row("GET", "/{name:path}", Right.VIEW, "files of the dashboard"),
)


def needed(method: str, path: str) -> Right:
    """The right that a request needs; a change that no row describes needs the highest."""
    if (row := row_of(ROWS, method, path)) is not None:
        return row.right
    return Right.VIEW if method in (*SAFE_METHODS, WEBSOCKET) else Right.ADMIN
