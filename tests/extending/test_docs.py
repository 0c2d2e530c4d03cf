"""docs/extending.md shows the examples as they are."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text("utf-8")
SHOWN = re.findall(r"```\w+\n# (examples/extending/\S+)\n(.*?)```\n", PAGE, flags=re.DOTALL)


def test_every_example_is_shown_as_it_is():
    assert {path for path, _ in SHOWN} == {
        str(file.relative_to(ROOT)) for file in (ROOT / "examples" / "extending").iterdir() if file.is_file()
    }
    for path, code in SHOWN:
        assert code == (ROOT / path).read_text("utf-8"), path


def test_tests_that_the_page_names_exist():
    named = re.findall(r"`(tests/extending/\S+\.py)`", PAGE)
    assert len(named) >= 10
    assert all((ROOT / path).is_file() for path in named)
