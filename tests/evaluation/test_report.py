"""Sentences of reports, and tables without an interval."""

import numpy as np

from offpiste.evaluation.errors import Errors
from offpiste.evaluation.intervals import Levels, Sampling
from offpiste.evaluation.metrics import Case, Headline, ResultRow, RunErrors, pooled_rows, result_rows, single_rows
from offpiste.evaluation.report import difference_text, drawn_from, headline_text
from window_errors import errors as of_distances

NAMES = ("b", "dc")


def errors(failed: tuple[int, ...] = (), *, windows: int = 10) -> Errors:
    """Of five drives, one window a block; some predictions are not finite."""
    distance = np.ones(5 * windows)
    distance[list(failed)] = np.inf
    return of_distances(distance, drives=5, every=600)


def rows(*runs: list[Errors]) -> list[ResultRow]:
    """At 5 s, of models with these runs."""
    cases = {
        Case(name, "", "causal", None): [RunErrors(seed, None, one) for seed, one in enumerate(each)]
        for name, each in zip(NAMES, runs, strict=False)
    }
    return [row for row in result_rows(cases, "test", Sampling()) if row.horizon_s == 5.0]


def test_failed_predictions_are_not_called_few_blocks() -> None:
    found = rows([errors((3,))], [errors()])
    assert "5 drives, 50 blocks" in drawn_from(found)
    assert "predictions failed" in drawn_from(found)
    assert "few blocks" not in drawn_from(found)
    said = difference_text("b", "dc", found[0].minus["dc"].distance_error_m, found[0].levels)
    assert said == "b and dc are not compared: predictions failed, see below."


def test_few_blocks_are_not_called_failed() -> None:
    one = errors().take(np.array([0, 1]))
    (found, _) = rows([one], [one])
    assert "–: no interval, since there are only 2 blocks of one drive" in drawn_from([found])
    assert "failed" not in drawn_from([found])
    assert "no interval" in difference_text("b", "dc", found.minus["dc"].distance_error_m, found.levels)
    assert "–" not in drawn_from(rows([errors()]))


def test_readings_with_other_intervals_are_told_apart() -> None:
    on_map, recorded = (Case("b", "", "causal", lookup) for lookup in ("map", "recorded"))
    cases = {on_map: [RunErrors(0, None, errors())], recorded: [RunErrors(0, None, errors(windows=20))]}
    text = drawn_from(result_rows(cases, "test", Sampling()))
    assert "50 blocks" in text.partition("(blind · map)")[0]
    assert "100 blocks" in text.partition("(blind · recorded)")[0].partition("(blind · map)")[2]


def test_each_failed_prediction_counts_once() -> None:
    found = rows([errors((3,)), errors((7,))], [errors((1,))])
    assert [row.n_failed for row in pooled_rows(found)] == [2, 1]
    assert sum(row.n_failed for row in single_rows(found)) == 3
    assert [(row.model, row.seed) for row in single_rows(found)] == [("b", 0), ("b", 1), ("dc", 0)]


def test_headlines_state_the_difference_to_the_reference() -> None:
    about = {"model": "b", "start": "causal", "lookup": "map", "other": "kinematic", "levels": Levels(5, 9, 3)}
    better = Headline(**about, runs=3, distance_error_m=1.7, relative=-0.5, ci95=(-0.61, -0.42))
    assert headline_text(better) == (
        "blind: 1.70 m mean distance error after 5 s, 50 % [42, 61] below kinematic "
        "(causal start, map lookup, mean of 3 runs)"
    )
    worse = Headline(**about, runs=1, distance_error_m=4.0, relative=0.2, ci95=(-0.1, 0.5))
    assert "20 % [-10, 50] above kinematic" in headline_text(worse)
    failed = Headline(**about, runs=1, distance_error_m=np.inf, relative=np.nan, ci95=(np.nan, np.nan))
    assert headline_text(failed) == "blind: – m mean distance error after 5 s (causal start, map lookup)"
