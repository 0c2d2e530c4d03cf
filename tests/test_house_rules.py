"""Rules that linters do not check: nothing stands twice, files and functions can be read, words are the field's."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted(
    file for folder in ("src", "experiments") for file in (ROOT / folder).rglob("*.py") if file.name != "generated.py"
)
SHARED_LINES = 6
LONGEST_FUNCTION = 80
MODULES = 457

BANNED = re.compile(
    r"\b(mend(s|ed|ing)?|judg(e|es|ed|ing|ement)|dear(er|est)?|told|tells? a person|soundness|"
    r"slabs?(?! test)|prices?|patience|one foot|goes on|go on|will not come free|DESIGN\.md)\b",
    re.IGNORECASE,
)


def code_lines(file: Path) -> list[tuple[int, str]]:
    """Number and text of each line that says something: no blank lines, comments, imports or lone brackets."""
    tree = ast.parse(file.read_text("utf-8"))
    imports = {
        number
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = enumerate(file.read_text("utf-8").splitlines(), start=1)
    return [
        (number, line.strip())
        for number, line in lines
        if number not in imports and re.search(r"\w", line) and not line.lstrip().startswith("#")
    ]


def test_no_two_places_share_six_equal_lines():
    places = defaultdict(list)
    for file in SOURCES:
        lines = code_lines(file)
        for start in range(len(lines) - SHARED_LINES + 1):
            part = lines[start : start + SHARED_LINES]
            places["\n".join(text for _, text in part)].append(f"{file.relative_to(ROOT)}:{part[0][0]}")
    twice = [where for where in places.values() if len(where) > 1]
    assert not twice, twice


def test_modules_are_few():
    modules = [file for file in SOURCES if "src" in file.relative_to(ROOT).parts and file.name != "__init__.py"]
    assert len(modules) <= MODULES


def test_functions_fit_on_a_screen():
    long = [
        (str(file.relative_to(ROOT)), node.name, node.end_lineno - node.lineno + 1)
        for file in SOURCES
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.lineno + 1 > LONGEST_FUNCTION
    ]
    assert not long, long


@pytest.mark.parametrize("file", [*SOURCES, *sorted(ROOT.glob("docs/**/*.md")), ROOT / "README.md"], ids=str)
def test_the_words_are_those_of_the_field(file):
    text = file.read_text("utf-8")
    if file.suffix == ".py":
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        text = "\n".join(token.string.replace("_", " ") for token in tokens)
    found = sorted({match.group(0).lower() for match in BANNED.finditer(text)})
    assert not found, found


def test_functions_made_while_running_have_no_shapes_in_their_annotations():
    """Each shape would be a new class every time, which only a full garbage collection takes away."""
    shape = re.compile(r"\b[A-Z]\w+\[(Tensor|np\.ndarray), ")
    found = []
    for file in SOURCES:
        for outer in (
            node for node in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(node, ast.FunctionDef)
        ):
            for inner in (node for node in ast.walk(outer) if isinstance(node, ast.FunctionDef) and node is not outer):
                written = [each.annotation for each in (*inner.args.args, *inner.args.kwonlyargs)] + [inner.returns]
                if any(each is not None and shape.search(ast.unparse(each)) for each in written):
                    found.append(f"{file.relative_to(ROOT)}:{inner.lineno} {inner.name}")
    assert not found, found
