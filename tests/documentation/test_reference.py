"""The reference has every public name, and what its pages show as output is what is printed."""

import re
from pathlib import Path

import pytest

from documentation.pages import ROOT, difference, run_page
from test_public_api import public_names

PAGES = sorted((ROOT / "docs" / "api").glob("*.md"))
DESCRIBED = [name for page in PAGES for name in re.findall(r"^::: (\S+)$", page.read_text("utf-8"), re.MULTILINE)]


def test_every_public_name_is_described_once():
    wanted = {f"offpiste.{name}" for name in public_names() if name != "__version__"}
    assert len(DESCRIBED) == len(set(DESCRIBED))
    assert wanted <= set(DESCRIBED)


def test_the_first_page_names_what_there_is():
    first = (ROOT / "docs" / "api" / "index.md").read_text("utf-8")
    stages = set(re.findall(r"`offpiste\.(\w+)`", first))
    assert {"rig", "logs", "dataset", "dynamics", "planning", "runtime"} <= stages
    assert all((ROOT / "src" / "offpiste" / name).is_dir() for name in stages)


def test_the_example_prints_what_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ran = [(step.shown, printed) for step, printed in run_page(PAGES[[p.stem for p in PAGES].index("index")], tmp_path)]
    assert [difference(shown, printed) for shown, printed in ran] == [""]
