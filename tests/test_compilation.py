"""Compiled entries: cached until a source changes."""

import numpy as np
import pytest

from offpiste.compilation import KERNELS, MAPPING, OCCLUSION, PHYSICS, PLANNING, RAYS, Compiler


def test_an_entry_works_where_machine_code_cannot_be_cached():
    names: dict = {}
    exec("def double(x):\n    return x + x\n", names)  # has no file, so Numba has no place beside it
    assert Compiler(()).entry(names["double"])(np.float32(2)) == 4


def test_the_name_of_an_entry_depends_on_the_sources(tmp_path):
    source = tmp_path / "called.py"

    def name():
        def same(x):
            return x

        return Compiler((str(source),)).entry(same).py_func.__qualname__

    source.write_text("one = 1")
    before = name()
    assert name() == before
    source.write_text("one = 2")
    assert name() != before


@pytest.mark.parametrize("compiler", [MAPPING, OCCLUSION, KERNELS, PLANNING, PHYSICS, RAYS])
def test_sources_exist(compiler, tmp_path):
    empty = Compiler((str(tmp_path / "nothing"),))
    assert compiler._digest != empty._digest
