"""Calls of Linux that Python does not have: prctl(2), and the command line that other programs see."""

import ctypes
import os
from pathlib import Path

PDEATHSIG, NAME, SUBREAPER, NO_NEW_PRIVILEGES = 1, 15, 36, 38  # of <sys/prctl.h>
ARGUMENTS = 47  # place of arg_start in /proc/self/stat, from 0; that of arg_end is the next
LONGEST_NAME = 15  # bytes of the short name of a thread


def end_with_parent(number: int) -> None:
    """Let the kernel send a signal to this process when its parent ends."""
    _prctl(PDEATHSIG, number)


def adopt_orphans(*, adopt: bool = True) -> None:
    """Become the parent of every descendant whose own parent ends."""
    _prctl(SUBREAPER, int(adopt))


def forbid_new_privileges() -> None:
    """Forbid this process and its descendants to gain rights by a program, as sudo does."""
    _prctl(NO_NEW_PRIVILEGES, 1)


def threads() -> int:
    """Number of threads of this process, those of libraries in C as well."""
    return sum(1 for _ in Path("/proc/self/task").iterdir())


def show_as(command: str, name: str) -> None:
    """Let `ps` and `top` show another command line and name of this process.

    The kernel reads the command line from the memory in which the program found its arguments, up to the first zero
    if the last byte is none; what does not fit is cut.
    """
    text = Path("/proc/self/stat").read_text(encoding="ascii", errors="replace").rpartition(") ")[2].split()
    start, end = (int(text[place - 2]) for place in (ARGUMENTS, ARGUMENTS + 1))  # without number and name
    room = end - start
    if start and room > 1:
        shown = command.encode()[: room - 2]
        ctypes.memmove(start, shown + b"\0" * (room - 1 - len(shown)) + b" ", room)
    _library().prctl(NAME, ctypes.c_char_p(name.encode()[:LONGEST_NAME]), 0, 0, 0)


def _prctl(option: int, value: int) -> None:
    if _library().prctl(option, ctypes.c_ulong(value), ctypes.c_ulong(0), ctypes.c_ulong(0), ctypes.c_ulong(0)) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _library() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
