"""Risk settings: their notation, their effect on the cost, and their requirements."""

import numpy as np
import pytest
import torch
from scipy import stats

from offpiste.core.errors import PlanningError
from offpiste.core.state import Trajectory
from offpiste.planning.caution import (
    AddSpread,
    AsPredicted,
    Caution,
    WorstShare,
    caution_of,
    mean_of_worst,
    risk_of,
)
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import driving_terms
from offpiste.uncertainty.spread import Spread
from planning_maps import situation


@pytest.mark.parametrize(
    ("text", "risk"),
    [
        ("none", AsPredicted()),
        ("spread", AddSpread()),
        ("spread:1.5", AddSpread(1.5)),
        ("cvar", WorstShare()),
        ("cvar:0.05", WorstShare(0.05)),
    ],
)
def test_a_risk_is_read_from_its_text(text, risk):
    assert risk_of(text) == risk


@pytest.mark.parametrize(
    "text",
    ["", "none:1", "spread:", "spread:much", "spread:-1", "spread:nan", "spread:inf", "cvar:0", "cvar:2", "mean"],
)
def test_an_unknown_risk_is_refused_in_one_line(text):
    with pytest.raises(PlanningError) as refused:
        risk_of(text)
    assert "\n" not in str(refused.value)
    assert "give" in str(refused.value)


@pytest.mark.parametrize(("share", "freedom"), [(0.05, 3.0), (1.0, 5.0)])
def test_the_mean_of_the_worst_errors_is_that_of_drawn_ones(share, freedom):
    drawn = np.sort(np.abs(stats.t.rvs(freedom, size=2_000_000, random_state=0)))
    worst = drawn[round((1 - share) * len(drawn)) :]
    assert mean_of_worst(share, freedom) == pytest.approx(worst.mean(), rel=0.02)


def test_every_risk_but_none_needs_a_spread():
    spread = Spread(3)
    assert caution_of(AsPredicted(), None) is None
    assert caution_of(AsPredicted(), spread) is None
    assert caution_of(AddSpread(1.5), spread) == Caution(spread, 1.5)
    assert caution_of(WorstShare(0.2), spread).reach == pytest.approx(mean_of_worst(0.2, float(spread.freedom)))
    with pytest.raises(PlanningError, match=r"'cvar' needs a spread.*offpiste calibrate"):
        caution_of(WorstShare(), None)


@pytest.mark.parametrize(
    ("yaw", "away"), [(0.0, 0.5), (np.pi / 2, 2.0), (np.pi, 0.5), (float(np.arctan2(-0.8, 0.6)), 1.9)]
)
def test_the_margin_is_added_to_the_distance_across_the_course(yaw, away):
    """The course runs along x, 3 m beside the vehicle, with margins of 2 m along its heading and 0.5 m across."""
    state = torch.tensor([0.0, 3.0, yaw, 5, 0, 0]).expand(1, 4, 6)
    given = Trajectory(state, torch.zeros(1, 4, 4)), torch.zeros(1, 4, 3), situation(), CostWeights(path=2.0)
    margins = torch.tensor([2.0, 0.5]).expand(1, 4, 2)
    torch.testing.assert_close(driving_terms(*given, margins)["path"], torch.full((1, 4), 2 * (3 + away) ** 2))
    without = driving_terms(*given)
    torch.testing.assert_close(without["path"], torch.full((1, 4), 2 * 3.0**2))
    for name, term in driving_terms(*given, margins).items():
        assert name == "path" or torch.equal(term, without[name])
