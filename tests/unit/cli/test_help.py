"""Every command's help has examples, and the command line accepts them."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version

import pytest
import typer
from typer.core import TyperCommand, TyperGroup
from typer.testing import CliRunner

from cli.catalogue import NAMES, SUMMARY
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


def obu(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "cli", *arguments], capture_output=True, text=True, check=False, cwd=REPOSITORY
    )


def test_the_version_is_that_of_the_package() -> None:
    done = obu("--version")
    assert (done.returncode, done.stdout) == (0, f"obu {version('obu')}\n")


def test_the_help_lists_every_command_once_with_its_first_sentence() -> None:
    done = obu("--help")
    assert done.returncode == 0
    told = " ".join(done.stdout.split())
    for name, command in ALL.items():
        if " " not in name:
            assert told.count(f" {name} {SUMMARY[name]}") == 1
            assert " ".join((command.help or "").split()).startswith(SUMMARY[name])
    assert set(SUMMARY) == {name.split()[0] for name in ALL}
    assert obu().stdout == done.stdout


def test_a_wrong_name_suggests_the_nearest_command() -> None:
    done = obu("demoo")
    assert done.returncode == 2
    assert done.stderr == "obu: there is no command 'demoo'; did you mean 'demo'? `obu --help` lists them\n"
    assert obu("--versoin").stderr.startswith("obu: there is no option '--versoin' before a command")


def test_the_shell_completes_the_names_of_commands() -> None:
    words = {"_OBU_COMPLETE": "complete_bash", "COMP_WORDS": "obu evid", "COMP_CWORD": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "cli"], capture_output=True, text=True, check=False, cwd=REPOSITORY,
        env={**os.environ, **words},
    )  # fmt: skip
    assert done.stdout.strip() == "evidence-key"


MODULES = """
import runpy, sys
sys.argv[1:] = {arguments!r}
try:
    runpy.run_module("cli", run_name="__main__", alter_sys=True)
except SystemExit:
    pass
print(*sys.modules, file=sys.stderr)
"""


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["demoo"], []])
def test_what_needs_no_command_imports_no_library(arguments: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", MODULES.format(arguments=arguments)], capture_output=True, text=True, check=True,
        cwd=REPOSITORY,
    )  # fmt: skip
    modules = done.stderr.splitlines()[-1].split()
    assert "cli.catalogue" in modules
    roots = {name.partition(".")[0] for name in modules}
    assert not {"numpy", "scipy", "pydantic", "typer", "rich", "fastapi", "services", "fleet"} & roots
    assert len(modules) < 200


@pytest.mark.parametrize("name", ["demo", "up", "run", "doctor", "tail", "keys", "token", "centre", "papers", "record"])
def test_the_help_of_a_command_imports_no_array_and_no_web_server(name: str) -> None:
    look = f"import sys; from cli.main import command_line; command_line([{name!r}]); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert not {"numpy", "scipy", "fastapi", "asn1tools"} & set(done.stdout.split())


def test_every_name_leads_to_a_command() -> None:
    for name in NAMES:
        root = typer.main.get_command(command_line([name]))
        assert isinstance(root, TyperGroup)
        assert list(root.commands) == [name]


def test_all_commands_are_found() -> None:
    assert {"demo", "solve", "record", "record repair", "papers navigation"} <= set(ALL)


def test_the_command_line_of_a_replay_imports_neither_arrays_nor_the_web_server() -> None:
    look = "import sys; from cli.main import command_line; command_line(['replay']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert not {"numpy", "scipy", "fastapi", "asn1tools"} & set(done.stdout.split())
