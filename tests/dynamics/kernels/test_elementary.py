"""Elementary functions of the compiled code against NumPy, alone and in lanes, and the generated files."""

import ast
import ctypes
from pathlib import Path

import numpy as np
import pytest

from host_kernels import compiled, needs_gcc
from offpiste.dynamics.header.step_text import shipped_text
from offpiste.dynamics.kernels import generate
from offpiste.native.compiler import source_text
from offpiste.native.library import instruction_set
from offpiste.native.sources import PACKAGE, PRINTED_FROM
from offpiste.planning.costs.text import shipped_terms_text

ANGLES = np.concatenate((np.linspace(-10, 10, 20001), np.linspace(-1e4, 1e4, 200001), np.linspace(-1e-3, 1e-3, 2001)))
WIDE = np.concatenate(
    (np.linspace(-12, 12, 200001), np.geomspace(1e-30, 1e30, 100001), -np.geomspace(1e-30, 1e30, 100001))
)
FUNCTIONS = {"sin": (np.sin, ANGLES), "cos": (np.cos, ANGLES), "tanh": (np.tanh, WIDE), "atan": (np.arctan, WIDE)}
LOOPS = "\n".join(
    f'extern "C" void {name}s(offpiste_real* x, int n) {{ for (int i = 0; i < n; i++) x[i] = offpiste_{name}(x[i]); }}'
    for name in FUNCTIONS
)


def library_of(width: int, flags: list[str]) -> ctypes.CDLL:
    """The functions of one number, or of vectors of so many."""
    headers = "".join(f"#include <{name}.h>\n" for name in ("stdlib", "string", *["immintrin"] * (width > 4)))
    lanes = f"{headers}#define OFFPISTE_WIDTH {width}\n{source_text('lanes.h')}"
    text = (lanes if width > 1 else "") + shipped_text("elementary.h") + LOOPS
    return compiled(text, *flags, *["-mavx2"] * (width > 4), "-Wno-psabi", "-Wno-ignored-attributes")


@needs_gcc
@pytest.mark.parametrize(
    ("width", "dtype", "room"),
    [(1, np.float32, 4e-7), (4, np.float32, 4e-7), (8, np.float32, 4e-7), (1, np.float64, 1e-15)],
)
def test_errors_are_small_and_nan_and_large_arguments_are_handled(width, dtype, room):
    if width > 4 and instruction_set() == "baseline":
        pytest.skip("this processor has no such vectors")
    library = library_of(width, ["-DOFFPISTE_DOUBLE"] if dtype is np.float64 else [])
    for name, (reference, x) in FUNCTIONS.items():
        given = np.append(x, [np.nan, 1e20, -1e20]).astype(dtype)
        found = np.zeros(-(-len(given) // width) * width + 16, dtype)
        first = -found.ctypes.data % 64 // found.itemsize  # vectors are aligned
        found = found[first : first + -(-len(given) // width) * width]
        found[: len(given)] = given
        wanted = reference(given[:-3].astype(np.float64))
        getattr(library, f"{name}s")(ctypes.c_void_p(found.ctypes.data), ctypes.c_int(len(found) // width))
        found = found[: len(given)]
        error, scale = np.abs(found[:-3] - wanted), np.abs(wanted)
        assert error.max() < room, name
        assert name in ("sin", "cos") or (error[scale > 0] / scale[scale > 0]).max() < room, name
        assert np.isnan(found[-3])
        assert (np.abs(found[-2:]) <= 1.6).all()


def imported_modules(file: Path) -> set[Path]:
    """A module of offpiste and all that it imports, directly or not."""
    nodes = [node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.ImportFrom)]
    names = {name for node in nodes for name in (node.module, *(f"{node.module}.{part.name}" for part in node.names))}
    files = (PACKAGE.parent.joinpath(*name.split(".")).with_suffix(".py") for name in names)
    return {file}.union(*(imported_modules(each) for each in files if each.is_file()))


def test_an_edit_of_any_module_that_the_physics_is_printed_from_makes_the_library_stale():
    without_numbers = {PACKAGE / f"{name}.py" for name in ("core/errors", "core/registry", "dynamics/vehicle")}
    assert imported_modules(Path(generate.__file__)) - without_numbers == set(PRINTED_FROM)


def test_generated_code_is_current():
    for path, text in generate.files().items():
        assert path.read_text() == text, "install offpiste again"
    assert source_text("costs.h") == shipped_terms_text(), "run `python -m offpiste.planning.costs.text`"
