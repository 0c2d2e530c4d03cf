"""docs/extending.md links every example and names tests that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text("utf-8")


def test_every_example_is_linked():
    linked = set(re.findall(r"\]\(\.\./(examples/extending/[^)]+)\)", PAGE))
    files = (ROOT / "examples" / "extending").iterdir()
    assert linked == {str(file.relative_to(ROOT)) for file in files if file.is_file()}


def test_code_shown_is_that_of_an_example():
    examples = "\n".join(file.read_text("utf-8") for file in (ROOT / "examples" / "extending").glob("*.py"))
    known = {line.strip() for line in examples.splitlines()}
    shown = [
        line.strip() for code in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL) for line in code.splitlines()
    ]
    assert len(shown) > 10
    assert [line for line in shown if line not in known and line not in ("", "...")] == []


def test_tests_that_the_page_names_exist():
    named = re.findall(r"`(tests/extending/\S+\.py)`", PAGE)
    assert len(named) >= 10
    assert all((ROOT / path).is_file() for path in named)
