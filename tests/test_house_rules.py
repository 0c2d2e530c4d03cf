"""Rules that linters do not check: nothing stands twice, functions fit on a screen, totals do not grow."""

import ast
import re
from collections import defaultdict
from pathlib import Path

from offpiste.native import sources

ROOT = Path(__file__).parents[1]
SOURCES = sorted(
    file for folder in ("src", "experiments") for file in (ROOT / folder).rglob("*.py") if file.name != "generated.py"
)
SHARED_LINES = 6
LONGEST_FUNCTION = 80
PRINTED = {file.name for file in sources.PRINTED}
LIMITS = {
    "src": 60_500,
    "tests": 37_750,
    "experiments": 4_650,
    "benchmarks": 1_450,
    "docs [bytes]": 220_000,
    "README [words]": 600,
    "CHANGELOG [bytes]": 8_000,
}


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


def total(folder: str, *patterns: str, size: bool = False) -> int:
    """Lines of the files of a folder, or their size [bytes]."""
    files = [file for pattern in patterns for file in (ROOT / folder).rglob(pattern) if file.name not in PRINTED]
    return sum(file.stat().st_size if size else file.read_bytes().count(b"\n") for file in files)


def test_totals_do_not_grow():
    """Each total stays within its limit, which only ever shrinks."""
    code = ("*.py", "*.h", "*.c", "*.cu", "*.cuh", "*.cpp")
    found = {
        "src": total("src", *code),
        "tests": total("tests", *code),
        "experiments": total("experiments", *code),
        "benchmarks": total("benchmarks", *code),
        "docs [bytes]": total("docs", "*.md", size=True),
        "README [words]": len((ROOT / "README.md").read_text("utf-8").split()),
        "CHANGELOG [bytes]": (ROOT / "CHANGELOG.md").stat().st_size,
    }
    over = {name: (count, LIMITS[name]) for name, count in found.items() if count > LIMITS[name]}
    assert not over, over


def test_lists_of_tests_name_what_exists():
    """Each entry of the lists in `conftest.py` is the beginning of a file, or of a test in such a file."""
    tests = ROOT / "tests"
    assigned = [node for node in ast.parse((tests / "conftest.py").read_text("utf-8")).body if type(node) is ast.Assign]
    lists = {ast.unparse(node.targets[0]): node.value for node in assigned}
    texts = {file.relative_to(tests).as_posix(): file.read_text("utf-8") for file in tests.rglob("test_*.py")}
    stale = []
    for name in ("WHOLE_PATHS", "SLOW", "SMOKE", "REAL_TIME"):
        for entry in ast.literal_eval(lists[name]):
            file, _, test = entry.partition("::")
            definition = f"\ndef {test.partition('[')[0]}"
            if not any(definition in text for path, text in texts.items() if path.startswith(file)):
                stale.append(f"{name}: {entry}")
    assert not stale, stale


def functions_in(node: ast.AST) -> list[ast.FunctionDef]:
    return [each for each in ast.walk(node) if isinstance(each, ast.FunctionDef) and each is not node]


FUNCTIONS = [
    (file.relative_to(ROOT), each) for file in SOURCES for each in functions_in(ast.parse(file.read_text("utf-8")))
]


def test_functions_fit_on_a_screen():
    lengths = [(f"{file}:{node.lineno}", (node.end_lineno or 0) - node.lineno + 1) for file, node in FUNCTIONS]
    assert not [place for place, lines in lengths if lines > LONGEST_FUNCTION]


def test_functions_made_while_running_have_no_shapes_in_their_annotations():
    """Each shape would be a new class every time, which only a full garbage collection takes away."""
    shape = re.compile(r"\b[A-Z]\w+\[(Tensor|np\.ndarray), ")
    found = []
    for file, inner in ((file, inner) for file, outer in FUNCTIONS for inner in functions_in(outer)):
        written = [each.annotation for each in (*inner.args.args, *inner.args.kwonlyargs)] + [inner.returns]
        if any(each is not None and shape.search(ast.unparse(each)) for each in written):
            found.append(f"{file}:{inner.lineno} {inner.name}")
    assert not found, found
