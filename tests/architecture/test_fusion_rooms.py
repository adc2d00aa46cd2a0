"""The rooms of core.fusion: who may import whom, and where the kind of a measurement may be asked for."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FUSION = ROOT / "services" / "core" / "fusion"
PACKAGE = "services.core.fusion"
ROOMS = ("inertial", "aids", "start", "timeline", "hypotheses")  # each may import those before it
# What a room may import of fusion beside the rooms. Every entry is in use, or this test fails.
BESIDE = {
    "inertial": {"settings", "states", "smoothing.history"},  # noise, states, and what the smoother needs
    # its states; what is updated with each outcome
    "aids": {"settings", "states", "blocks", "integrity.error_monitor", "integrity.undetected_shift"},
    "start": {"settings", "states", "codes", "integrity.disagreement"},  # a saved state has what the level holds
    # of two solutions: what they contradict each other by, and what is left of it
    "timeline": {"settings", "codes", "smoothing.history", "solution",
                 *(f"integrity.{name}" for name in (
                     "after_loss", "closure", "disagreement", "known_place", "over_a_cut", "separation"))},
    "hypotheses": {"settings", "codes", "solution", *(f"integrity.{name}" for name in (
        "disagreement", "error_monitor", "protection_levels", "separation"))},
}  # fmt: skip
CONSUMERS = ("integrity", "smoothing", "set_up")  # stand beside the rooms


def names_of(path: Path) -> dict[str, str]:
    """Dotted name within fusion of what a file imports of it, by its name in the file."""
    package = list(path.relative_to(ROOT).with_suffix("").parts[:-1])
    found: dict[str, str] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.asname or alias.name: alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {alias.asname or alias.name: f"{module}.{alias.name}" for alias in node.names}
    return {name: full.removeprefix(f"{PACKAGE}.") for name, full in found.items() if full.startswith(f"{PACKAGE}.")}


def modules_of(path: Path) -> set[str]:
    """Modules of fusion that a file imports."""
    found = set()
    for name in names_of(path).values():
        is_module = FUSION.joinpath(*name.split(".")).with_suffix(".py").exists()
        found.add(name if is_module else name.rpartition(".")[0])
    return found


def files_of(room: str) -> list[Path]:
    return sorted((FUSION / room).rglob("*.py"))


def room_of(module: str) -> str:
    return module.partition(".")[0]


def called(node: ast.AST) -> str:
    """Name of the function that an expression calls."""
    return node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""


def kinds_asked_for(path: Path) -> Iterator[str]:
    """Names of classes of aids that a file compares the class of a value with."""
    of_aids = {name for name, full in names_of(path).items() if room_of(full) == "aids"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        asked: list[ast.expr] = []
        if isinstance(node, ast.Call) and called(node) in ("isinstance", "issubclass"):
            asked = node.args[1:]
        elif isinstance(node, ast.MatchClass):
            asked = [node.cls]
        elif isinstance(node, ast.Compare) and "type" in map(called, (node.left, *node.comparators)):
            asked = [node.left, *node.comparators]
        names = (part.id for expr in asked for part in ast.walk(expr) if isinstance(part, ast.Name))
        yield from (name for name in names if name in of_aids)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_those_below_it_alone(room: str) -> None:
    below, beside = set(ROOMS[: ROOMS.index(room) + 1]), set[str]()
    for path in files_of(room):
        place = path.relative_to(FUSION).as_posix()
        foreign = {module for module in modules_of(path) if room_of(module) not in below}
        upward = {module for module in foreign if room_of(module) in ROOMS}
        assert not upward, f"{place} imports {upward}: arrows go down"
        beside |= foreign - upward
    assert beside == BESIDE[room], f"{room} imports {beside} beside the rooms"


@pytest.mark.parametrize("consumer", CONSUMERS)
def test_consumers_of_outcomes_know_nothing_of_start_and_timeline(consumer: str) -> None:
    for path in files_of(consumer):
        inside = {module for module in modules_of(path) if room_of(module) in ("start", "timeline")}
        assert not inside, f"{path.relative_to(FUSION)} imports {inside}"


def test_every_folder_is_a_room_or_a_consumer() -> None:
    folders = {path.name for path in FUSION.iterdir() if path.is_dir() and any(path.glob("*.py"))}
    assert folders == {*ROOMS, *CONSUMERS}


def numbers_in(index: ast.expr) -> Iterator[int]:
    """Numbers in an index, but those that count from the end, or that are the first."""
    yield from (
        n.value for n in ast.walk(index) if isinstance(n, ast.Constant) and type(n.value) is int and n.value > 3
    )


def test_nothing_names_a_state_by_number() -> None:
    """Covariance, errors and parameters are indexed by names: of vectors with three elements more is no index."""
    of_states = {"P", "x", "H", "F", "Phi", "Q", "psd", "parameters", "covariance", "decay", "variance"}
    found = {}
    for path in FUSION.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Subscript):
                name = node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
                if name in of_states and (numbers := list(numbers_in(node.slice))):
                    found[path.relative_to(FUSION).as_posix(), node.lineno] = numbers
    assert not found


def test_every_aid_is_a_folder_with_its_settings_and_states() -> None:
    """What an aid estimates and what may be adjusted stands beside it; the whole is only a list of them."""
    for name in ("settings", "states"):
        whole = modules_of(FUSION / f"{name}.py")
        assert {module for module in whole if module.startswith("aids.")} == {
            ".".join(path.relative_to(FUSION).with_suffix("").parts) for path in (FUSION / "aids").glob(f"*/{name}.py")
        }


def test_no_file_outside_aids_asks_for_the_kind_of_a_measurement() -> None:
    """A new aid is one file and one row: what differs by kind is a method of the kind."""
    asking = {
        path.relative_to(FUSION).as_posix(): kinds
        for path in FUSION.rglob("*.py")
        if path.relative_to(FUSION).parts[0] != "aids" and (kinds := set(kinds_asked_for(path)))
    }
    assert not asking


@pytest.mark.parametrize(
    "line",
    [
        "isinstance(one, GnssPosition | int)", "isinstance(one, (int, GnssPosition))",
        "issubclass(one, fix.GnssPosition)",
        "type(one) is GnssPosition", "match one:\n    case GnssPosition(time_ns=1): pass", "one == 1",
    ],
)  # fmt: skip
def test_asking_for_a_kind_is_seen_in_every_form(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    path = tmp_path / "services" / "core" / "fusion" / "timeline" / "made.py"
    path.parent.mkdir(parents=True)
    path.write_text(f"from ..aids.gnss import fix\nfrom ..aids.gnss.fix import GnssPosition\n{line}\n")
    assert bool(set(kinds_asked_for(path))) is (line != "one == 1")
