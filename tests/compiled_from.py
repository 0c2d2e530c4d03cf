"""Source files of compiled code: compiled functions and everything that they read, without annotations.

Numba compiles the values of globals into machine code.
"""

import ast
from functools import cache
from pathlib import Path

from offpiste.native import compilation
from offpiste.native.compilation import Compiler

PACKAGE = Path(compilation.__file__).parents[1]
MACHINERY = {"offpiste.native.compilation", "offpiste.core.registry", "offpiste.core.errors"}
"""Modules whose values are in no compiled code, or, of the first, in every digest."""

METHODS = {"inlined", "loop", "entry"}


def file_of(module: str) -> Path | None:
    """The file of a module of offpiste; None for no module."""
    path = PACKAGE.parent.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.exists()), None)


class Module:
    """A file: what it defines and imports by name, and its compiled functions by compiler."""

    def __init__(self, file: Path) -> None:
        tree = ast.parse(file.read_text("utf-8"))
        self.defined: dict[str, list[ast.AST]] = {}
        self.imported: dict[str, tuple[str, str]] = {}
        self.roots: list[tuple[str, set[str]]] = []
        for node in tree.body:
            for name in names_set(node):
                self.defined.setdefault(name, []).append(node)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "offpiste":
                self.imported |= {one.asname or one.name: (node.module, one.name) for one in node.names}
        for node in tree.body:
            self.roots += [(compiler, read) for compiler, read in compiled_in(node)]


def names_set(node: ast.stmt) -> list[str]:
    """Names that a statement of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    return [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]


def names_read(node: ast.AST) -> set[str]:
    """Names whose values a node reads, `a.b` for attributes of names; not those in annotations."""
    if isinstance(node, ast.Name):
        return {node.id}
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return {f"{node.value.id}.{node.attr}"}
    result = set()
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns"):
            for child in value if isinstance(value, list) else [value]:
                result |= names_read(child) if isinstance(child, ast.AST) else set()
    return result


def compiled_in(node: ast.stmt) -> list[tuple[str, set[str]]]:
    """Compilers that a statement of a module uses, each with what is read of what it compiles."""
    found, local = [], {}
    for inner in ast.walk(node):
        if isinstance(inner, ast.FunctionDef):
            found += [(name, names_read(node)) for one in inner.decorator_list if (name := compiler_of(one))]
        elif isinstance(inner, ast.Assign):
            local |= {one.id: names_read(inner.value) for one in inner.targets if isinstance(one, ast.Name)}
        elif isinstance(inner, ast.Call) and (name := compiler_of(inner.func)):
            found.append((name, set().union(*map(names_read, inner.args))))
    return [(name, read.union(*(local.get(one, ()) for one in read))) for name, read in found]


def compiler_of(node: ast.expr) -> str:
    """Name of the compiler of `COMPILER.loop` and the like; "" of others."""
    if isinstance(node, ast.Attribute) and node.attr in METHODS and isinstance(node.value, ast.Name):
        return node.value.id if isinstance(getattr(compilation, node.value.id, None), Compiler) else ""
    return ""


module_in = cache(Module)


def follow(file: Path, name: str, seen: set[tuple[Path, str]]) -> None:
    """Add a name of a file, and all that its value is made from, to those that were seen."""
    name, _, attribute = name.partition(".")
    module = module_in(file)
    if name in module.imported:
        source, original = module.imported[name]
        if source in MACHINERY:
            return None
        if (submodule := file_of(f"{source}.{original}")) is not None:
            return follow(submodule, attribute, seen) if attribute else None
        return follow(file_of(source), original, seen)
    if (file, name) in seen or name not in module.defined:
        return None
    seen.add((file, name))
    for node in module.defined[name]:
        for read in names_read(node):
            follow(file, read, seen)
    return None


def compiled_from(compiler: str) -> set[Path]:
    """Files that the code of one of `compilation`'s compilers is made from."""
    seen: set[tuple[Path, str]] = set()
    for file in sorted(PACKAGE.rglob("*.py")):
        for name, read in module_in(file).roots:
            if name == compiler:
                seen.add((file, ""))
                for one in read:
                    follow(file, one, seen)
    return {file for file, _ in seen}
