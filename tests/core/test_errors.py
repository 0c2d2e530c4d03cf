"""Error messages, and missing extras."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import torch

from offpiste.core.errors import MissingExtra, OffpisteError, extra, require
from offpiste.perception.backbones.vision_transformer import load_vision_transformer
from offpiste.training.loop import metrics_writer

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"


def run_without(module: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """A command in a Python that lacks a module."""
    code = f"import sys; sys.modules[{module!r}] = None; from offpiste.cli import main; main({list(arguments)!r})"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("module", "name", "arguments"),
    [
        ("mujoco", "sim", ("simulate", "--out", "{tmp}/drive.mcap")),
        ("embreex", "sim", ("drive", "{tmp}/run", "--out", "{tmp}/drive")),
        ("mujoco", "sim", ("reproduce", "fig3", "--out", "{tmp}/results")),
    ],
)
def test_a_command_names_the_extra_that_it_needs_before_it_does_anything(
    tmp_path: Path, module: str, name: str, arguments: tuple[str, ...]
) -> None:
    done = run_without(module, *(argument.format(tmp=tmp_path) for argument in arguments))
    assert done.returncode == 1
    assert done.stderr.startswith(f"offpiste: this needs the extra '{name}' ({module}")
    assert f"pip install '.[{name}]'" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_functions_name_the_extra_that_they_need(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "transformers", None)
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(MissingExtra, match=r"'.\[vit\]', or use the backbone filterbank"):
        load_vision_transformer("facebook/dinov2-small", device=torch.device("cpu"))
    with pytest.raises(MissingExtra, match=r"'.\[tensorboard\]"):
        metrics_writer(tmp_path, tensorboard=True)


def test_only_a_missing_package_is_explained_by_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ZeroDivisionError), extra("sim"):
        1 / 0  # noqa: B018
    require("sim", "json")
    monkeypatch.setitem(sys.modules, "json", None)
    with pytest.raises(MissingExtra, match="or leave it out"):
        require("sim", "json", otherwise="leave it out")


def test_every_extra_that_code_names_is_declared() -> None:
    code = "".join(path.read_text() for path in (PYPROJECT.parent / "src").rglob("*.py"))
    named = set(re.findall(r"""\b(?:extra|require)\("([a-z]+)\"""", code))
    assert {"sim", "view", "vit", "tensorboard"} <= named
    assert named <= set(tomllib.loads(PYPROJECT.read_text())["project"]["optional-dependencies"])


def test_a_message_is_one_printable_line_of_bounded_length_that_begins_with_where_and_ends_with_how() -> None:
    error = OffpisteError("no topic '" + "\x1b[31m\n" + "a" * 100_000 + "'", where="drive.bag", how="fix its rig")
    line = str(error)
    assert line.isprintable()
    assert len(line) < 620
    assert line.startswith("drive.bag: no topic '")
    assert line.endswith("; fix its rig")
    assert str(OffpisteError("short", where="x", how="y")) == "x: short; y"
