"""Elementary functions of the Numba kernels and of the C header against NumPy, and the generated code."""

import ctypes

import numba
import numpy as np
import pytest

from host_kernels import compiled, needs_gcc
from offpiste.dynamics.header.step_text import shipped_text
from offpiste.dynamics.kernels import elementary, generate
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.vectors import WIDTH, load, read_fours, store

ANGLES = np.concatenate((np.linspace(-10, 10, 20001), np.linspace(-1e4, 1e4, 200001), np.linspace(-1e-3, 1e-3, 2001)))
WIDE = np.concatenate(
    (np.linspace(-12, 12, 200001), np.geomspace(1e-30, 1e30, 100001), -np.geomspace(1e-30, 1e30, 100001))
)
FUNCTIONS = {"sin": (np.sin, ANGLES), "cos": (np.cos, ANGLES), "tanh": (np.tanh, WIDE), "atan": (np.arctan, WIDE)}
LOOPS = "\n".join(
    f'extern "C" void {name}s(offpiste_real* x, int n) {{ for (int i = 0; i < n; i++) x[i] = offpiste_{name}(x[i]); }}'
    for name in FUNCTIONS
)


def on_array(function, x):
    @numba.njit(fastmath={"contract"}, error_model="numpy")
    def loop(x):
        y = np.empty_like(x)
        for i in range(len(x)):
            y[i] = function(x[i])
        return y

    return loop(x)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_errors_are_small_and_nan_and_large_arguments_are_handled(name):
    reference, x = FUNCTIONS[name]
    x = np.append(x, [np.nan, 1e20, -1e20]).astype(np.float32)
    wanted = reference(x[:-3].astype(np.float64))
    found = on_array(getattr(elementary, name), x)
    assert found.dtype == np.float32
    error, scale = np.abs(found[:-3] - wanted), np.abs(wanted)
    assert error.max() < 4e-7
    assert name in ("sin", "cos") or (error[scale > 0] / scale[scale > 0]).max() < 4e-7
    assert np.isnan(found[-3])
    assert (np.abs(found[-2:]) <= 1.6).all()


@needs_gcc
@pytest.mark.parametrize(("dtype", "room"), [(np.float32, 4e-7), (np.float64, 1e-15)], ids=["single", "double"])
def test_errors_of_the_header_are_small_and_nan_stays(dtype, room):
    flags = ["-DOFFPISTE_DOUBLE"] if dtype is np.float64 else []
    library = compiled(shipped_text("elementary.h") + LOOPS, *flags)
    for name, (reference, x) in FUNCTIONS.items():
        found = np.append(x, np.nan).astype(dtype)
        wanted = reference(found[:-1].astype(np.float64))
        getattr(library, f"{name}s")(ctypes.c_void_p(found.ctypes.data), ctypes.c_int(len(found)))
        assert np.isnan(found[-1])
        assert np.abs(found[:-1] - wanted).max() < room, name


def test_generated_code_is_current():
    for path, text in generate.files().items():
        assert path.read_text() == text, "run `python -m offpiste.dynamics.kernels.generate`"


f4, checked = np.float32, numba.njit(boundscheck=True)


@checked
def read_checked(numbers, index, outside, rows):
    read_fours(numbers, index, 1, outside, rows)


@checked
def move_checked(a, at, b, to):
    store(b, to, load(a, at))


def test_bounds_are_checked_where_numba_checks_them():
    numbers, index, rows = np.zeros(100, f4), np.full(LANES, 95, np.int32), np.zeros(4 * LANES, f4)
    read_checked(numbers, index, numbers, rows)
    index[7] = 96
    with pytest.raises(IndexError):
        read_checked(numbers, index, numbers, rows)
    index[7] = 95
    for wrong in (
        (numbers, index, numbers[:4], rows),
        (numbers, index, numbers, rows[1:]),
        (numbers, index[1:], numbers, rows),
    ):
        with pytest.raises(IndexError):
            read_checked(*wrong)
    a = np.zeros(WIDTH + 1, f4)
    move_checked(a, 1, a, 0)
    for at, to in ((2, 0), (0, 2), (-1, 0)):
        with pytest.raises(IndexError):
            move_checked(a, at, a, to)
