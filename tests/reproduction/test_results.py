"""Gains over `b`, seeds and verdicts against numbers worked out by hand."""

import numpy as np
import pytest

from offpiste.evaluation.errors import COMPONENTS, Errors
from offpiste.evaluation.intervals import PairedDifference, Sampling
from offpiste.evaluation.result_rows import RunErrors
from offpiste.reproduction.results import Findings, last_rows
from offpiste.reproduction.settings import members
from offpiste.reproduction.tables import distance_table, error_table, fig3_claims, fig4_claims, seed_table, verdict

STORED = 40
N = 120


def errors(distance: float | np.ndarray, loss: float = 1.0, vx: float = 1.0) -> Errors:
    """Windows of two drives, one every 0.5 s, all with the same numbers but the distance at 5 s."""
    values = np.ones((N, 5, 5))
    values[:, -1, 0] = distance
    values[:, -1, COMPONENTS.index("vx_error_mps")] = vx
    row = np.tile(np.arange(N // 2) * 25 + 10, 2)
    return Errors(np.repeat([0, 1], N // 2), row, values, np.full(N, loss))


def found(figure: str, given: dict[str, list[Errors]], readings: list) -> Findings:
    """Every model is as `given` by its label, or else as the first `cf`; every way is alike."""
    runs = {
        (member, reading): [
            RunErrors(seed, None, run) for seed, run in enumerate(given.get(member.label, given["cf"][:1]))
        ]
        for member in members(figure, STORED)
        for reading in readings
    }
    return Findings(runs, Sampling())


def test_a_gain_is_of_the_means_over_seeds_and_windows():
    b, cf = [errors(2.0), errors(4.0)], [errors(1.0), errors(2.0)]
    findings = found("fig3", {"b": b, "cf": cf}, [("recorded", "hindsight")])
    member = next(m for m in findings.members if m.label == "cf")
    against = findings.against(member, ("recorded", "hindsight"))
    assert against.relative["distance_error_m"].mean == pytest.approx(1.5 / 3.0 - 1)
    assert against.relative["distance_error_m"].ci95 == pytest.approx((-0.5, -0.5))
    assert (against.n, against.seed, against.seen) == (N, None, False)
    single = findings.each_seed(member, ("recorded", "hindsight"))
    assert [run.relative["distance_error_m"].mean for run in single] == pytest.approx([-0.5, -0.5])
    assert "-50.0, -50.0 (std 0.0)" in seed_table(findings).lines[0]


def test_only_seen_windows_count_where_asked():
    distance = np.where(np.arange(N) % 2, 1.0, 3.0)
    findings = found("fig3", {"b": [errors(2.0)], "cf": [errors(distance)]}, [("recorded", "hindsight")])
    member = next(m for m in findings.members if m.label == "cf")
    reading = ("recorded", "hindsight")
    assert findings.against(member, reading).relative["distance_error_m"].mean == pytest.approx(0.0)
    seen = findings.against(member, reading, np.arange(N) % 2 == 1)
    assert seen.relative["distance_error_m"].mean == pytest.approx(-0.5)
    assert (seen.n, seen.seen) == (N // 2, True)
    nothing = findings.against(member, reading, np.zeros(N, bool))
    assert nothing.n == 0
    assert np.isnan(nothing.relative["loss"].mean)


@pytest.mark.parametrize(
    ("mean", "interval", "said"),
    [
        (-0.12, (-0.14, -0.11), "yes"),
        (-0.12, (-0.14, -0.09), "yes, not certain"),
        (-0.05, (-0.11, 0.0), "no, not certain"),
        (-0.05, (-0.06, -0.04), "no"),
        (-0.12, (np.nan, np.nan), "yes, not certain"),
        (np.nan, (np.nan, np.nan), "–"),
    ],
)
def test_verdicts_ask_mean_and_interval(mean, interval, said):
    assert verdict(PairedDifference(mean, interval), -0.10) == said


def test_claims_of_figure_3():
    given = {"b": [errors(2.0)], "cf": [errors(1.8, 0.85, 0.95)], "df": [errors(1.7)], "cf (n=1)": [errors(2.2)]}
    findings = found("fig3", given, [("recorded", "hindsight"), ("map", None)])
    same = {claim: (here, verdict) for claim, _, here, verdict in fig3_claims(findings, STORED).lines}
    loss = same["cf against b, mean summed loss, recorded lookup in hindsight"]
    assert loss[0].startswith("-15.0 %")
    assert loss[1] == "yes"
    assert same["cf against b, mean v_x error at 5 s, recorded lookup in hindsight"][1] == "no"
    assert same["df at or slightly below cf, distance error, map at predicted places"][1] == "yes"
    assert same["robust to n, distance error against b"][1] == "no"
    assert same["robust to PCA features, distance error against b"][1] == "yes"


def test_claims_and_tables_of_figure_4():
    sets = ("hindsight", "-20", "-10", "0", "10", "20", "30", "40")
    findings = found(
        "fig4", {"b": [errors(2.0)], "cf": [errors(1.9)], "df": [errors(2.5)]}, [("recorded", name) for name in sets]
    )
    same = {claim: verdict for claim, *_, verdict in fig4_claims(findings).lines}
    assert same["df falls behind b far away"] == "yes"
    assert same["cf falls behind b far away"] == "no"
    assert same["df is more sensitive than cf"] == "yes"
    assert same["dc below b at 30 m"] == "yes"
    table = distance_table(findings, findings.rows(), "distance_error_m")
    line = {name: numbers for name, *numbers in table.lines if not name.startswith(" ")}
    assert line["df"] == ["2.500"] * 8
    assert line["b"] == ["2.000"] * 8
    assert len(error_table(findings.rows()).lines) == 4 * 8


def test_rows_over_all_seeds_stand_for_models_with_several():
    findings = found("fig3", {"b": [errors(2.0), errors(3.0)], "cf": [errors(1.0)]}, [("recorded", "hindsight")])
    rows = findings.rows()
    assert [row.distance_error_m.mean for row in last_rows(rows) if row.model == "b"] == pytest.approx([2.5])
    assert {row.seed for row in last_rows(rows, single=True)} == {0, 1}
