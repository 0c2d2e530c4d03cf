"""Dynamics models of off-road vehicles that see the terrain ahead, and a planner that uses them."""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8"))
_PUBLIC = {
    alias.asname or alias.name: (f"{__name__}.{node.module}", alias.name)
    for node in _STUB.body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
"""Module and attribute of each public name. They are imported on first use: `import offpiste` stays quick."""

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        module, attribute = _PUBLIC[name]
        globals()[name] = value = getattr(import_module(module), attribute)
        return value
    from offpiste.core.moved_names import MOVED

    if name in MOVED:
        raise ImportError(f"offpiste.{name} is now {MOVED[name]}")
    raise AttributeError(f"module 'offpiste' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__
