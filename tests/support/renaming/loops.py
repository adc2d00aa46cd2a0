"""Names loop variables after what they run over.

`for one in runs` becomes `for run in runs`; where the iterable is no plural noun, the variable is named after the class
of the element. A variable that would hide another name keeps its name, and is listed.
"""

import builtins
import keyword
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import libcst as cst
from libcst.metadata import MetadataWrapper, PositionProvider

VARIABLES = frozenset(("one", "found"))
NOT_NAMES = VARIABLES | frozenset(dir(builtins))

# Iterables whose singular is no name of an element.
NO_NOUNS = frozenset(
    [
        "others",
        "sums",
        "his",
        "is",
        "us",
        "this",
        "was",
        "has",
        "class",
        "axis",
        "status",
        "bus",
        "previous",
        "values",
        "items",
        "keys",
        "always",
        "perhaps",
        "makes",
        "needs",
        "needed",
        "does",
        "cons",
        "looks",
        "says",
        "tells",
        "gives",
        "takes",
        "ones",
        "theirs",
        "its",
        "ours",
        "alias",
        "pass",
        "less",
        "progress",
        "address",
        "loss",
        "process",
        "gps",
        "GPS",
    ]
)
TRANSPARENT = frozenset(("reversed", "sorted", "list", "tuple", "set", "islice", "iter", "cast", "values", "copy"))
BUILT_IN = {"str": "name", "int": "number", "float": "value", "bytes": "payload", "tuple": "pair", "bool": "flag"} | {
    "dict": "record",
    "list": "row",
    "ndarray": "vector",
    "object": "value",
    "PosixPath": "path",
    "PurePosixPath": "path",
}


def singular(noun: str) -> str | None:
    """Singular of a plural noun in snake case, or None where it is none."""
    word = noun.strip("_")
    last = word.rsplit("_", 1)[-1]
    if not last.endswith("s") or last.endswith("ss") or last.endswith("us") or last in NO_NOUNS or word.isupper():
        return None
    if last == "axes":
        return word[:-2] + "is"
    if last == "series":
        return None
    if last.endswith("ies"):
        return word[:-3] + "y"
    if re.search(r"(sses|xes|ches|shes|zes)$", last):
        return word[:-2]
    return word[:-1]


def snake(name: str) -> str:
    """`NeighbourReport` as `neighbour_report`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name.strip("_")).lower()


def noun(iterable: cst.BaseExpression) -> str | None:
    """Last word of what is run over: `self._runs[1:]` is `_runs`."""
    match iterable:
        case cst.Name(value=str(name)) | cst.Attribute(attr=cst.Name(value=str(name))):
            return name
        case cst.Subscript(value=base):
            return noun(base)
        case cst.Call(func=function, args=arguments):
            return _of_call(function, arguments)
    return None


def _of_call(function: cst.BaseExpression, arguments: Sequence[cst.Arg]) -> str | None:
    name = noun(function)
    if name not in TRANSPARENT:
        return name
    if isinstance(function, cst.Attribute):
        return noun(function.value)
    return noun(arguments[-1 if name == "cast" else 0].value) if arguments else None


class Binder:
    """A loop, a comprehension or a lambda that binds one of `VARIABLES`."""

    def __init__(
        self,
        node: cst.CSTNode,
        target: cst.CSTNode,
        iterable: cst.BaseExpression | None,
        body: list[cst.CSTNode],
        enclosing: tuple["Binder", ...],
    ) -> None:
        self.node, self.target, self.iterable, self.body = node, target, iterable, body
        self.enclosing = enclosing
        self.is_loop = isinstance(node, cst.For)  # whose variable outlives it

    def names(self) -> Iterator[cst.Name]:
        """All uses in its scope, with the binding itself."""
        for part in (self.target, *self.body):
            yield from names(part)

    def iterable_of(self, variable: str) -> cst.BaseExpression | None:
        """What gives this variable its values: of `zip` and `enumerate` the argument at its place."""
        if isinstance(self.target, cst.Name):
            return self.iterable
        if not isinstance(self.iterable, cst.Call) or not isinstance(self.target, cst.Tuple):
            return None
        bound = [element.value.value if isinstance(element.value, cst.Name) else "" for element in self.target.elements]
        function, arguments = self.iterable.func, [argument.value for argument in self.iterable.args]
        match noun(function), bound.index(variable) if variable in bound else -1:
            case "zip", place if 0 <= place < len(arguments):
                return arguments[place]
            case "enumerate", 1:
                return arguments[0]
            case "items", 1 if isinstance(function, cst.Attribute):
                return function.value
        return None


def names(root: cst.CSTNode) -> Iterator[cst.Name]:
    """Names that are variables below a node: no attributes, keywords of calls, or parts of imports."""
    todo: list[cst.CSTNode] = [root]
    while todo:
        node = todo.pop()
        if isinstance(node, cst.Name):
            yield node
        elif isinstance(node, cst.Attribute | cst.Arg):
            todo.append(node.value)
        elif not isinstance(node, cst.Import | cst.ImportFrom):
            todo.extend(node.children)


def imports(tree: cst.CSTNode) -> set[str]:
    """Names that a file imports."""
    bound: set[str] = set()
    for node in tree.children:
        if isinstance(node, cst.ImportAlias):
            name = node.asname.name if node.asname else node.name
            bound |= {name.value} if isinstance(name, cst.Name) else set()
        bound |= imports(node)
    return bound


def binders(root: cst.CSTNode, enclosing: tuple[Binder, ...] = ()) -> Iterator[Binder]:
    """Outer ones first."""
    for node in root.children:
        of_node: list[Binder] = []
        if isinstance(node, cst.For):
            parts = [node.body, *([node.orelse] if node.orelse else [])]
            of_node = [Binder(node, node.target, node.iter, list(parts), enclosing)]
        elif isinstance(node, cst.ListComp | cst.SetComp | cst.GeneratorExp | cst.DictComp):
            elements = [node.key, node.value] if isinstance(node, cst.DictComp) else [node.elt]
            of_node = list(_of_comprehension(node, node.for_in, list(elements), enclosing))
        elif isinstance(node, cst.Lambda) and node.params.params:
            of_node = [Binder(node, node.params, None, [node.body], enclosing)]
        yield from of_node
        yield from binders(node, (*enclosing, *of_node))


def _of_comprehension(
    node: cst.CSTNode, clause: cst.CompFor, elements: list[cst.CSTNode], enclosing: tuple[Binder, ...]
) -> Iterator[Binder]:
    inner = clause.inner_for_in
    binder = Binder(node, clause.target, clause.iter, [*elements, *clause.ifs, *([inner] if inner else [])], enclosing)
    yield binder
    if inner is not None:
        yield from _of_comprehension(node, inner, elements, (*enclosing, binder))


def functions(root: cst.CSTNode) -> Iterator[cst.CSTNode]:
    """The module's functions and the module, inner ones last."""
    yield root
    for node in root.children:
        yield from (scope for scope in functions(node) if isinstance(scope, cst.FunctionDef))


