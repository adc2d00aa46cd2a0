"""Who may import whom: a process knows `shared` and itself, and its mathematics knows no I/O."""

import ast
import importlib.metadata
import subprocess
import sys
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from shared.processes import PROCESSES, Role, running
from tests.support.cases import each

ROOT = Path(__file__).parents[2]
# What a file that is not process.py may import besides its own folder: no bus, no clock, no files, no logging.
PURE = {
    "abc", "array", "bisect", "cantools", "collections", "cmath", "copy", "dataclasses", "datetime", "difflib", "enum",
    "fractions", "functools", "hashlib", "heapq",
    "html", "ipaddress", "itertools", "json", "math", "operator", "random", "re", "statistics", "string", "struct",
    "types", "typing", "collections.abc", "numpy", "numpy.typing", "scipy.linalg", "scipy.special",
    "pydantic", "pyubx2", "pynmea2", "prometheus_client",
}  # fmt: skip
PURE_SHARED = {
    "shared.maths",
    "shared.inertial",
    "shared.messages",
    "shared.protocols",
    "shared.kinds",
    "shared.missing_sensors",
    "shared.processes",
    "shared.topics",
    "shared.errors",
    "shared.toll",
}
PURE_SHARED |= {"shared.faults"}  # what one item of the input may cost
PURE_SHARED |= {"shared.v2x.generation", "shared.v2x.its_time"}
PURE_SHARED |= {"shared.v2x.evidence"}  # decodes bytes that it is given
PURE_SHARED |= {"shared.runtime.config", "shared.runtime.old_keys"}  # `Section`, the base of settings; names of keys
PURE_SHARED |= {"shared.chosen"}  # which of several devices is used
PURE_SHARED |= {"shared.missing_sensors"}  # words of the verdict without a sensor
PURE_SHARED |= {"shared.load"}  # which work is paused while a computer is too slow
PURE_SHARED |= {"shared.words"}  # rows of data, read once
PURE_SHARED |= {"shared.trust"}  # the result of a test of a monitor
PURE_SHARED |= {"shared.copies"}  # shallow copies of objects
PURE_SHARED |= {"shared.packages"}  # which packages are installed does not change while a process runs
PURE_SHARED |= {"shared.maths.compiled"}  # it changes how fast mathematics runs, and not what comes of it


ABOVE = {"cli", "services", "broker", "fleet", "deploy", "tests", "benchmarks"}  # what is built on `shared`
# What the centre takes from processes: the page of a unit, which it shows for a watched vehicle, and the outbox of a
# unit, with which simulated vehicles send as real ones do.
OF_A_UNIT = {
    "fleet/web": {"services.monitoring.status.page"},
    "fleet/simulate": {"services.monitoring.uplink.outbox", "services.monitoring.uplink.sending"},
}
# They come with pydantic, fastapi, python-can and the like, and alembic.
INSTALLED_BY_OTHERS = {"pydantic-core", "starlette", "h11", "sqlalchemy"}
SERVING = ("fastapi", "starlette", "uvicorn", "h11", "prometheus_client")


def files_of(process: str) -> list[Path]:
    return sorted((ROOT / "services" / Path(*process.split("."))).rglob("*.py"))


def imports_of(path: Path) -> set[str]:
    """List the modules that a file imports, relative ones made absolute."""
    package = list(path.relative_to(ROOT).with_suffix("").parts[:-1])
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            if ROOT.joinpath(*module.split(".")).is_dir():
                found |= {f"{module}.{alias.name}" for alias in node.names}
            else:
                found.add(module)
    return found


@each("row", PROCESSES)
def test_a_process_imports_shared_and_its_own_folder_only(row) -> None:  # type: ignore[no-untyped-def]
    own = f"services.{row.name}"
    for path in files_of(row.name):
        foreign = {
            name for name in imports_of(path)
            if name.split(".")[0] in ABOVE
            and not (name == own or name.startswith(own + "."))
        }  # fmt: skip
        assert not foreign, f"{path.relative_to(ROOT)} imports {foreign}"


@each("row", PROCESSES)
def test_every_file_but_process_py_does_no_input_and_output(row) -> None:  # type: ignore[no-untyped-def]
    own = f"services.{row.name}"
    for path in files_of(row.name):
        if path.name in ("process.py", "__init__.py") or not row.is_function:
            continue
        strange = {
            name for name in imports_of(path)
            if name not in PURE and name.split(".")[0] not in PURE
            and not name.startswith(own) and not any(name.startswith(pure) for pure in PURE_SHARED)
        }  # fmt: skip
        assert not strange, f"{path.relative_to(ROOT)} imports {strange}: mathematics does no I/O"


