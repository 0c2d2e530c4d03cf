import numpy as np

from offpiste.dynamics.kernels import jit


def test_an_entry_works_where_machine_code_cannot_be_kept():
    names: dict = {}
    exec("def double(x):\n    return x + x\n", names)  # has no file, so Numba has no place beside it
    assert jit.entry(names["double"])(np.float32(2)) == 4


def test_the_name_of_an_entry_depends_on_the_sources(monkeypatch):
    def entry(x):
        return x

    before = jit.entry(entry).py_func.__qualname__
    monkeypatch.setattr(jit, "_sources", lambda: "other")
    assert jit.entry(entry).py_func.__qualname__ != before
