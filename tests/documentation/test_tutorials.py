"""Code blocks of tutorials run in order and print what the page shows."""

from pathlib import Path

import pytest

from documentation.pages import ROOT, difference, run_page, steps_of

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
