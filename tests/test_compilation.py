"""Functions that Python calls: compiled, and kept until a source changes."""

import numpy as np

from offpiste.compilation import entry


def test_an_entry_works_where_machine_code_cannot_be_kept():
    names: dict = {}
    exec("def double(x):\n    return x + x\n", names)  # has no file, so Numba has no place beside it
    assert entry(names["double"], [])(np.float32(2)) == 4


def test_the_name_of_an_entry_depends_on_the_sources(tmp_path):
    source = tmp_path / "called.py"

    def name():
        def same(x):
            return x

        return entry(same, [source]).py_func.__qualname__

    source.write_text("one = 1")
    before = name()
    assert name() == before
    source.write_text("one = 2")
    assert name() != before
