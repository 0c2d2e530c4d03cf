"""Gains and shares with known answers, and how they are written."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from experiments.control_experiments.tables import write_control
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.intervals import PairedDifference, Sampling
from offpiste.report.text_table import TextTable
from offpiste.reproduction.results import MAP, gain, gain_table, runs_of, share
from window_errors import BASE, ROW, errors


def test_a_model_that_is_a_quarter_better_everywhere() -> None:
    found = gain("case", "dc", [errors(0.75 * BASE.distance())], [BASE], MAP)
    assert found.distance.mean == pytest.approx(-0.25)
    assert found.distance.ci95 == pytest.approx((-0.25, -0.25))
    assert found.loss.mean == pytest.approx(0.75**2 - 1)
    assert (found.n, found.levels.seeds, found.lookup) == (len(ROW), 1, "map")


def test_seeds_are_averaged_window_by_window() -> None:
    both = [errors(0.5 * BASE.distance()), errors(1.5 * BASE.distance())]
    found = gain("", "dc", both, [BASE], MAP)
    assert (found.distance.mean, found.levels.seeds) == (pytest.approx(0.0, abs=1e-12), 2)


def test_a_model_of_one_seed_is_compared_with_the_baseline_of_that_seed() -> None:
    others = [BASE, errors(9.0 * BASE.distance()), errors(9.0 * BASE.distance())]
    found = gain("", "dc", [errors(0.75 * BASE.distance())], others, MAP)
    assert (found.distance.mean, found.levels.seeds) == (pytest.approx(-0.25), 1)


def shared(*errors: Errors) -> PairedDifference:
    """The share, of one run each."""
    return share(*(runs_of([each]) for each in errors), Sampling().on(BASE))


def test_share_of_the_oracle_by_hand() -> None:
    # The oracle halves the error of its own baseline; the model takes off a fifth of its own: 0.2 / 0.5.
    own = errors(1.3 * BASE.distance())
    reached = shared(errors(0.8 * BASE.distance()), BASE, errors(0.5 * own.distance()), own)
    assert reached.mean == pytest.approx(0.4)
    assert reached.ci95 == pytest.approx((0.4, 0.4))


def test_an_oracle_without_a_gain_has_no_shares() -> None:
    worse = errors(1.1 * BASE.distance())
    assert np.isnan(shared(errors(0.8 * BASE.distance()), BASE, worse, BASE).mean)


def test_a_failed_window_leaves_no_share() -> None:
    broken = errors(np.where(ROW == 0, np.inf, BASE.distance()))
    assert np.isnan(shared(broken, BASE, BASE, BASE).mean)


def test_what_is_written_can_be_read(tmp_path: Path) -> None:
    found = gain("shifted", "dc", [errors(0.75 * BASE.distance())], [BASE], MAP)
    table = gain_table("Title", [found], "About.")
    page = write_control(tmp_path, [table], {"gains": [found], "odd": float("nan")}, {"picture": Figure()})
    text = page.read_text("utf-8")
    assert "| dc, shifted | map | " in text
    assert "-25.0 % [-25.0, -25.0]" in text
    assert (tmp_path / "picture.png").exists()
    read = json.loads((tmp_path / "control.json").read_text("utf-8"))
    assert read["gains"][0]["distance"]["mean"] == pytest.approx(-0.25)
    assert read["odd"] is None


def test_markdown_has_a_line_per_line() -> None:
    text = TextTable("T", ("a", "b"), (("1", "2"), ("3", "4")), "About.").markdown()
    assert text == "## T\nAbout.\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n| 3 | 4 |\n"
