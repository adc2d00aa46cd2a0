"""Forms and workflow of the forge: they can be read, name commands that exist, and CI runs what everybody runs."""

import re
from pathlib import Path

import pytest
import typer
import yaml
from typer.core import TyperGroup

from cli.main import command_line
from tests.support.data import REPOSITORY

FOLDER = REPOSITORY / ".github"
FORMS = sorted((FOLDER / "ISSUE_TEMPLATE").glob("[0-9]*.yml"))
WORKFLOW = FOLDER / "workflows" / "ci.yml"
INPUTS = {"textarea", "input", "dropdown", "checkboxes"}  # of a form; markdown is text


def commands() -> set[str]:
    root = typer.main.get_command(command_line([]))
    assert isinstance(root, TyperGroup)
    return set(root.commands) | {"--version"}


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_a_form_has_a_name_and_asks_by_labels_of_its_own(path: Path) -> None:
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert form["name"] and form["description"] and form["labels"]
    asked = [part for part in form["body"] if part["type"] != "markdown"]
    assert {part["type"] for part in asked} <= INPUTS and asked
    names = [part["id"] for part in asked]
    assert len(names) == len(set(names)) and all(part["attributes"]["label"] for part in asked)
    assert any(part.get("validations", {}).get("required") for part in asked)


def test_there_is_a_form_for_a_fault_a_verdict_a_device_and_a_question() -> None:
    assert [path.stem for path in FORMS] == ["1-bug", "2-verdict", "3-device", "4-question"]
    assert "`obu doctor`" in FORMS[0].read_text() and "MCAP" in FORMS[1].read_text()
    assert yaml.safe_load((FOLDER / "ISSUE_TEMPLATE" / "config.yml").read_text())["blank_issues_enabled"] is False


def test_forms_name_commands_and_targets_that_exist() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in (*FORMS, FOLDER / "pull_request_template.md"))
    named = set(re.findall(r"`obu (\S+?)[ `]", text))
    assert len(named) > 4 and named <= commands(), named - commands()
    targets = set(re.findall(r"^([\w-]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE))
    made = set(re.findall(r"`make (\w+)`", text))
    assert {"quick", "test"} <= made <= targets
    files = re.findall(r"`((?:docs/|CHANGELOG|SECURITY)[\w./-]*)`", text)
    assert files and all((REPOSITORY / file).exists() for file in files)


def test_the_workflow_runs_what_everybody_runs_with_the_oldest_python() -> None:
    text = WORKFLOW.read_text(encoding="utf-8")
    (job,) = yaml.safe_load(text)["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step][-1] == ".ci/run"
    assert (REPOSITORY / ".ci" / "run").stat().st_mode & 0o111
    assert job["container"] == "debian:12", "its Python is 3.11"
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@v\d+", step["uses"]) for step in job["steps"] if "uses" in step)
    assert yaml.safe_load(text)["permissions"] == {"contents": "read"}
