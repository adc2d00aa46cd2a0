"""`python -m broker.simulated`: the simulated broker as a process."""

import argparse
import asyncio
import logging
import signal
import sys
from pathlib import Path

from shared.runtime.alive import Alive

from .access_list import Acl, AclError, parse
from .broker import Broker
from .server import Server

SIGN_S = 1.0  # between two signs of life


def main() -> int:
    """Serve until SIGTERM or Ctrl-C."""
    parser = argparse.ArgumentParser(prog="python -m broker.simulated", description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=int, default=1883, help="0: any free port, which is then printed")
    parser.add_argument("--acl", type=Path, help="access list, in the format of Mosquitto's acl_file")
    parser.add_argument("--print-port", action="store_true", help="print `listening on HOST:PORT`, as with --port 0")
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s %(message)s")
    try:
        acl = _read(options.acl)
        asyncio.run(_serve(options.host, options.port, acl, announce=options.print_port or options.port == 0))
    except (OSError, OverflowError) as error:
        return _fail(f"cannot listen on {options.host}:{options.port}: {error}; try --port 0 for any free port")
    except AclError as error:
        return _fail(f"the access list {options.acl} is not valid: {error}; try `python -m broker.acl` for a valid one")
    return 0


def _read(path: Path | None) -> Acl | None:
    if path is None:
        return None
    try:
        return parse(path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise AclError(f"it cannot be read ({error})") from error


async def _serve(host: str, port: int, acl: Acl | None, *, announce: bool) -> None:
    server = Server(Broker(acl))
    await server.listen(host, port)
    loop = asyncio.get_running_loop()
    for ending in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(ending, server.stop)
    if announce:
        sys.stdout.write(f"listening on {host}:{server.port}\n")
        sys.stdout.flush()
    signs = asyncio.create_task(_tell_that_it_works())
    await server.serve()
    signs.cancel()


async def _tell_that_it_works() -> None:
    alive = Alive()
    while True:
        alive.beat(connected=True)
        await asyncio.sleep(SIGN_S)


def _fail(sentence: str) -> int:
    sys.stderr.write(sentence + "\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
