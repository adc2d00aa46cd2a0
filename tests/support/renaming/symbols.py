"""Renames classes and constants by the file that defines them, in every file that imports them from there."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import libcst as cst
from libcst.metadata import MetadataWrapper, QualifiedNameProvider, QualifiedNameSource

Renames = Mapping[str, Mapping[str, str]]  # file that defines a name -> old name -> new name


def module_of(path: str) -> str:
    """Dotted name of a file of the tree."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def absolute(name: str, path: str) -> str:
    """Name of a relative import (leading dots), as seen from a file."""
    bare = name.lstrip(".")
    if bare == name:
        return name
    folders = path.split("/")[:-1]
    folders = folders[: len(folders) - (len(name) - len(bare) - 1)]
    return ".".join([*folders, bare] if bare else folders)


class SymbolRenames:
    """What is renamed, by qualified name."""

    def __init__(self, renames: Renames) -> None:
        self._new = {f"{module_of(file)}.{old}": new for file, names in renames.items() for old, new in names.items()}
        olds = sorted({old for names in renames.values() for old in names})
        self._word = re.compile(rf"\b({'|'.join(map(re.escape, olds))})\b") if olds else None

    def passed_on(self, files: Iterable[Path]) -> None:
        """Add the modules that import a name, from which others may import it in turn."""
        imports = re.compile(r"^from ([\w.]+) import (\([^)]*\)|.*)$", re.MULTILINE)
        found = [
            (module_of(str(file)), absolute(module, str(file)), name.strip())
            for file in files
            for module, names in imports.findall(file.read_text())
            for name in names.strip("()").split(",")
            if " as " not in name and self._word is not None and self._word.fullmatch(name.strip())
        ]
        before = 0
        while before != len(self._new):
            before = len(self._new)
            for importer, module, name in found:
                if (to := self._new.get(f"{module}.{name}")) is not None:
                    self._new[f"{importer}.{name}"] = to

    def of(self, qualified: str) -> str | None:
        """New bare name, or None."""
        return self._new.get(qualified)

    def apply(self, path: Path) -> bool:
        """Rewrite a file; tells whether anything changed.

        Raises
        ------
        ValueError
            A new name is taken in the file already.
        """
        source = path.read_text()
        if self._word is None or not self._word.search(source):
            return False
        wrapper = MetadataWrapper(cst.parse_module(source))
        change = _Change(self, str(path))
        renamed = wrapper.visit(change).code
        if renamed == source:
            return False
        for old, new in change.done.items():
            if re.search(rf"(?<![\w.]){new}\b(?!=)", re.sub(r'"""[\s\S]*?"""|#.*|"[^"\n]*"', "", source)):
                raise ValueError(f"{path}: {old} becomes {new}, which is another name there")
        path.write_text(renamed)
        return True


class _Change(cst.CSTTransformer):
    METADATA_DEPENDENCIES = (QualifiedNameProvider,)

    def __init__(self, renames: SymbolRenames, path: str) -> None:
        super().__init__()
        self._renames, self._path, self._module = renames, path, module_of(path)
        self.done: dict[str, str] = {}

    def leave_Name(self, original_node: cst.Name, updated_node: cst.Name) -> cst.Name:
        for name in self.get_metadata(QualifiedNameProvider, original_node, set()):
            local = name.source is QualifiedNameSource.LOCAL
            if name.name.endswith(f".{original_node.value}") or name.name == original_node.value:
                to = self._renames.of(f"{self._module}.{name.name}" if local else absolute(name.name, self._path))
                if to is not None:
                    self.done[original_node.value] = to
                    return updated_node.with_changes(value=to)
        return updated_node

    def leave_SimpleString(self, original_node: cst.SimpleString, updated_node: cst.SimpleString) -> cst.SimpleString:
        """Annotations in quotes: names and subscripts of classes of this file."""
        text = original_node.raw_value
        if re.fullmatch(r"[\w.\[\], |]+", text):
            text = re.sub(r"\w+", lambda match: self._renames.of(f"{self._module}.{match[0]}") or match[0], text)
        unchanged = text == original_node.raw_value or original_node.prefix
        return updated_node if unchanged else updated_node.with_changes(value=f'"{text}"')

    def leave_Attribute(self, original_node: cst.Attribute, updated_node: cst.Attribute) -> cst.Attribute:
        for name in self.get_metadata(QualifiedNameProvider, original_node, set()):
            if (to := self._renames.of(absolute(name.name, self._path))) is not None and name.name.endswith(
                f".{original_node.attr.value}"
            ):
                return updated_node.with_changes(attr=cst.Name(to))
        return updated_node.with_changes(attr=original_node.attr)

    def leave_Arg(self, original_node: cst.Arg, updated_node: cst.Arg) -> cst.Arg:
        return updated_node.with_changes(keyword=original_node.keyword)

    def leave_ImportFrom(self, original_node: cst.ImportFrom, updated_node: cst.ImportFrom) -> cst.ImportFrom:
        if isinstance(updated_node.names, cst.ImportStar) or isinstance(original_node.names, cst.ImportStar):
            return updated_node
        dotted = cst.Module([]).code_for_node(original_node.module) if original_node.module else ""
        module = absolute("." * len(original_node.relative) + dotted, self._path)
        aliases = []
        for original, alias in zip(original_node.names, updated_node.names, strict=True):
            old = original.name.value
            to = self._renames.of(f"{module}.{old}") if isinstance(old, str) else None
            if to is not None and alias.asname is None:
                self.done[old] = to
            aliases.append(alias.with_changes(name=cst.Name(to) if to else original.name))
        return updated_node.with_changes(names=aliases)

    def leave_Call(self, original_node: cst.Call, updated_node: cst.Call) -> cst.Call:
        """`monkeypatch.setattr(module, "NAME", ...)` and `setattr("module.NAME", ...)`."""
        if not (isinstance(original_node.func, cst.Attribute) and original_node.func.attr.value == "setattr"):
            return updated_node
        arguments = list(updated_node.args)
        if len(arguments) < 2:
            return updated_node
        whole, part = arguments[0].value, arguments[1].value
        if isinstance(whole, cst.SimpleString) and (to := self._renames.of(whole.raw_value)) is not None:
            renamed = f'"{whole.raw_value.rsplit(".", 1)[0]}.{to}"'
            arguments[0] = arguments[0].with_changes(value=cst.SimpleString(renamed))
        elif isinstance(part, cst.SimpleString):
            for name in self.get_metadata(QualifiedNameProvider, original_node.args[0].value, set()):
                if (to := self._renames.of(f"{absolute(name.name, self._path)}.{part.raw_value}")) is not None:
                    arguments[1] = arguments[1].with_changes(value=cst.SimpleString(f'"{to}"'))
        return updated_node.with_changes(args=arguments)


def in_prose(text: str, unique: Mapping[str, str]) -> str:
    """Names in backticks, of those that only one file defines."""
    return re.sub(r"`(\w+)`", lambda match: f"`{unique.get(match[1], match[1])}`", text)
