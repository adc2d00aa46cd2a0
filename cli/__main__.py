"""The `obu` command."""

import difflib
import gc
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from shared import ROOT, VERSION
from shared.errors import BadRecording, ConfigError, UserError
from shared.processes import BY_NAME
from shared.runtime import reports

from .catalogue import NAMES, SUMMARY, help_text

GARBAGE = 50_000
COMPLETION = ("--install-completion", "--show-completion")


def main() -> None:
    """Run the command line; an error of the user's making is one sentence on standard error."""
    keep_to_this_code()
    reports.begin()
    try:
        if sys.argv[1:2] == ["run"] and len(sys.argv) == 3 and sys.argv[2] in BY_NAME:
            run(sys.argv[2])  # the processes of a vehicle start without the weight of the command line
        elif not answered(sys.argv[1:]):
            if sys.argv[1:2] == ["verify"]:
                os.environ["NUMBA_DISABLE_JIT"] = "1"  # to the bit as processes of a vehicle, which lack it
            command = imported(sys.argv[1:])
            command(prog_name="obu")
    except ConfigError as error:
        _fail(error, os.EX_CONFIG)
    except (UserError, BadRecording) as error:
        _fail(error, 2)
    except SystemExit as end:  # raised by typer, within what it says of wrong options
        if (message := getattr(end.__context__, "format_message", None)) is not None:
            reports.tell(error=message())
        raise
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)


def _fail(error: Exception, code: int) -> NoReturn:
    print(f"obu: {error}", file=sys.stderr)  # this is the command line
    reports.tell(error=str(error))
    sys.exit(code)


def answered(arguments: list[str]) -> bool:
    """Print what needs no command: the help and the version; raises `UserError` for a name that is no command."""
    first = next(iter(arguments), "")
    if first in NAMES or first in COMPLETION or "_OBU_COMPLETE" in os.environ:  # the shell asks for completions
        return False
    if first == "--version":
        print(f"obu {VERSION}")
    elif first in ("", "--help"):
        print(help_text())
        if not first:
            sys.exit(2)
    elif first.startswith("-"):
        raise UserError(f"there is no option {first!r} before a command; `obu --help` lists the commands")
    else:
        near = difflib.get_close_matches(first, SUMMARY, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise UserError(f"there is no command {first!r}; {hint}`obu --help` lists them")
    return True


def keep_to_this_code() -> None:
    """Let processes that this one starts run the same code: `python -m` would prefer that of the working folder."""
    with suppress(OSError):  # a working folder that was removed
        if Path.cwd() != ROOT:
            os.environ["PYTHONSAFEPATH"] = "1"


def imported(arguments: list[str]) -> Callable[..., object]:
    """Import the command line; what that makes stays, and is not searched for garbage then or later.

    Messages are freed without such a search, so that one after `GARBAGE` new objects is enough: with the 700 of Python
    it takes a tenth of the time of a command.
    """
    gc.disable()
    from .main import command_line

    command = command_line(arguments)
    gc.freeze()
    gc.set_threshold(GARBAGE)
    gc.enable()
    return command


def run(name: str) -> None:
    """Run one process of the unit, without Numba: it saves nothing sample by sample, and takes 120 MB."""
    os.environ.setdefault("NUMBA_DISABLE_JIT", "1")
    from shared.runtime.config import load_vehicle
    from shared.runtime.live import run_process

    run_process(name, load_vehicle())


if __name__ == "__main__":
    main()
