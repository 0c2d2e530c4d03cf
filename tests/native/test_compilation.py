"""Compiled entries and their sources."""

import numba
import numpy as np

from offpiste.native.compilation import Compiler


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


def linkages(caller):
    (compiled,) = caller.overloads.values()
    return {function.name: function.linkage.name for function in compiled.library.get_defined_functions()}


def test_an_entry_calls_its_own_copies_of_other_functions():
    # Weak symbols would be those of whatever the process compiled or loaded first, rounded in another way.
    names: dict = {}
    exec("def fibonacci(n):\n    return n if n < 2 else fibonacci(n - 1) + fibonacci(n - 2)\n", names)
    exec("def caller(n):\n    return fibonacci(n)\n", names)
    names["fibonacci"] = Compiler(()).loop(names["fibonacci"])
    plain, entry = numba.njit(names["caller"]), Compiler(()).entry(names["caller"])
    assert plain(10) == entry(10) == 55
    found = [[link for name, link in linkages(of).items() if "fibonacci" in name] for of in (plain, entry)]
    assert found == [["linkonce_odr"], ["internal"]]
    assert "linkonce_odr" not in linkages(entry).values()
