"""Predicted regions are drawn where they are, as large as they are."""

import numpy as np
import pytest
import torch

from offpiste.core.state import Trajectory
from offpiste.uncertainty.calibration import NOMINAL
from offpiste.uncertainty.fit import SpreadPrediction
from offpiste.visualization.predicted_regions import ellipses, regions_chart


def straight(windows: int = 3) -> SpreadPrediction:
    """North at 5 m/s; the scale grows by 0.2 m a moment along, half of that across."""
    state = torch.zeros(windows, 250, 6)
    state[..., 1] = 0.1 * torch.arange(1, 251)
    state[..., 2] = np.pi / 2
    along = 0.2 * torch.arange(1.0, 26)
    scale = torch.stack((along, along / 2), dim=-1).expand(windows, 25, 2)
    return SpreadPrediction(Trajectory(state, torch.zeros(windows, 250, 4)), scale, 5.0)


def test_outlines_lie_on_the_predicted_path_along_its_heading():
    found = straight()
    drawn = ellipses(found, 1)
    assert [outline[:-1, 1].mean() for outline in drawn[:3]] == pytest.approx([5.0, 15.0, 25.0], rel=1e-5)
    for outline, probability in zip(drawn[2::3], NOMINAL, strict=True):
        along, across = found.region(probability)[1, 24].tolist()
        assert np.ptp(outline, axis=0) == pytest.approx((2 * across, 2 * along), rel=1e-5)


def test_a_panel_a_window():
    panels = regions_chart(straight(), np.zeros((3, 250, 2)), "dc").panels
    assert [len(panel.lines) for panel in panels] == [11] * 3
    for line in panels[0].lines:
        assert panels[0].y_range[0] < line.y.min() <= line.y.max() < panels[0].y_range[1]


def test_a_failed_prediction_leaves_the_axes_finite():
    found, recorded = straight(), np.zeros((3, 250, 2))
    found.trajectory.state[0, 100:] = torch.nan
    found.trajectory.state[1, 100:, 0] = torch.inf
    panels = regions_chart(found, recorded, "dc").panels
    assert all(np.isfinite((panel.x_range, panel.y_range)).all() for panel in panels)
