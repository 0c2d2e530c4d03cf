"""Predicted regions are drawn where they are, as large as they are."""

import numpy as np
import pytest
import torch

from offpiste.core.state import Trajectory
from offpiste.uncertainty.calibration import NOMINAL
from offpiste.uncertainty.fit import SpreadPrediction
from offpiste.visualization.predicted_regions import draw_regions, ellipses


def straight(windows: int = 3) -> SpreadPrediction:
    """North at 5 m/s; the scale grows by 0.2 m a moment along, half of that across."""
    state = torch.zeros(windows, 250, 6)
    state[..., 1] = 0.1 * torch.arange(1, 251)
    state[..., 2] = np.pi / 2
    along = 0.2 * torch.arange(1.0, 26)
    scale = torch.stack((along, along / 2), dim=-1).expand(windows, 25, 2)
    return SpreadPrediction(Trajectory(state, torch.zeros(windows, 250, 4)), scale, 5.0)


def test_ellipses_lie_on_the_predicted_path_along_its_heading():
    found = straight()
    drawn = ellipses(found, 1)
    assert [ellipse.center[1] for ellipse in drawn[:3]] == pytest.approx([5.0, 15.0, 25.0])
    assert all(ellipse.angle == pytest.approx(90) for ellipse in drawn)
    for ellipse, probability in zip(drawn[2::3], NOMINAL, strict=True):
        along, across = found.region(probability)[1, 24].tolist()
        assert (ellipse.width, ellipse.height) == pytest.approx((2 * along, 2 * across), rel=1e-5)


def test_a_panel_a_window():
    figure = draw_regions(straight(), np.zeros((3, 250, 2)), "dc")
    used = [axes for axes in figure.axes if axes.patches]
    assert len(used) == 3
    assert all(len(axes.patches) == 9 and len(axes.lines) == 4 for axes in used)
