"""Ratios of several sets of courses as one."""

import math

import pytest

from experiments.closed_loop_table.pooled import Ratio, main, pooled


def test_one_set_is_itself_and_equal_sets_halve_the_variance():
    ratio = Ratio(0.8, 0.8 / 1.2, 0.8 * 1.2)
    assert pooled([ratio]) == pytest.approx(ratio)
    four = pooled([ratio] * 4)
    assert four.value == pytest.approx(0.8)
    assert math.log(four.high / four.low) == pytest.approx(math.log(ratio.high / ratio.low) / 2)


def test_a_set_counts_by_the_inverse_of_its_variance():
    wide, narrow = Ratio(1.0, math.exp(-0.2), math.exp(0.2)), Ratio(math.e, math.exp(0.9), math.exp(1.1))
    assert math.log(pooled([wide, narrow]).value) == pytest.approx(4 / 5)


def test_the_published_tables_give_the_numbers_of_the_readme(capsys):
    main(["0.83,0.64,1.04", "0.88,0.71,1.05", "0.91,0.77,1.08", "0.83,0.69,0.94"])
    main(["0.85,0.71,1.02", "0.75,0.60,0.90"])
    assert capsys.readouterr().out == "-14 % [-21, -5]\n-20 % [-30, -8]\n"


@pytest.mark.parametrize("text", ["0.8", "0.8,0.9,1.0", "a,b,c", "0.8,-0.1,1.0", "0.8,0.7,nan"])
def test_what_is_no_interval_is_refused_in_one_line(text, capsys):
    with pytest.raises(SystemExit) as ended:
        main([text])
    assert ended.value.code == 2
    assert text in capsys.readouterr().err