def test_shared_does_not_import_what_is_built_on_it() -> None:
    for path in (ROOT / "shared").rglob("*.py"):
        upward = {name for name in imports_of(path) if name.split(".")[0] in ABOVE}
        assert not upward, f"{path.relative_to(ROOT)} imports {upward}"


def test_the_centre_takes_nothing_of_a_process_but_the_page_and_the_outbox_of_a_unit() -> None:
    taken: dict[str, set[str]] = {}
    for path in (ROOT / "fleet").rglob("*.py"):
        if found := {name for name in imports_of(path) if name.split(".")[0] in ABOVE - {"fleet", "broker"}}:
            taken.setdefault("/".join(path.relative_to(ROOT).parts[:2]), set()).update(found)
    assert taken == OF_A_UNIT


def test_no_process_but_the_page_loads_a_web_server() -> None:
    """`shared.page` costs who serves no page nothing."""
    others = [f"services.{row.name}.process" for row in PROCESSES if row.name != "monitoring.status"]
    program = (
        f"import importlib, sys, shared; [importlib.import_module(name) for name in {others!r}]; "
        f"print(*(name for name in sys.modules if name in {SERVING!r} or name.startswith('shared.page')))"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not done.stdout.strip()


def test_every_process_of_the_table_has_a_folder_and_every_folder_a_row() -> None:
    folders = {
        ".".join(path.parent.relative_to(ROOT / "services").parts)
        for path in (ROOT / "services").glob("*/*/process.py")
    }
    assert folders == {row.name for row in PROCESSES}


def test_what_runs_live_loads_of_scipy_only_its_special_functions_and_linear_algebra() -> None:
    assignment = ROOT / "services" / "monitoring" / "ledger" / "reconciliation.py"
    for path in (path for folder in ("broker", "services", "shared") for path in (ROOT / folder).rglob("*.py")):
        heavy = {n for n in imports_of(path) if n.split(".")[0] == "scipy"} - {"scipy.special", "scipy.linalg"}
        heavy -= {"scipy.optimize"} if path == assignment else set()
        assert not heavy, f"{path.relative_to(ROOT)} imports {heavy}: tens of MB in a process; see docs/decisions/0012"


def test_a_command_imports_what_takes_long_only_where_it_is_used() -> None:
    """SciPy's signal processing and rotations take half a second, as does Matplotlib."""
    late = ("scipy.signal", "scipy.spatial", "scipy.stats", "matplotlib")
    program = f"import sys, cli.solve.solve; print(*(name for name in {late!r} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not done.stdout.strip()


def test_a_unit_that_reports_to_no_centre_runs_and_loads_nothing_for_it() -> None:
    assert all("monitoring.uplink" not in {row.name for row in running(role)} for role in Role)
    others = [f"services.{row.name}.process" for row in PROCESSES if row.name != "monitoring.uplink"]
    program = (
        f"import importlib, sys; [importlib.import_module(name) for name in {others!r}]; "
        "print(*(name for name in sys.modules if name.split('.')[0] in ('cbor2', 'fleet') or 'uplink.' in name "
        "or name.startswith('shared.fleet')))"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not done.stdout.strip()


def test_what_a_unit_imports_is_installed_with_it() -> None:
    """A package of the tests alone would be missing in a vehicle, and in its commands."""
    packages = importlib.metadata.packages_distributions()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["fleet"]]
    installed: set[str] = {canonicalize_name(Requirement(text).name) for text in wanted} | INSTALLED_BY_OTHERS
    ours = {"cli", "services", "shared", "broker", "fleet", "deploy", "tests", "benchmarks"}
    missing = {
        (str(path.relative_to(ROOT)), module)
        for folder in ("cli", "services", "shared", "broker", "fleet")
        for path in (ROOT / folder).rglob("*.py")
        if "node_modules" not in path.parts
        for module in imports_of(path)
        if (top := module.split(".")[0]) not in ours | set(sys.stdlib_module_names)
        and not {canonicalize_name(name) for name in packages.get(top, [])} & installed
    }
    assert not missing
