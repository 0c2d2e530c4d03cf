"""The elementary functions of the header, in single and in double precision, against NumPy."""

import ctypes

import numpy as np
import pytest

from dynamics.kernels.test_elementary import ANGLES, WIDE
from host_kernels import compiled, needs_gcc
from offpiste.dynamics.header.step_text import shipped_text

FUNCTIONS = {"sin": (np.sin, ANGLES), "cos": (np.cos, ANGLES), "tanh": (np.tanh, WIDE), "atan": (np.arctan, WIDE)}
LOOPS = "\n".join(
    f'extern "C" void {name}s(offpiste_real* x, int n) {{ for (int i = 0; i < n; i++) x[i] = offpiste_{name}(x[i]); }}'
    for name in FUNCTIONS
)


@needs_gcc
@pytest.mark.parametrize(("dtype", "room"), [(np.float32, 4e-7), (np.float64, 1e-15)], ids=["single", "double"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_errors_are_as_small_as_stated_and_nan_stays(name, dtype, room):
    reference, x = FUNCTIONS[name]
    x = np.append(x, np.nan).astype(dtype)
    flags = ["-DOFFPISTE_DOUBLE"] if dtype is np.float64 else []
    library = compiled(shipped_text("elementary.h") + LOOPS, *flags)
    found = x.copy()
    getattr(library, f"{name}s")(ctypes.c_void_p(found.ctypes.data), ctypes.c_int(len(x)))
    wanted = reference(x.astype(np.float64))
    assert np.isnan(found[-1])
    assert np.abs(found[:-1] - wanted[:-1]).max() < room
