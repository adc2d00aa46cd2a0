"""The `obu` command."""

import os
import sys

from shared.errors import BadRecording, ConfigError, UserError
from shared.processes import BY_NAME


def main() -> None:
    """Run the command line; an error of the user's making is one sentence on standard error."""
    try:
        if sys.argv[1:2] == ["run"] and len(sys.argv) == 3 and sys.argv[2] in BY_NAME:
            run(sys.argv[2])  # the processes of a vehicle start without the weight of the command line
        else:
            from .main import command_line

            command_line(sys.argv[1:])(prog_name="obu")
    except ConfigError as error:
        print(f"obu: {error}", file=sys.stderr)  # this is the command line
        sys.exit(os.EX_CONFIG)
    except (UserError, BadRecording) as error:
        print(f"obu: {error}", file=sys.stderr)  # this is the command line
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)


def run(name: str) -> None:
    """Run one process of the unit, without Numba: it saves nothing sample by sample, and takes 120 MB."""
    os.environ.setdefault("NUMBA_DISABLE_JIT", "1")
    from shared.runtime.config import load_vehicle
    from shared.runtime.live import run_process

    run_process(name, load_vehicle())


if __name__ == "__main__":
    main()
