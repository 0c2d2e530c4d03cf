"""Registries of entries by name."""

import sys

import pytest

from offpiste.core.errors import PerceptionError
from offpiste.core.registry import EXTENSIONS, Registry, load_extensions


def test_unknown_and_taken_names_are_errors():
    registry: Registry[int] = Registry("backbone", error=PerceptionError)
    registry.register("one")(1)
    with pytest.raises(PerceptionError, match=r"no backbone 'two'; available: one"):
        registry["two"]
    with pytest.raises(PerceptionError, match="two backbones called 'one'"):
        registry.register("one")(2)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with a registry and one module that registers itself, and an extension beside it."""
    folder = tmp_path / "shipped_things"
    folder.mkdir()
    head = "from offpiste.core.registry import Registry\n"
    (folder / "__init__.py").write_text(head + "THINGS = Registry('thing', package=__name__)\n")
    (folder / "hammer.py").write_text("from shipped_things import THINGS\nTHINGS.register('hammer')(1)\n")
    (tmp_path / "added_things.py").write_text("from shipped_things import THINGS\nTHINGS.register('saw')(2)\n")
    monkeypatch.syspath_prepend(tmp_path)
    load_extensions.cache_clear()
    yield
    load_extensions.cache_clear()
    for name in [name for name in sys.modules if name.split(".")[0] in ("shipped_things", "added_things")]:
        del sys.modules[name]


def test_modules_of_the_package_and_of_extensions_are_found(package, monkeypatch):
    monkeypatch.setenv(EXTENSIONS, "added_things")
    from shipped_things import THINGS

    assert THINGS.items() == [("hammer", 1), ("saw", 2)]
