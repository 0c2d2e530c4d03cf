"""The key under which compiled costs are kept: it changes with all that an added term reads."""

from pathlib import Path
from types import ModuleType

from offpiste.planning.kernel_costs import _sources


def far_term_with(factor, bent, limits=None):
    """A term that reads a number, a function and another module, as of imports."""
    module = {"__name__": "own_terms", "FACTOR": factor, "bent": bent, "limits": limits}
    exec("def far_term(distance): return FACTOR * bent(distance) + limits.LEAST", module)
    return module["far_term"]


def straight(x):
    return x


def squared(x, *, power=2):
    return x**power


def again(x):
    return again(x - 1) if x > 0 else x


def key(*read) -> str:
    return "".join(_sources([far_term_with(*read)]))


def test_numbers_and_functions_are_in_it():
    keys = [key(*read) for read in ((3, straight), (300, straight), (3, squared), (3, straight))]
    assert len(set(keys)) == 3
    assert keys[0] == keys[3]


def test_a_function_that_calls_itself_is_in_it_once():
    assert key(3, again).count("'again' ") == 1


def test_so_are_modules(tmp_path: Path):
    """Whatever is read of them, by their text."""
    limits = ModuleType("own_limits")
    keys = []
    for number, least in enumerate((1, 2)):
        limits.__file__ = str(tmp_path / f"own_limits_{number}.py")
        Path(limits.__file__).write_text(f"LEAST = {least}\n")
        keys.append(key(3, straight, limits))
    assert keys[0] != keys[1]
