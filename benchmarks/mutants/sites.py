"""Places at which a small fault can be put into a source file, and the source with it."""

import ast
import random
from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

Operator = type[ast.operator] | type[ast.cmpop]


class Kind(StrEnum):
    """Kind of fault."""

    ARITHMETIC = "arithmetic"
    COMPARISON = "comparison"  # the other way round
    BOUNDARY = "boundary"  # with or without equality
    SIGN = "sign"
    CONSTANT = "constant"
    DROPPED_CALL = "dropped call"


ARITHMETIC: dict[Operator, ast.operator] = {
    ast.Add: ast.Sub(), ast.Sub: ast.Add(), ast.Mult: ast.Div(), ast.Div: ast.Mult(), ast.Pow: ast.Mult(),
}  # fmt: skip
COMPARISON: dict[Operator, ast.cmpop] = {
    ast.Lt: ast.Gt(), ast.Gt: ast.Lt(), ast.LtE: ast.GtE(), ast.GtE: ast.LtE(), ast.Eq: ast.NotEq(),
    ast.NotEq: ast.Eq(), ast.Is: ast.IsNot(), ast.IsNot: ast.Is(), ast.In: ast.NotIn(), ast.NotIn: ast.In(),
}  # fmt: skip
BOUNDARY: dict[Operator, ast.cmpop] = {
    ast.Lt: ast.LtE(), ast.LtE: ast.Lt(), ast.Gt: ast.GtE(), ast.GtE: ast.Gt(),
}  # fmt: skip


class Site(NamedTuple):
    """One fault at one place."""

    path: Path
    kind: Kind
    line: int
    column: int
    end_line: int
    end_column: int
    replacement: str

    def applied(self, source: str) -> str:
        """Source with this fault."""
        lines = source.splitlines(keepends=True)
        begin = _offset(lines, self.line, self.column)
        end = _offset(lines, self.end_line, self.end_column)
        data = source.encode()
        return (data[:begin] + self.replacement.encode() + data[end:]).decode()


def _offset(lines: Sequence[str], line: int, column: int) -> int:
    """Offset [bytes] of a place; the columns of a syntax tree count bytes."""
    return sum(len(name.encode()) for name in lines[: line - 1]) + column


def sites_of(path: Path, source: str) -> list[Site]:
    """Give every place of a source at which a fault can be put, in order."""
    return [
        Site(path, kind, node.lineno, node.col_offset, node.end_lineno or 0, node.end_col_offset or 0, replacement)
        for node in ast.walk(_without_annotations(ast.parse(source)))
        if isinstance(node, ast.expr | ast.stmt)
        for kind, replacement in _faults(node)
    ]


def draw(sites: Sequence[Site], number: int, seed: int) -> list[Site]:
    """Draw places: as many of each kind as there are, so that constants do not crowd out the others."""
    generator = random.Random(seed)
    by_kind = {kind: [site for site in sites if site.kind is kind] for kind in Kind}
    for candidates in by_kind.values():
        generator.shuffle(candidates)
    drawn: list[Site] = []
    while len(drawn) < number and any(by_kind.values()):
        drawn += [candidates.pop() for candidates in by_kind.values() if candidates]
    return drawn[:number]


def _without_annotations(tree: ast.Module) -> ast.Module:
    """Leave out what is not executed as a calculation: annotations, default types and strings that document."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.returns = None
            for argument in (*node.args.args, *node.args.kwonlyargs, *node.args.posonlyargs):
                argument.annotation = None
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None, lineno=1, col_offset=0, end_lineno=1, end_col_offset=0)
    return tree


def _faults(node: ast.expr | ast.stmt) -> Iterator[tuple[Kind, str]]:
    match node:
        case ast.BinOp(left, operator, right) if type(operator) in ARITHMETIC and not _is_text(left, right):
            yield Kind.ARITHMETIC, _text(ast.BinOp(left, ARITHMETIC[type(operator)], right))
        case ast.Compare(left, [operator], rights):
            if type(operator) in COMPARISON:
                yield Kind.COMPARISON, _text(ast.Compare(left, [COMPARISON[type(operator)]], rights))
            if type(operator) in BOUNDARY:
                yield Kind.BOUNDARY, _text(ast.Compare(left, [BOUNDARY[type(operator)]], rights))
        case ast.UnaryOp(ast.USub(), operand) if not isinstance(operand, ast.Constant):
            yield Kind.SIGN, _text(operand)
        case ast.Constant(bool()):
            yield Kind.CONSTANT, str(not node.value)
        case ast.Constant(int() | float() as value):
            yield Kind.CONSTANT, repr(2 * value if abs(value) > 1 else value + 1)
        case ast.Expr(ast.Call()):
            yield Kind.DROPPED_CALL, "pass"


def _is_text(*nodes: ast.expr) -> bool:
    return any(isinstance(node, ast.JoinedStr) or isinstance(getattr(node, "value", None), str) for node in nodes)


def _text(node: ast.expr) -> str:
    return f"({ast.unparse(node)})"
