"""The kinds of rejects that stand in the source of the unit's processes."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
# Errors whose text is the kind, with what is put in front of it.
ERRORS = {"SampleError": "", "RejectedFrame": "", "NmeaError": "", "ContentError": "", "UbxError": "ubx_"}


def kinds_in_source() -> dict[str, str]:
    """Kinds of rejects that are literals in `services` and `shared`, each with a file in which it stands."""
    found: dict[str, str] = {}
    for path in sorted(path for folder in ("services", "shared") for path in (ROOT / folder).rglob("*.py")):
        if "node_modules" not in path.parts:
            for kind in _kinds_of(ast.parse(path.read_text(encoding="utf-8"))):
                found.setdefault(kind, str(path.relative_to(ROOT)))
    return found


def _kinds_of(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and _name(node.value).endswith("rejects"):
            yield from _texts(node.slice)
        elif isinstance(node, ast.Call) and (name := _name(node.func)) in ERRORS and node.args:
            yield from (ERRORS[name] + text for text in _texts(node.args[0]))
        elif isinstance(node, ast.Call) and _name(node.func) == "_reject":
            yield from (text for argument in node.args for text in _texts(argument))


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _texts(node: ast.expr) -> Iterator[str]:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.IfExp):
        yield from _texts(node.body)
        yield from _texts(node.orelse)
