"""`python -m broker.simulated`: the simulated broker as a process."""

import argparse
import asyncio
import logging
import signal
import sys
from pathlib import Path

from shared.runtime.alive import LivenessSignal

from ..passwords import Passwords, PasswordsError
from .access_list import AclError, parse
from .broker import Broker
from .server import Server

SIGN_S = 1.0  # between two signs of life


def main() -> int:
    """Serve until SIGTERM or Ctrl-C."""
    parser = argparse.ArgumentParser(prog="python -m broker.simulated", description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=int, default=1883, help="0: any free port, which is then printed")
    parser.add_argument("--socket", type=Path, help="Unix socket to listen on as well, for the processes of the unit")
    parser.add_argument("--acl", type=Path, help="access list, in the format of Mosquitto's acl_file")
    parser.add_argument(
        "--passwords", type=Path, help="password file, as Mosquitto's; without it every client is who it says"
    )
    parser.add_argument("--print-port", action="store_true", help="print `listening on HOST:PORT`, as with --port 0")
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s %(message)s")
    try:
        rules = _Rules(options.acl, options.passwords)
        rules.read()
        asyncio.run(_serve(options, rules))
    except (OSError, OverflowError) as error:
        return _fail(f"cannot listen on {options.host}:{options.port}: {error}; try --port 0 for any free port")
    except AclError as error:
        return _fail(f"the access list {options.acl} is not valid: {error}; try `python -m broker.acl` for a valid one")
    except PasswordsError as error:
        return _fail(f"the password file {options.passwords} is not valid: {error}; `obu keys make` writes a valid one")
    return 0


class _Rules:
    """Access list and password file; read anew on SIGHUP, as by Mosquitto."""

    def __init__(self, acl: Path | None, passwords: Path | None) -> None:
        self.broker = Broker()
        self._acl, self._passwords = acl, passwords

    def read(self) -> None:
        """Read both; raises `AclError` or `PasswordsError`, and then what held before holds."""
        acl = None if self._acl is None else parse(_text(self._acl, AclError))
        passwords = None if self._passwords is None else Passwords(_text(self._passwords, PasswordsError))
        before = self.broker.passwords
        self.broker.acl, self.broker.passwords = acl, passwords
        if before is not None and passwords is not None:
            for session in tuple(self.broker.sessions.values()):
                if passwords.lines.get(session.user or "") != before.lines.get(session.user or ""):
                    session.writer.end()  # its secret is no longer the one

    def read_anew(self) -> None:
        """Read both, and log why that was not possible."""
        try:
            self.read()
        except (AclError, PasswordsError) as error:
            logging.getLogger(__name__).error("the rules stay as they were: %s", error)


def _text(path: Path, kind: type[AclError | PasswordsError]) -> str:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise kind(f"it cannot be read ({error})") from error


async def _serve(options: argparse.Namespace, rules: _Rules) -> None:
    server = Server(rules.broker)
    await server.listen(options.host, options.port, options.socket)
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGHUP, rules.read_anew)
    for ending in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(ending, server.stop)
    if options.print_port or options.port == 0:
        sys.stdout.write(f"listening on {options.host}:{server.port}\n")
        sys.stdout.flush()
    signs = asyncio.create_task(_tell_that_it_works())
    await server.serve()
    signs.cancel()


async def _tell_that_it_works() -> None:
    alive = LivenessSignal()
    while True:
        alive.beat(connected=True)
        await asyncio.sleep(SIGN_S)


def _fail(sentence: str) -> int:
    sys.stderr.write(sentence + "\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
