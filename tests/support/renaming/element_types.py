"""Types of the loop variables of the tree, as mypy infers them."""

from collections.abc import Iterator

from mypy import build
from mypy.main import process_options
from mypy.nodes import MypyFile, NameExpr, Node, TypeInfo, Var
from mypy.types import Instance, NoneType, TupleType, Type, UnionType, get_proper_type

NOT_FOLLOWED = frozenset(("node", "info", "type", "fullname", "alias_deps", "names", "imports"))  # lead to other files


def element_types(variables: frozenset[str]) -> dict[str, dict[tuple[int, int], str]]:
    """Types of all uses of these names.

    Returns
    -------
    dict
        File (relative path) to (line, column) to the bare name of the class; a union without None counts if it has
        one member, and a tuple is "tuple".
    """
    sources, options = process_options(["--config-file", "pyproject.toml", "--no-incremental"])
    options.export_types = True
    options.preserve_asts = True
    options.incremental = False
    result = build.build(sources, options)
    types: dict[str, dict[tuple[int, int], str]] = {}
    for tree in result.files.values():
        if not tree.path or tree.path.startswith("/") or "site-packages" in tree.path:
            continue
        for use in _uses(tree, variables):
            if use in result.types and (name := _name(result.types[use])) is not None:
                types.setdefault(tree.path, {})[use.line, use.column] = name
    return types


def _uses(tree: MypyFile, variables: frozenset[str]) -> Iterator[NameExpr]:
    todo: list[object] = [tree]
    visited: set[int] = set()
    while todo:
        node = todo.pop()
        if isinstance(node, list | tuple):
            todo.extend(node)
        if not isinstance(node, Node) or id(node) in visited or isinstance(node, TypeInfo | Var):
            continue
        if isinstance(node, MypyFile) and node is not tree:
            continue
        visited.add(id(node))
        if isinstance(node, NameExpr):
            if node.name in variables:
                yield node
            continue
        for base in type(node).__mro__:  # mypy's visitors are compiled, and cannot be derived from
            for attribute in getattr(base, "__mypyc_attrs__", ()):
                if attribute not in NOT_FOLLOWED:
                    todo.append(getattr(node, attribute, None))


def _name(kind: Type) -> str | None:
    kind = get_proper_type(kind)
    if isinstance(kind, UnionType):
        names = {_name(item) for item in kind.items if not isinstance(get_proper_type(item), NoneType)}
        return names.pop() if len(names) == 1 else None
    if isinstance(kind, TupleType):
        return kind.partial_fallback.type.name  # a named tuple has its own
    fallback = getattr(kind, "fallback", None)
    if isinstance(fallback, Instance):  # a literal
        kind = fallback
    return kind.type.name if isinstance(kind, Instance) else None
