"""Registries of extensible parts: log formats, backbones, fusion rules, cost terms, models, losses, worlds, figures.

Entries register themselves. Extensions are modules named in `OFFPISTE_EXTENSIONS` and entry points of the group
`offpiste`.
"""

import os
import pkgutil
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Final, Generic, TypeVar

from offpiste.core.errors import OffpisteError, did_you_mean

Entry = TypeVar("Entry")

EXTENSIONS: Final = "OFFPISTE_EXTENSIONS"
"""Environment variable of comma-separated modules to import."""


class Registry(Generic[Entry]):
    """Entries of a kind ("backbone") by name; the first look-up imports all modules of the package and of extensions.

    An unknown or taken name raises `error`.
    """

    def __init__(self, kind: str, *, package: str = "", error: type[OffpisteError] = OffpisteError) -> None:
        self.kind, self._package, self._error = kind, package, error
        self._entries: dict[str, Entry] = {}
        self._loaded = False

    def register(self, name: str) -> Callable[[Entry], Entry]:
        """Return a decorator that adds an entry."""

        def add(entry: Entry) -> Entry:
            if name in self._entries:
                raise self._error(f"there are two {self.kind}s called '{name}'", how="give one of them another name")
            self._entries[name] = entry
            return entry

        return add

    def __getitem__(self, name: str) -> Entry:
        """Return the entry of a name."""
        if name not in self:
            how = f"{did_you_mean(name, self._entries)}available: {', '.join(self._entries)}"
            raise self._error(f"no {self.kind} '{name}'", how=how)
        return self._entries[name]

    def __contains__(self, name: object) -> bool:
        self._load()
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        self._load()
        return iter(tuple(self._entries))

    def __len__(self) -> int:
        self._load()
        return len(self._entries)

    def items(self) -> list[tuple[str, Entry]]:
        """Return names and entries in the order of registration, extensions last."""
        return [(name, self._entries[name]) for name in self]

    def _load(self) -> None:
        if self._loaded:
            return
        self._loaded = True
        if self._package:
            for module in pkgutil.iter_modules(import_module(self._package).__path__):
                import_module(f"{self._package}.{module.name}")
        load_extensions()


@cache
def load_extensions() -> None:
    """Import all extensions; raises `OffpisteError` if one cannot be imported."""
    named = {name.strip(): EXTENSIONS for name in os.environ.get(EXTENSIONS, "").split(",") if name.strip()}
    named |= {point.value: f"entry point '{point.name}'" for point in entry_points(group="offpiste")}
    for module, where in named.items():
        try:
            import_module(module)
        except ImportError as error:
            how = "install it, or put its folder on PYTHONPATH"
            raise OffpisteError(f"cannot import '{module}': {error}", where=where, how=how) from error