class LoopNames:
    """New names of the loop variables of one file."""

    def __init__(self, source: str, types: Mapping[tuple[int, int], str]) -> None:
        self._wrapper = MetadataWrapper(cst.parse_module(source), unsafe_skip_copy=True)
        self._places = self._wrapper.resolve(PositionProvider)
        self._types = types
        self.kept: list[tuple[int, str]] = []  # line and name of the variables that keep their names

    def renamed(self) -> str:
        """The source with the new names."""
        tree = self._wrapper.module
        every = list(binders(tree))
        wanted, loose = self._uses(every)
        scope_of = {id(name): scope for scope in functions(tree) for name in names(scope)}  # inner scopes win
        imported = imports(tree)
        new: dict[int, str] = {}
        given: dict[int, set[str]] = {}  # new names by binder
        for binder in every:
            for variable, uses in sorted(wanted.get(id(binder), {}).items()):
                scope = scope_of[id(uses[0])]
                in_scope = {name.value for name in loose if scope_of[id(name)] in (scope, tree)}
                taken = {name.value for name in names(binder.node)} | (in_scope | imported if binder.is_loop else set())
                for outer in binder.enclosing:
                    taken |= given.get(id(outer), set()) | {name.value for name in names(outer.target)}
                used_later = binder.is_loop and any(
                    name.value == variable and scope_of[id(name)] is scope for name in loose
                )
                to = None if used_later else self._name(binder, variable, taken)
                if to is None:
                    self.kept.append((self._places[binder.node].start.line, variable))
                    continue
                given.setdefault(id(binder), set()).add(to)
                new.update({id(name): to for name in uses})
        return tree.visit(_Replace(new)).code

    def _uses(self, every: Sequence[Binder]) -> tuple[dict[int, dict[str, list[cst.Name]]], list[cst.Name]]:
        """Uses of `VARIABLES` by the innermost binder and name, and all names that no loop binds."""
        innermost: dict[int, tuple[cst.Name, Binder]] = {}
        covered: set[int] = set()
        for binder in every:
            bound = {name.value for name in names(binder.target)}
            for name in binder.names():
                if name.value in bound:
                    covered.add(id(name))
                    if name.value in VARIABLES:
                        innermost[id(name)] = name, binder
        wanted: dict[int, dict[str, list[cst.Name]]] = {}
        for name, binder in innermost.values():
            wanted.setdefault(id(binder), {}).setdefault(name.value, []).append(name)
        return wanted, [name for name in names(self._wrapper.module) if id(name) not in covered]

    def _name(self, binder: Binder, variable: str, used: set[str]) -> str | None:
        iterable = binder.iterable_of(variable)
        plural = noun(iterable) if iterable is not None else None
        options = [singular(plural) if plural else None]
        kind = self._type(binder, variable)
        if kind is not None:
            full = BUILT_IN.get(kind) or snake(kind)
            options += [full, full.rsplit("_", 1)[-1]] if "_" in full else [full]
        options.append("item")
        for option in options:
            if (
                option
                and option not in used
                and not keyword.iskeyword(option)
                and option not in NOT_NAMES
                and len(option) > 1
            ):
                return option
        return None

    def _type(self, binder: Binder, variable: str) -> str | None:
        for name in binder.names():
            place = self._places.get(name)
            if name.value == variable and place is not None and (place.start.line, place.start.column) in self._types:
                return self._types[place.start.line, place.start.column]
        return None


class _Replace(cst.CSTTransformer):
    def __init__(self, new: Mapping[int, str]) -> None:
        self._new = new

    def leave_Name(self, original_node: cst.Name, updated_node: cst.Name) -> cst.Name:
        to = self._new.get(id(original_node))
        return updated_node if to is None else updated_node.with_changes(value=to)


def rename_loops(path: Path, types: Mapping[tuple[int, int], str]) -> list[tuple[int, str]]:
    """Rewrite a file; returns lines and names of the variables that keep their names."""
    source = path.read_text()
    if not any(re.search(rf"\b{name}\b", source) for name in VARIABLES):
        return []
    loops = LoopNames(source, types)
    if (renamed := loops.renamed()) != source:
        path.write_text(renamed)
    return loops.kept
