"""Every command's help has examples, and the command line accepts them."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version

import typer
from typer.core import TyperCommand, TyperGroup
from typer.testing import CliRunner

from cli.main import command_line
from tests.support.cases import each
from tests.support.data import REPOSITORY


def commands(group: TyperGroup, path: str = "") -> Iterator[tuple[str, TyperCommand | TyperGroup]]:
    """Walk over every command that the help shows, groups included."""
    for name, command in group.commands.items():
        if command.hidden:
            continue
        assert isinstance(command, TyperCommand | TyperGroup)
        yield f"{path} {name}".strip(), command
        if isinstance(command, TyperGroup):
            yield from commands(command, f"{path} {name}".strip())


APP = command_line([])
ROOT = typer.main.get_command(APP)
ALL = dict(commands(ROOT)) if isinstance(ROOT, TyperGroup) else {}


@each("name", ALL)
def test_every_command_has_examples_that_the_command_line_accepts(name: str) -> None:
    examples = re.findall(r"\[bold\](.+?)\[/\]", ALL[name].help or "")
    assert any(f"obu {name}" in example for example in examples)
    for example in examples:
        words = shlex.split(example.partition(" > ")[0])
        arguments = words[words.index("obu") + 1 :]
        path = next(" ".join(arguments[:n]) for n in (2, 1) if " ".join(arguments[:n]) in ALL)
        # Parsed as the command would, but not run: an option that is gone or renamed raises here.
        ALL[path].make_context(path, arguments[len(path.split()) :])


@each("name", ALL)
def test_the_value_of_every_option_is_named_by_its_meaning_or_its_choices(name: str) -> None:
    text = CliRunner().invoke(APP, [*name.split(), "--help"], env={"COLUMNS": "200"}).output
    options = [line for line in text.splitlines() if re.match(r"\W+--?\w", line)]
    assert len(options) >= 1
    assert not [line for line in options if re.search(r"<(str|path|int|float|list)", line)], "give a metavar"


def test_the_version_is_that_of_the_package() -> None:
    found = CliRunner().invoke(APP, ["--version"])
    assert found.exit_code == 0 and found.output == f"obu {version('obu')}\n"


def test_all_commands_are_found() -> None:
    assert {"demo", "solve", "record", "record repair", "papers navigation"} <= set(ALL)


def test_the_command_line_of_a_replay_imports_neither_arrays_nor_the_web_server() -> None:
    look = "import sys; from cli.main import command_line; command_line(['replay']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert not {"numpy", "scipy", "fastapi", "asn1tools"} & set(done.stdout.split())
