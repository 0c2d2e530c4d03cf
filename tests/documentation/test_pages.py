"""The reference has every public name, and pages run in order and print what they show."""

import re
from pathlib import Path

import pytest

from documentation.pages import ROOT, difference, run_page, steps_of
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


TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_runs_as_it_stands(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    ran = run_page(page, tmp_path)
    assert len(ran) >= 4
    assert sum(step.shown is not None for step, _ in ran) >= 3
    wrong = [
        f"{page.name}:{step.line}: not printed: {missing}\n{printed}"
        for step, printed in ran
        if step.shown is not None and (missing := difference(step.shown, printed))
    ]
    assert not wrong, "\n".join(wrong)


def test_the_comparison_can_fail() -> None:
    for shown, printed, missing in (
        ("a 1.0 m\n", "a 1.1 m\n", ""),
        ("a 1.0 m\n", "a 1.5 m\n", "a 1.0 m"),
        ("6 topics of 600\n", "6 topics of 601\n", ""),
        ("6 topics of 600\n", "7 topics of 600\n", "6 topics of 600"),
        ("a\n…\nc\n", "a\nb\nb\nc\n", ""),
        ("a\n…\nd\n", "a\nb\nc\n", "d"),
        ("a\n", "a\nb\n", "b"),
        ("a\n…\n", "a\nb\n", ""),
    ):
        assert difference(shown, printed) == missing


def test_a_step_has_the_output_that_follows_it():
    text = "# T\n\n```sh\nls\n```\n\ntext\n\n```python\nprint(1)\n```\n\n```text\n1\n```\n"
    assert [(step.language, step.shown) for step in steps_of(text)] == [("sh", None), ("python", "1\n")]
