"""`python -m shared.runtime.warm SOCKET FUNCTION MODULE...`: the parent of forked processes.

Each child calls the function, written as module:function, with the arguments of its start in `sys.argv`.
"""

import signal
import socket
import sys
from collections.abc import Callable
from importlib import import_module
from typing import cast


def main() -> None:
    """Serve until the supervisor closes the connection; in a child, be the process that was asked for."""
    descriptor, function, *modules = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # who started all may have ignored it
    from .child import become
    from .kernel import show_as
    from .parent import prepare, serve

    show_as("python -m shared.runtime.warm", "warm parent")  # the names of modules are room for those of children

    module, _, name = function.partition(":")
    prepare((module, *modules))
    connection = socket.socket(fileno=int(descriptor))
    born = serve(connection)
    if born is None:
        return
    connection.detach()  # `become` closes it, with all others
    become(born)
    cast("Callable[[], None]", getattr(import_module(module), name))()


if __name__ == "__main__":
    main()
