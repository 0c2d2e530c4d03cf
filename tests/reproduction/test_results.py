"""Gains over `b`, seeds and verdicts against numbers worked out by hand."""

import numpy as np
import pytest

from offpiste.core.conventions import FEATURE_SETS
from offpiste.evaluation.errors import ERROR_NAMES, Errors
from offpiste.evaluation.intervals import PairedDifference, Sampling
from offpiste.evaluation.metrics import RunErrors
from offpiste.reproduction.report import distance_table, fig3_claims, fig4_claims, seed_table, verdict
from offpiste.reproduction.results import HINDSIGHT, MAP, FigureResults
from offpiste.reproduction.settings import figure_models

STORED = 40
N = 120
SETS = [("recorded", name) for name in FEATURE_SETS]


def errors(distance: float | np.ndarray, loss: float = 1.0, vx: float = 1.0) -> Errors:
    """Windows of five drives, one every 0.5 s, all with the same numbers but the distance at 5 s."""
    values = np.ones((N, 5, 5))
    values[:, -1, 0] = distance
    values[:, -1, ERROR_NAMES.index("vx_error_mps")] = vx
    row = np.tile(np.arange(N // 5) * 25 + 10, 5)
    return Errors(np.repeat(np.arange(5), N // 5), row, values, np.full(N, loss))


def figure_results(figure: str, given: dict[str, list[Errors]], readings: list) -> FigureResults:
    """Every model is as `given` by its label, or else as the first `cf`; all readings are alike."""
    runs = {
        (member, reading): [
            RunErrors(seed, None, run) for seed, run in enumerate(given.get(member.label, given["cf"][:1]))
        ]
        for member in figure_models(figure, STORED)
        for reading in readings
    }
    return FigureResults(runs, Sampling())


def test_comparisons_are_of_the_means_over_seeds_and_windows():
    b, cf = [errors(2.0), errors(4.0)], [errors(1.0), errors(2.0)]
    results = figure_results("fig3", {"b": b, "cf": cf}, [HINDSIGHT])
    comparison = results.compare("cf", HINDSIGHT)
    assert comparison.relative["distance_error_m"].mean == pytest.approx(1.5 / 3.0 - 1)
    assert comparison.relative["distance_error_m"].ci95 == pytest.approx((-0.5, -0.5))
    assert (comparison.n, comparison.seed) == (N, None)
    single = results.compare_seeds("cf", HINDSIGHT)
    assert [run.relative["distance_error_m"].mean for run in single] == pytest.approx([-0.5, -0.5])
    assert "-50.0, -50.0 (std 0.0)" in seed_table(results).lines[0]


@pytest.mark.parametrize(
    ("mean", "interval", "expected"),
    [
        (-0.12, (-0.14, -0.11), "yes"),
        (-0.12, (-0.14, -0.09), "yes, not certain"),
        (-0.05, (-0.11, 0.0), "no, not certain"),
        (-0.05, (-0.06, -0.04), "no"),
        (-0.12, (np.nan, np.nan), "yes, not certain"),
        (np.nan, (np.nan, np.nan), "–"),
        (0.0, (0.0, 0.0), "no"),
    ],
)
def test_verdicts_follow_mean_and_interval(mean, interval, expected):
    assert verdict(PairedDifference(mean, interval), -0.10) == expected


def test_claims_of_figure_3():
    given = {"b": [errors(2.0)], "cf": [errors(1.8, 0.85, 0.95)], "df": [errors(1.7)], "cf (n=1)": [errors(2.2)]}
    results = figure_results("fig3", given, [HINDSIGHT, MAP])
    same = {claim: (here, verdict) for claim, _, here, verdict in fig3_claims(results, STORED).lines}
    loss = same["CF against B, mean summed loss, recorded lookup in hindsight"]
    assert loss[0].startswith("-15.0 %")
    assert loss[1] == "yes"
    assert same["CF against B, mean v_x error at 5 s, recorded lookup in hindsight"][1] == "no"
    assert same["DF equal to or slightly below CF, distance error, map at predicted places"][1] == "yes"
    assert same["robust to n, distance error against B"][1] == "no"
    assert same["robust to PCA features, distance error against B"][1] == "yes"


def test_claims_and_tables_of_figure_4():
    given = {"b": [errors(2.0)], "cf": [errors(1.9)], "df": [errors(2.5)]}
    results = figure_results("fig4", given, SETS)
    same = {claim: verdict for claim, *_, verdict in fig4_claims(results).lines}
    assert same["DF above B at large distances"] == "yes"
    assert same["CF above B at large distances"] == "no"
    assert same["DF more sensitive than CF"] == "yes"
    assert same["DC below B at 30 m"] == "yes"
    table = distance_table(results, results.rows(), "distance_error_m")
    line = {name: numbers for name, *numbers in table.lines if not name.startswith(" ")}
    assert line["DF"] == ["2.500"] * 8
    assert line["blind (B)"] == ["2.000"] * 8


def noisy(seed: int, mean: float) -> Errors:
    """Means of 2 m and more, far noisier than models differ."""
    return errors(mean + 0.5 * np.random.default_rng(seed).standard_normal(N))


def test_noise_makes_no_claim_certain():
    given = {label: [noisy(seed, 2.0)] for seed, label in enumerate(("b", "cf", "df", "dc"))}
    results = figure_results("fig4", given, SETS)
    for claim, *_, said in fig4_claims(results).lines:
        assert said.endswith(", not certain"), claim
    three = figure_results("fig3", given, [HINDSIGHT])
    for claim, *_, said in fig3_claims(three, STORED).lines:
        if "robust" in claim or "slightly below" in claim:
            assert said.endswith(", not certain"), claim


def test_a_claim_of_several_numbers_is_as_certain_as_the_one_that_decides():
    results = figure_results("fig4", {"b": [noisy(0, 2.0)], "cf": [noisy(1, 2.0)]}, SETS)
    runs = dict(results.runs)
    for model, reading in results.runs:
        if model.label == "df" and reading[1] == "40":
            runs[model, reading] = [RunErrors(0, None, noisy(2, 4.0))]
    same = {claim: said for claim, *_, said in fig4_claims(FigureResults(runs, Sampling())).lines}
    assert same["DF above B at large distances"] == "yes"
    assert same["DF more sensitive than CF"] == "yes"
    assert same["CF above B at large distances"].endswith("not certain")


def test_models_are_apart_by_the_mean_over_lookups_of_their_difference_relative_to_b():
    given = {"b": [errors(2.0)], "cf": [errors(1.9)], "df": [errors(2.5)]}
    results = figure_results("fig4", given, [("recorded", "20"), ("recorded", "30")])
    found = results.apart("df", "cf", results.readings)
    assert found.mean == pytest.approx(0.3)
    assert found.ci95 == pytest.approx((0.3, 0.3))
    failed = figure_results("fig4", given | {"df": [errors(np.inf)]}, [("recorded", "20")])
    assert np.isnan(failed.apart("df", "cf", failed.readings).mean)
