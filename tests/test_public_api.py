"""`import offpiste`: every public name is there, nothing heavy is loaded before it is used."""

import ast
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest

import offpiste
from feature_datasets import dataset_with_features
from offpiste.core.moved_names import MOVED

STUB = Path(offpiste.__file__).with_suffix(".pyi")


def public_names() -> list[str]:
    """Names in the stub, in its order."""
    imports = [node for node in ast.parse(STUB.read_text()).body if isinstance(node, ast.ImportFrom)]
    return [alias.asname or alias.name for node in imports for alias in node.names]


def test_every_public_name_can_be_imported_and_is_listed() -> None:
    names = public_names()
    assert len(names) == len(set(names)), "each is written once"
    assert all(getattr(offpiste, name) is not None for name in names)
    assert sorted(names) == sorted(dir(offpiste)) == sorted(offpiste.__all__)
    assert offpiste.__version__ == version("offpiste")


def test_the_public_names_are_few_verbs_and_nouns_and_no_modules() -> None:
    assert len(offpiste.__all__) <= 40
    assert not [name for name in offpiste.__all__ if isinstance(getattr(offpiste, name), ModuleType)]


@pytest.mark.parametrize("name", ["load_run", "TerrainMap"])
def test_a_name_that_moved_says_where(name: str) -> None:
    with pytest.raises(ImportError, match=rf"offpiste\.{name} is now offpiste\.\w+"):
        getattr(offpiste, name)


def test_names_that_moved_are_where_they_are_said_to_be() -> None:
    for old, new in MOVED.items():
        module, _, name = new.partition("(")[0].rpartition(".")
        assert getattr(import_module(module), name) is not None, old


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nothing"):
        _ = offpiste.nothing


def test_types_are_shipped() -> None:
    assert (STUB.parent / "py.typed").exists()


@pytest.mark.parametrize("module", ["offpiste", "offpiste.cli"])
def test_importing_loads_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(*{{'torch', 'numpy', 'scipy', 'matplotlib'}} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "\n"


def test_the_help_loads_nothing_heavy_and_names_every_command() -> None:
    code = (
        "import sys, atexit\n"
        "atexit.register(lambda: print(*{'torch', 'numpy', 'scipy'} & set(sys.modules), file=sys.stderr))\n"
        "from offpiste.cli import main; main(['--help'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "\n"
    commands = ["demo", "simulate", "inspect", "view", "fit-pca", "extract", "train", "evaluate", "reproduce", "drive"]
    places = [done.stdout.index(f"• {command} ") for command in commands]
    assert places == sorted(places), "in the order in which a log goes through them"


def test_a_run_a_dataset_and_its_windows_are_shown_in_three_lines(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "dataset.zarr")
    shown = [
        repr(each)
        for each in (dataset, offpiste.Windows(dataset, "test"), offpiste.load("pretrained:proving-ground/dc"))
    ]
    assert [each.count("\n") for each in shown] == [2, 2, 2]
    for words, each in zip(("4 drives, features", "windows of part 'test'", "Run of 'dc'"), shown, strict=True):
        assert all(word in each for word in words.split(", ")), each
