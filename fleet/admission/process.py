"""Serves enrolment and renewal over HTTPS, and answers the authorization callout of NATS."""

import asyncio
import logging
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Annotated, TypeVar

import psycopg
import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse
from nats.aio.client import Client
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fleet.bus import closed, connected
from fleet.centre import Centre
from fleet.serving import until_cancelled
from shared.page.access.limits import Connections, quiet_accept
from shared.page.access.peer import place_of
from shared.page.server import make_server

from .authority import Authority, BadRequest
from .callout import Callout
from .enrolment import Enrolment, Refusal
from .known import VehicleDatabase
from .limits import Refusals
from .nkeys import Issuer
from .revocation import Revocation
from .streams import Streams

log = logging.getLogger(__name__)

MAX_BODY_BYTES = 32_768
BODY_S = 10.0  # in which a body must be there
MAX_CONCURRENT = 8  # requests that are verified; more wait
AT_ONCE_SUSPECT = 2  # of addresses that were refused too often
CONNECTIONS, PER_ADDRESS = 400, 64  # vehicles of a whole fleet may share an address
RENEW_PERIOD_S = 12 * 3600.0  # of looking at the certificate of the servers
NO_REQUEST = "this is no request of a unit of this version"
Text = Annotated[str, Field(max_length=8192)]
Word = Annotated[str, Field(max_length=512)]
Statement = Annotated[dict[Word, Word], Field(max_length=16)]
Body = TypeVar("Body", bound=BaseModel)


class EnrolRequest(BaseModel):
    """Body of POST /enrol."""

    model_config = ConfigDict(extra="forbid")
    token: Annotated[str, Field(max_length=128)]
    vehicle: Annotated[str, Field(max_length=48)]
    request: Text
    evidence: Statement


class RenewRequest(BaseModel):
    """Body of POST /renew."""

    model_config = ConfigDict(extra="forbid")
    certificate: Text
    request: Text
    made_ms: Annotated[int, Field(ge=0, le=4_102_444_800_000)]
    signature: Annotated[str, Field(max_length=256, pattern=r"^([0-9a-f]{2})*$")]
    evidence: Statement


def make_app(enrolment: Enrolment, authority: Authority) -> FastAPI:
    """Put the routes together."""
    app = FastAPI(title="Admission of a control centre", docs_url=None, redoc_url=None, openapi_url=None)

    answers = Answers()

    @app.get("/authority.pem")
    def give_authority() -> Response:
        return Response(authority.pem, media_type="application/x-pem-file")

    @app.post("/enrol")
    async def enrol(request: Request) -> Response:
        def holder(body: EnrolRequest) -> str | None:
            return enrolment.token_id(body.token)

        return await answers.answer(request, EnrolRequest, holder, lambda body: enrolment.enrol(**body.model_dump()))

    @app.post("/renew")
    async def renew(request: Request) -> Response:
        def holder(body: RenewRequest) -> str | None:
            try:
                signature = bytes.fromhex(body.signature)
                return enrolment.proven(body.certificate, body.request, body.made_ms, signature).vehicle
            except Refusal:
                return None

        def work(body: RenewRequest) -> dict[str, object]:
            given = body.model_dump(exclude={"signature"})
            return enrolment.renew(**given, signature=bytes.fromhex(body.signature))

        return await answers.answer(request, RenewRequest, holder, work)

    return app


