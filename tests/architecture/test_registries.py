"""What is added is complete: each module is used, and each attack, page, command, monitor and hypothesis is everywhere.

The recipes of `docs/how-to/add` rely on these tests.
"""

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
import typer
from typer.core import TyperGroup

from cli.attack_lab.cases import ATTACKS as CASES
from cli.catalogue import COMMANDS
from cli.doctor.devices import DRIVERS
from cli.main import command_line
from docs.picture import DEMOS
from services.core.fusion.hypotheses.bank import SOLVED
from services.core.trust.facts import Monitor
from services.core.trust.hypotheses.priors import PRIOR
from services.core.trust.verdict import SOLVED_BY_THE_BANK
from services.monitoring.status.page import DASHBOARD
from services.sensors.simulator.attacks.effects import ON_INERTIAL, ON_NEIGHBOURS, ON_ODOMETER, ON_SIGNALS
from shared.messages.navigation import AidingKind
from shared.messages.simulation import AttackName
from shared.messages.trust import Hypothesis
from shared.processes import PROCESSES, Kind, ProcessRow
from shared.rejects import reason_of
from tests.support.reject_kinds import kinds_in_source

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("cli", "services", "shared", "fleet", "broker")
# Modules that are run by their name, and not imported.
RUN = {
    "broker.probe",
    "services.monitoring.status.series.recorded",
    "shared.recording.summary",
    "shared.settings.check",
    *(f"cli.{module}" for module, _ in COMMANDS.values()),
}
PROGRAMS = (".process", ".__main__")  # imported by the name of the process, run as programs
NOT_OPENED = ("sensors.v2x", "sensors.power")  # a network, and what only the driver may open
MIGRATIONS = "fleet.database.migrations."  # Alembic reads the folder


