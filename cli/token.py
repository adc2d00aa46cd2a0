"""`obu token`: who may open the page of a unit."""

import os
import re
import socket
import time
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import typer

from services.monitoring.status.web.access.rights import MEANING, Right
from services.monitoring.status.web.access.tokens import Tokens, tokens_folder
from shared.bounded import TOML_BYTES, read_text
from shared.bus.contract import table
from shared.errors import UserError
from shared.runtime.config import page_of, state_dir
from shared.runtime.private import STATE

from .qr import show

LINK_MINUTES = 15.0
SERVICES_ENVIRONMENT = Path("/etc/obu/obu.env")  # of deploy/systemd
SHOWN_OF_HASH = 8
DAY_S = 86_400.0


class TokenRole(StrEnum):
    """Roles that a token may have."""

    VIEW = "view"
    OPERATE = "operate"
    ADMIN = "admin"


RoleOption = Annotated[
    TokenRole, typer.Option("--role", help="; ".join(f"{role}: {MEANING[Right(role)]}" for role in TokenRole) + ".")
]


def _tokens() -> Tokens:
    return Tokens(tokens_folder(state_dir()))


def list_tokens() -> int:
    """List the tokens, and the browsers that have logged in.

    Example: [bold]obu token list[/]
    """
    tokens = _tokens()
    content = tokens.content()
    if tokens.problem and tokens.path.exists():
        raise UserError(f"cannot read {tokens.path}: {tokens.problem}; run this as the user who runs the unit")
    now_s = time.time()
    rows = [
        (token.name, token.role, _day(token.created_s), _end(token.expires_s), token.hash[:SHOWN_OF_HASH],
         str(sum(session.token == token.name for session in content.sessions)))
        for token in content.tokens if token.expires_s is None or token.expires_s > now_s
    ]  # fmt: skip
    named = {token.name for token in content.tokens}
    rows += [
        (session.token, session.role, _day(session.created_s), _end(session.expires_s), "used", "1")
        for session in content.sessions if session.token not in named and session.expires_s > now_s
    ]  # fmt: skip
    if not rows:
        print("no tokens; make a link with `obu token show-link`, or a token with `obu token add NAME`")
        return 0
    print(table(("name", "role", "created", "expires", "hash", "logins"), rows))
    return 0


def add_token(
    name: Annotated[str, typer.Argument(help="Who or what it is for: letters, digits, -, _ and dots.")],
    role: RoleOption = TokenRole.VIEW,
    days: Annotated[
        float | None, typer.Option(min=0.001, max=3650.0, metavar="DAYS", help="Days until it expires; default: never.")
    ] = None,
) -> int:
    """Make a token and print it; for a person, or a program that sends `Authorization: Bearer TOKEN`.

    Examples:
    [bold]obu token add prometheus --role view[/]
    [bold]obu token add workshop --role operate --days 30[/]
    """
    secret = _tokens().add(name, Right(role), seconds=None if days is None else days * DAY_S)
    print(secret)
    typer.echo(f"token {name}, role {role}: copy it now, it cannot be shown again", err=True)
    return 0


def revoke_token(name: Annotated[str, typer.Argument(help="As `obu token list` shows it.")]) -> int:
    """Remove a token, and log out every browser that logged in with it.

    Example: [bold]obu token revoke workshop[/]
    """
    ended = _tokens().revoke(name)
    print(f"revoked {name}" + (f", and ended {ended} login{'' if ended == 1 else 's'}" if ended else ""))
    return 0


def show_link(
    *,
    role: RoleOption = TokenRole.ADMIN,
    minutes: Annotated[
        float, typer.Option(min=0.1, max=10_080.0, metavar="MINUTES", help="Minutes until the link expires.")
    ] = LINK_MINUTES,
    address: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Address of the page as a browser reaches it, such as https://obu.local."),
    ] = None,
    qr: Annotated[bool, typer.Option("--qr", help="Print it as a QR code too, for the camera of a phone.")] = False,
) -> int:
    """Print a link that logs in one browser, once.

    The token in it stands behind the #, which browsers send to no server.

    Examples:
    [bold]obu token show-link[/]
    [bold]obu token show-link --role view --minutes 60 --address http://192.168.1.7:8080[/]
    [bold]obu token show-link --qr[/]
    """
    folder = state_dir()
    secret = _tokens().add_temporary("link", Right(role), seconds=minutes * 60.0, single_use=True)
    reached = address or page_address(folder)
    if qr and not address and not is_beyond_loopback(urlsplit(reached).hostname):
        if outside := listens_on_network(installed_host(folder)) and network_address(port_of(reached)):
            reached = outside
        else:
            typer.echo(f"a phone does not reach {reached}: name the address it reaches with --address", err=True)
    link = login_link(reached, secret)
    if qr:
        show(link)
    print(link)
    typer.echo(f"logs in one browser as {role}, within {minutes:g} min", err=True)
    return 0


def login_link(address: str, secret: str) -> str:
    """The link that logs in at the page of an address."""
    return f"{address.rstrip('/')}/login#token={secret}"


def page_address(folder: Path) -> str:
    """The address at which the unit with this state folder serves its page; of one that does not run the usual one."""
    return page_of(folder) or "http://127.0.0.1:8080"


def network_address(port: int) -> str | None:
    """The address of a page that listens on all interfaces, as other machines reach it; None without a network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # an address for documentation: nothing is sent
        except OSError:
            return None
        host = str(probe.getsockname()[0])
    return None if host.startswith("127.") else f"http://{host}:{port}"


def installed_host(folder: Path) -> str | None:
    """Where the page of an installed unit listens, by the file that its services have as environment."""
    if folder != STATE:
        return None
    try:
        text = read_text(SERVICES_ENVIRONMENT, TOML_BYTES)
    except (OSError, ValueError):
        return None
    found = re.findall(r"""^OBU_HTTP_HOST=["']?([^"'\s]+)""", text, re.M)
    return found[-1] if found else None


def listens_on_network(installed: str | None = None) -> bool:
    """Whether the environment, or that of the installed unit, lets the page listen beyond this machine."""
    return is_beyond_loopback(installed or os.environ.get("OBU_HTTP_HOST", "127.0.0.1"))


def is_beyond_loopback(host: str | None) -> bool:
    """Whether other machines may reach a host."""
    return host is not None and host not in ("localhost", "::1") and not host.startswith("127.")


def port_of(address: str) -> int:
    """Port of an address of the page."""
    return urlsplit(address).port or 80


def _day(seconds: float) -> str:
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M}"


def _end(seconds: float | None) -> str:
    return "never" if seconds is None else _day(seconds)
