"""Builds the command line: with the command that is called, and nothing of the others."""

import functools
import signal
from collections.abc import Callable, Sequence
from importlib import import_module

import typer

from .catalogue import ABOUT, COMMANDS, GROUPS, HIDDEN, NAMES, SUMMARY
from .commands.common import end_on_sigterm


def command_line(arguments: Sequence[str]) -> typer.Typer:
    """Give the command line with the command that is called; without the name of one, with all of them."""
    first = next(iter(arguments), "")
    wanted = _wanted(first, " ".join(arguments[:2]))
    app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode="rich")
    app.callback()(_program)
    groups = {"": app}
    for path in wanted:
        _add(path, groups)
    return app


def _wanted(first: str, first_two: str) -> list[str]:
    """Commands that are built; one below a command with an argument only where it is named."""
    if first_two in COMMANDS and _is_beside(first_two):
        return [first_two]
    return [path for path in COMMANDS if (first not in NAMES or path.split()[0] == first) and not _is_beside(path)]


def _is_beside(path: str) -> bool:
    above = path.rpartition(" ")[0]
    return above in COMMANDS and above not in GROUPS


def _program() -> None:
    """Is the root, also where there is only one command."""


_program.__doc__ = ABOUT


def _add(path: str, groups: dict[str, typer.Typer]) -> None:
    """Add a command to its group, which is made with its first command."""
    module, function = COMMANDS[path]
    work = _ended(getattr(import_module(f".{module}", __package__), function))
    above, _, name = path.rpartition(" ")
    if path in GROUPS:
        _group(path, groups).callback(invoke_without_command=True)(work)
    else:
        _group(above, groups).command(name, hidden=path in HIDDEN)(work)


def _group(path: str, groups: dict[str, typer.Typer]) -> typer.Typer:
    if path not in groups:
        above, _, name = path.rpartition(" ")
        group = typer.Typer(no_args_is_help=path not in COMMANDS)  # the help of `record` is that of its function
        if path not in COMMANDS:
            group.info.help = "\n\n".join(part for part in (SUMMARY.get(path), GROUPS.get(path)) if part)
        _group(above, groups).add_typer(group, name=name)
        groups[path] = group
    return groups[path]


def _ended(function: Callable[..., int | None]) -> Callable[..., None]:
    """Turn a function that returns its exit code into a command; one that SIGTERM ends has not succeeded."""

    @functools.wraps(function)
    def command(**arguments: object) -> None:
        end_on_sigterm(128 + signal.SIGTERM)
        if (status := function(**arguments)) is not None:
            raise typer.Exit(status)

    return command