def sources(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from (path for path in (ROOT / folder).rglob("*.py") if "node_modules" not in path.parts)


def imports(path: Path) -> set[str]:
    """Names of modules, and of what is in them, that a file imports."""
    package = list(path.relative_to(ROOT).parts[:-1])
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    return found


def page(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def javascript(name: str, table: str) -> str:
    """Text of a table of the dashboard, which stands in one line or ends with a line of its own."""
    text = (DASHBOARD / name).read_text(encoding="utf-8")
    found = re.search(rf"\b{table} ?[=:] ([{{\[](?:\n.*?\n[}}\]]|[^\n]*))", text, re.DOTALL)
    assert found, f"there is no table {table} in {name}"
    return found[1]


def test_every_module_is_imported_or_run() -> None:
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in sources(*PACKAGES)}
    imported = set().union(*map(imports, sources(*PACKAGES, "benchmarks", "deploy")))
    unused = {
        module
        for module in modules - imported - RUN
        if not module.endswith((*PROGRAMS, ".__init__")) and not module.startswith(MIGRATIONS)
    }
    assert not unused, "register them where others of their kind are, or remove them"
    assert modules >= RUN


def test_every_folder_of_code_is_a_package() -> None:
    folders = {path.parent for path in sources(*PACKAGES)}
    missing = [
        folder for folder in folders if not (folder / "__init__.py").exists() and "migrations" not in folder.parts
    ]
    assert not missing, "the wheel leaves out a folder without `__init__.py`"


def test_every_attack_changes_something_and_is_tried_and_described() -> None:
    changing = {*ON_SIGNALS, *ON_ODOMETER, *ON_INERTIAL, *ON_NEIGHBOURS}
    assert set(AttackName) == changing, "an attack without an effect: services/sensors/simulator/attacks/effects.py"
    tried = {re.split(r"[(@]", case)[0] for case in CASES}
    assert set(AttackName) == tried, "an attack without a case of the laboratory: cli/attack_lab/cases.py"
    rows = re.findall(r"^\|([^|]+)\|", page("explanation/simulator.md"), re.MULTILINE)
    described = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert set(AttackName) - described == set(), "describe it in docs/explanation/simulator.md"


def pages() -> list[str]:
    return re.findall(r'"(\w+)"', javascript("main.js", "PAGES"))


@pytest.mark.parametrize("name", pages())
def test_every_page_of_the_dashboard_has_name_key_module_and_picture(name: str) -> None:
    assert f"{name}:" in javascript("words.js", "pages"), "a name in `pages` of words.js"
    assert f'"{name}"' in javascript("main.js", "GO"), "a key in `GO` of main.js"
    key = re.search(rf'(\w): "{name}"', javascript("main.js", "GO"))
    assert key and f'["g {key[1]}", ' in (DASHBOARD / "words.js").read_text(), "its key in the help: `rows` of words.js"
    assert f"{name}:" in javascript("main.js", "LATER") + javascript("main.js", "loaded"), "a module in `LATER`"
    title = re.search(rf'\b{name}: "([^"]+)"', javascript("words.js", "pages"))
    assert title and f"| *{title[1]}* |" in page("reference/pages.md"), "a row in docs/reference/pages.md"
    assert re.search(rf"^  {name}: html", (DASHBOARD / "parts.js").read_text(), re.MULTILINE), "an icon in parts.js"
    assert name in {taken for *_, names in DEMOS for taken in names}, "a picture: DEMOS of docs/picture.py"


def test_every_module_of_the_dashboard_is_there_and_imported() -> None:
    files = [path for path in DASHBOARD.rglob("*.js") if "node_modules" not in path.parts]
    imported = {
        ((DASHBOARD if path.suffix == ".html" else path.parent) / name).resolve()  # both pages are served at the root
        for path in (*files, DASHBOARD / "index.html", DASHBOARD / "access" / "login.html")
        for name in re.findall(r"""(?:from |import ?\(|src=)["'](\.{0,2}/?[\w./-]+\.js)["']""", path.read_text())
        if "node_modules" not in name
    }
    assert imported == {path.resolve() for path in files}


def commands(group: TyperGroup, path: str = "") -> Iterator[str]:
    for name, command in group.commands.items():
        if not command.hidden:
            yield f"{path} {name}".strip()


def test_every_command_is_in_a_page() -> None:
    root = typer.main.get_command(command_line([]))
    assert isinstance(root, TyperGroup)
    text = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md"))
    missing = [name for name in commands(root) if f"obu {name}" not in text]
    assert not missing, f"no page of docs names {missing}"


@pytest.mark.parametrize("kind", AidingKind)
def test_every_aid_is_made_by_an_aid_and_described(kind: AidingKind) -> None:
    made = "".join(path.read_text(encoding="utf-8") for path in sources("services/core/fusion/aids"))
    assert f"AidingKind.{kind.name}" in made
    assert f"`{kind}`" in page("explanation/navigation.md"), "describe it in docs/explanation/navigation.md"


@pytest.mark.parametrize("monitor", Monitor)
def test_every_monitor_is_stated_by_a_process_and_described(monitor: Monitor) -> None:
    if monitor is not Monitor.HYPOTHESES:  # stated by core.trust itself
        stated = "".join(path.read_text(encoding="utf-8") for path in sources("services/core") if path.stem != "facts")
        assert f'"{monitor}"' in stated, f"no process of services/core publishes a statement {monitor}"
    assert f"| `{monitor}` |" in page("explanation/trust.md"), "a row of the monitors of docs/explanation/trust.md"


def test_every_hypothesis_has_a_prior_and_a_solution() -> None:
    wrong = set(Hypothesis) - {Hypothesis.NOTHING}
    assert set(PRIOR) == wrong
    by_fusion = set(SOLVED) | {Hypothesis.SATELLITES}  # of satellites core.cooperative has the solutions
    assert by_fusion == wrong, "a solution without that source: services/core/fusion/hypotheses/bank.py"
    assert set(SOLVED_BY_THE_BANK) <= by_fusion


@pytest.mark.parametrize("row", [row for row in PROCESSES if row.kind is Kind.DEVICE_DRIVER], ids=lambda row: row.name)
def test_obu_doctor_opens_every_device(row: ProcessRow) -> None:
    config = import_module(f"services.{row.name}.process").Config
    known = row.name in {*DRIVERS, *NOT_OPENED}
    assert known or "device" not in config.model_fields, "add it to DRIVERS of cli/doctor/devices.py"


def test_browser_tests_open_every_page() -> None:
    for name in ("test_layout.py", "test_page_errors.py"):
        listed = re.search(r"^PAGES = \(.*?\)", (ROOT / "tests" / "browser" / name).read_text(), re.MULTILINE)
        missing = {page for page in pages() if listed and f'"{page}"' not in listed[0]} - {"toll"}  # of another unit
        assert listed and not missing, f"add {missing} to PAGES of tests/browser/{name}"


def test_every_reject_in_the_source_is_in_the_table() -> None:
    missing = {kind: path for kind, path in kinds_in_source().items() if reason_of(kind) is None}
    assert not missing, f"write meaning and remedy of {missing} into shared/rejects.py or their protocol"


def test_every_statement_is_that_of_a_monitor() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in sources("services/core"))
    assert set(re.findall(r'\bstatement\("(\w+)"', text)) <= set(Monitor), "a member of Monitor in core/trust/facts.py"


@pytest.mark.parametrize("hypothesis", [Hypothesi for Hypothesi in Hypothesis if Hypothesi is not Hypothesis.NOTHING])
def test_some_monitor_speaks_for_every_hypothesis_and_the_map_has_its_colours(hypothesis: Hypothesis) -> None:
    weighed = (ROOT / "services/core/trust/hypotheses/evidence.py").read_text(encoding="utf-8")
    assert f"Hypothesis.{hypothesis.name}" in weighed, "no statement speaks for it: core/trust/hypotheses/evidence.py"
    colours = javascript("map/style.js", "ALTERNATIVE_COLOURS")
    assert len(re.findall(rf"\b{hypothesis}:", colours)) == 3, "a colour in each theme of map/style.js"


def test_the_page_of_hypotheses_has_each_with_its_prior() -> None:
    rows = re.findall(r"^\| `(\w+)`: .*? \| (1e-\d) \|", page("explanation/trust.md"), re.MULTILINE)
    assert {Hypothesis(name): float(prior) for name, prior in rows} == PRIOR, "docs/explanation/trust.md"
