"""Answers NATS who a connecting vehicle is and what it may do.

The server has verified the certificate by the authority and its dates; the callout looks up whether it is revoked. A
vehicle connects by its own name alone: NATS ends the older of two connections of one client id, whoever has it. The
connection ends after an hour, so that a revocation needs no list of certificates at the server; those that are open are
ended by `revocation.py`.
"""

import logging
import random
from collections.abc import Awaitable, Callable
from typing import NamedTuple

from cryptography import x509
from nats.aio.client import Client
from nats.aio.msg import Msg

from shared.fleet.topics import BATCH, LIVE, RECEIPT, WATCH, subject

from .authority import name_in
from .nkeys import Issuer, claims_of, now_s

log = logging.getLogger(__name__)

SUBJECT = "$SYS.REQ.USER.AUTH"
LIFE_S = 3600
JITTER = 0.1  # of the life, so that vehicles do not all come back at once
ACCOUNT = "CENTRE"
MAX_PEM_BYTES = 16_384


class PresentedCertificate(NamedTuple):
    """A certificate that the server has verified."""

    vehicle: str
    serial: str  # hexadecimal


class Callout:
    """Decides about each connection.

    `prepare` is awaited before, with the identity of the server; `is_valid` looks the certificate up in the database.
    """

    def __init__(
        self,
        issuer: Issuer,
        prepare: Callable[[str], Awaitable[None]],
        is_valid: Callable[[PresentedCertificate], Awaitable[bool]],
    ) -> None:
        self._issuer, self._prepare, self._is_valid = issuer, prepare, is_valid

    async def serve(self, client: Client) -> None:
        """Answer questions of the server from now on."""
        await client.subscribe(SUBJECT, cb=self._answer)

    async def _answer(self, message: Msg) -> None:
        try:
            request = claims_of(message.data.decode("ascii"))
            about = request["nats"]
            assert isinstance(about, dict)
            user, server = str(about["user_nkey"]), str(about["server_id"]["id"])
        except (ValueError, KeyError, TypeError, AssertionError) as error:
            log.warning("NATS asks what cannot be read: %s", error)
            return
        reason = "this vehicle is not admitted"
        token = ""
        try:
            presented = presented_in(about)
            if presented is not None and await self._is_valid(presented):
                await self._prepare(server)
                token = self._admission(presented.vehicle, user)
        except Exception as error:  # noqa: BLE001  # whatever fails, nobody is admitted by it
            log.error("cannot decide about a connection: %s", error)
        content = {"type": "authorization_response", "version": 2, **({"jwt": token} if token else {"error": reason})}
        await message.respond(self._issuer.token(user, server, content).encode())

    def _admission(self, vehicle: str, user: str) -> str:
        """What a vehicle may do, for an hour."""
        content = {
            "type": "user",
            "version": 2,
            "pub": {"allow": [subject(vehicle, BATCH), subject(vehicle, LIVE) + ".*.*"]},
            "sub": {"allow": [subject(vehicle, RECEIPT), subject(vehicle, WATCH)]},
            "subs": 8,
            "data": -1,
            "payload": 131_072,
            "allowed_connection_types": ["MQTT"],
        }
        life_s = round(LIFE_S * (1.0 - JITTER * random.random()))
        return self._issuer.token(user, ACCOUNT, content, name=vehicle, exp=now_s() + life_s)


def presented_in(about: dict[str, object]) -> PresentedCertificate | None:
    """Find the verified certificate of a request; None without one, or if the client id is of another vehicle."""
    match about.get("client_tls"):
        case {"verified_chains": [[str() as pem, *_], *_]} if len(pem) <= MAX_PEM_BYTES:
            certificate = x509.load_pem_x509_certificate(pem.encode())
        case _:
            return None
    name = name_in(certificate)
    match about.get("client_info"):
        case {"mqtt_id": str() as client_id} if client_id == name:
            return PresentedCertificate(client_id, f"{certificate.serial_number:x}")
    return None
