"""Shape and type checks of a sample of calls: the first ones of a function in a test, and some later ones."""

from collections import defaultdict
from collections.abc import Callable
from functools import partial, wraps
from types import FunctionType
from typing import Any

import jaxtyping
from jaxtyping import _decorator

FIRST, EVERY = 32, 32

_calls: defaultdict[int, int] = defaultdict(int)
_all_calls = _decorator.jaxtyped


def begin_test() -> None:
    """Restart the count of calls."""
    _calls.clear()


def sampled(function: Any = None, *, typechecker: Any) -> Any:
    """Like `jaxtyping.jaxtyped`, for a sample of the calls."""
    if function is None:
        return partial(sampled, typechecker=typechecker)
    if not isinstance(function, FunctionType):
        return _all_calls(function, typechecker=typechecker)
    checked: list[Callable[..., Any]] = []

    @wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        before = _calls[number]
        _calls[number] = before + 1
        if jaxtyping.config.jaxtyping_disable or (before >= FIRST and before % EVERY):
            return function(*args, **kwargs)
        if not checked:  # not earlier: that takes a millisecond, and most functions are never called in this process
            checked.append(_all_calls(function, typechecker=typechecker))
        return checked[0](*args, **kwargs)

    number = id(checked)  # which lives as long as this
    return called


def install() -> None:
    """Use sampled checks in the import hook."""
    jaxtyping.jaxtyped = _decorator.jaxtyped = sampled
