import pytest

from offpiste.core.errors import PlanningError
from offpiste.planning.costs.c_expression import CExpression, called, traced


def test_arithmetic_becomes_c():
    def term(a, b, maximum):
        return maximum(2 * a - b / a, -1) ** 2 + (a > b) * -b + abs(b)

    given = {"a": CExpression("a"), "b": CExpression("b"), "maximum": called("offpiste_maximum")}
    text = traced(term, given, ("a", "b", "maximum"))
    largest = "offpiste_maximum(((2.0f * a) - (b / a)), (-1.0f))"
    assert text == f"((({largest} * {largest}) + ((a > b ? 1.0f : 0.0f) * (-b))) + offpiste_maximum(b, (-b)))"


@pytest.mark.parametrize(
    ("function", "reason"),
    [(lambda a: a if a > 0 else -a, "branch"), (lambda a: a**0.5, "power"), (lambda a: "x", "str instead of a number")],
)
def test_what_c_cannot_say_is_refused_in_one_line(function, reason):
    with pytest.raises(PlanningError, match=f"cannot be written as C: .*{reason}"):
        traced(function, {"a": CExpression("a")}, ("a",))
