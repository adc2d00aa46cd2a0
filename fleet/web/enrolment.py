"""Enrolment: one-time tokens, the keys of vehicles, and their revocation."""

import hashlib
import json
import logging
from typing import Annotated

from fastapi import FastAPI, HTTPException, Query, Request, Response
from nats.aio.client import Client
from pydantic import Field

from fleet.bus import told
from fleet.database.revoking import END_TOKEN, END_TOKENS, LOCK_VEHICLE, REVOKE
from shared.fleet.enrolling import command_for, new_secret
from shared.fleet.topics import REVOKED, RULE, VEHICLE
from shared.page.body import json_response

from .access.guard import visitor_of
from .audit import note
from .database import Database
from .requests import Body, read
from .tiles import now_ms
from .vehicles import unknown

log = logging.getLogger(__name__)

LISTED = 200
MAX_HOURS = 720
TOKENS = f"""
SELECT token_id AS id, vehicle, (extract(epoch FROM made) * 1000)::bigint AS made_ms, made_by,
    (extract(epoch FROM expires) * 1000)::bigint AS expires_ms, (extract(epoch FROM used) * 1000)::bigint AS used_ms,
    used_by
FROM enrolment ORDER BY made DESC LIMIT {LISTED}
"""
VEHICLES = f"""
SELECT vehicle.vehicle,
    (extract(epoch FROM max(not_after) FILTER (WHERE kind = 'tls' AND revoked IS NULL)) * 1000)::bigint AS tls_until_ms,
    count(*) FILTER (WHERE kind = 'evidence' AND revoked IS NULL) AS evidence_keys,
    count(key_id) > 0 AND bool_and(revoked IS NOT NULL) AS revoked, max(vehicle_now.utc_ms) AS utc_ms
FROM vehicle LEFT JOIN certificate USING (vehicle) LEFT JOIN vehicle_now USING (vehicle)
WHERE %(find)s = '' OR position(lower(%(find)s) IN lower(vehicle.vehicle)) > 0
GROUP BY vehicle.vehicle ORDER BY vehicle.vehicle LIMIT {LISTED}
"""
ADD = """
INSERT INTO enrolment (token_hash, tenant_id, vehicle, made_by, expires)
VALUES (%s, %s, %s, %s, now() + make_interval(hours => %s))
"""


class NewToken(Body):
    """For which vehicle, and how long it may be used."""

    vehicle: Annotated[str, Field(max_length=48)] = ""  # empty: the unit's own name
    hours: Annotated[int, Field(ge=1, le=MAX_HOURS)] = 24


class Revocation(Body):
    """Which vehicle, which of its keys, and why."""

    vehicle: Annotated[str, Field(max_length=48)]
    key: Annotated[str | None, Field(max_length=64)] = None  # None: every one
    reason: Annotated[str, Field(max_length=200)] = ""


class Withdrawal(Body):
    """Which token shall no longer be used."""

    token: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class EnrolmentApi:
    """What the page Enrolment asks for."""

    def __init__(self, database: Database, client: Client, address: str, fingerprint: str) -> None:
        """`address` is where units enrol; `fingerprint`, of the authority, is the second half of each token."""
        self._database, self._client = database, client
        self._address, self._fingerprint = address, fingerprint

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route("/api/enrolment", self.list)
        app.add_api_route("/api/enrolment", self.make, methods=["POST"])
        app.add_api_route("/api/withdraw", self.withdraw, methods=["POST"])
        app.add_api_route("/api/revoke", self.revoke, methods=["POST"])

    async def list(self, request: Request, find: Annotated[str, Query(max_length=48)] = "") -> Response:
        """Tokens without their text, and vehicles with the ends of their keys."""
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            tokens = await (await cursor.execute(TOKENS)).fetchall()
            vehicles = await (await cursor.execute(VEHICLES, {"find": find.strip()})).fetchall()
        return json_response(
            {"now_ms": now_ms(), "tokens": tokens, "vehicles": vehicles, "more": len(vehicles) == LISTED}
        )

    async def make(self, request: Request) -> Response:
        """Make a token: this answer alone holds it, the database keeps its hash."""
        visitor, given = visitor_of(request), await read(request, NewToken)
        if given.vehicle and not VEHICLE.fullmatch(given.vehicle):
            raise HTTPException(422, f"a vehicle's name has {RULE}; change it")
        secret = new_secret()
        values = hashlib.sha256(secret.encode()).digest(), visitor.tenant_id, given.vehicle or None, visitor.name
        async with self._database.tenant(visitor.tenant_id) as cursor:
            await cursor.execute(ADD, (*values, given.hours))
            await note(cursor, visitor.tenant_id, visitor.name, "made a token", given.vehicle or None)
        token = f"{secret}.{self._fingerprint}"
        return json_response({"command": command_for(self._address, token, given.vehicle or None)})

    async def withdraw(self, request: Request) -> Response:
        """End a token that nobody has used."""
        visitor, given = visitor_of(request), await read(request, Withdrawal)
        async with self._database.tenant(visitor.tenant_id) as cursor:
            ended = await (await cursor.execute(END_TOKEN, {"token": given.token})).fetchall()
            if not ended:
                raise HTTPException(409, "this token is used or has ended already; load the page again")
            await note(cursor, visitor.tenant_id, visitor.name, "withdrew a token", ended[0]["vehicle"])
        return json_response({})

    async def revoke(self, request: Request) -> Response:
        """Revoke the keys of a vehicle, or one of them, and tokens that were made for it.

        `told`: whether the processes of the centre were told; those that were not look by themselves.
        """
        visitor, given = visitor_of(request), await read(request, Revocation)
        async with self._database.tenant(visitor.tenant_id) as cursor:
            known = await cursor.execute("SELECT FROM vehicle WHERE vehicle = %s", (given.vehicle,))
            if not await known.fetchall():
                raise unknown(given.vehicle)
            values = {"vehicle": given.vehicle, "key": given.key, "reason": given.reason or "revoked by an operator"}
            await cursor.execute(LOCK_VEHICLE, values)
            keys = [row["key_id"] for row in await (await cursor.execute(REVOKE, values)).fetchall()]
            if not keys:
                raise HTTPException(409, "there is no key that could be revoked: all are revoked already")
            await cursor.execute(END_TOKENS, values)
            detail = {"keys": keys, "reason": values["reason"]}
            await note(cursor, visitor.tenant_id, visitor.name, "revoked", given.vehicle, detail)
        is_told = await told(self._client, REVOKED, (json.dumps({"key": key}).encode() for key in keys))
        return json_response({"keys": keys, "told": is_told})