class Answers:
    """Reads requests, has them done, and says what was wrong."""

    def __init__(self) -> None:
        self._addresses, self._holders = Refusals(), Refusals()
        self._working, self._suspect = asyncio.Semaphore(MAX_CONCURRENT), asyncio.Semaphore(AT_ONCE_SUSPECT)

    async def answer(
        self,
        request: Request,
        kind: type[Body],
        holder_of: Callable[[Body], str | None],
        work: Callable[[Body], dict[str, object]],
    ) -> Response:
        """Read a bounded body, and do the work in a thread; `holder_of` names the token or vehicle that it proves."""
        address = place_of(request.client.host) if request.client else ""
        wait_s = self._addresses.begin(address)
        counted = [] if wait_s else [(self._addresses, address)]
        data = await _body(request)
        if data is None:
            return _refused(413, "the request is too long or too slow")
        try:
            body = kind.model_validate_json(data)
            async with self._suspect if wait_s else self._working:
                holder = await asyncio.to_thread(holder_of, body)
                if holder is not None:
                    wait_s = self._holders.begin(holder)
                    counted += [] if wait_s else [(self._holders, holder)]
                if wait_s:
                    return _too_many(wait_s)
                done = await asyncio.to_thread(work, body)
        except ValidationError as error:
            return _too_many(wait_s) if wait_s else _refused(422, f"{NO_REQUEST}: {error.errors()[0]['msg']}")
        except (Refusal, BadRequest) as error:
            log.warning("refused: %s", error)
            return _refused(403, str(error))
        except psycopg.Error as error:
            log.error("the database cannot be used: %s", error)
            _take_back(counted)
            return _refused(503, "the centre cannot reach its database; try again later")
        _take_back(counted)
        return JSONResponse(done)


def _take_back(counted: list[tuple[Refusals, str]]) -> None:
    for refusals, name in counted:
        refusals.take_back(name)


def _too_many(wait_s: float) -> Response:
    return _refused(429, f"too many requests of this address were refused; try again in {wait_s / 60:.0f} min")


async def _body(request: Request) -> bytes | None:
    """Read the body; None: it is too long, or does not come."""
    data = bytearray()
    try:
        async with asyncio.timeout(BODY_S):
            async for part in request.stream():
                data += part
                if len(data) > MAX_BODY_BYTES:
                    return None
    except TimeoutError:
        return None
    return bytes(data)


def _refused(status: int, text: str) -> Response:
    return JSONResponse({"detail": text}, status)


async def serve(centre: Centre, dsn: str) -> None:
    """Serve until cancelled."""
    asyncio.get_running_loop().set_exception_handler(quiet_accept)
    authority = Authority(centre.authority)
    enrolment = Enrolment(lambda: psycopg.connect(dsn, connect_timeout=5), authority, centre.address)
    known = VehicleDatabase(dsn)
    async with AsyncExitStack() as stack:
        stack.push_async_callback(known.close)
        callout, bus, system = [await _joined(centre, name, stack) for name in ("callout", "admission", "system")]
        await Callout(Issuer(centre.secret("issuer", 32)), Streams(bus).make, known.is_valid).serve(callout)
        revocation = asyncio.create_task(Revocation(bus, system, known.revoked).run())
        stack.callback(revocation.cancel)
        server = _server(make_app(enrolment, authority), centre)
        renewal = asyncio.create_task(_renew_certificate(server, authority, centre))
        stack.callback(renewal.cancel)
        await until_cancelled(server)


async def _joined(centre: Centre, name: str, stack: AsyncExitStack) -> Client:
    client = await connected(centre.nats(name), name)
    stack.push_async_callback(closed, client)
    return client


def _server(app: FastAPI, centre: Centre) -> uvicorn.Server:
    server = make_server(app, Connections(CONNECTIONS, PER_ADDRESS, place=place_of))
    server.config.host, server.config.port = centre.settings.listen, centre.settings.enrol_port
    server.config.ssl_certfile, server.config.ssl_keyfile = map(str, Authority(centre.authority).server(centre.names))
    return server


async def _renew_certificate(server: uvicorn.Server, authority: Authority, centre: Centre) -> None:
    """Make the certificate of the servers anew near its end; NATS is told by who has started it."""
    while True:
        await asyncio.sleep(RENEW_PERIOD_S)
        try:
            files = await asyncio.to_thread(authority.server, centre.names)
            if server.config.ssl is not None:
                server.config.ssl.load_cert_chain(*files)  # for connections from now on
        except (OSError, ValueError) as error:  # such as a full disk; ssl.SSLError is an OSError
            log.error("the certificate of the servers is not made anew, tried again in %d h: %s",
                      RENEW_PERIOD_S // 3600, error)  # fmt: skip
