"""A figure of the evaluation's report from outside the package: error by the yaw rate at the start.

Name this module in the environment to have it in the report:

    PYTHONPATH=examples/extending OFFPISTE_EXTENSIONS=yaw_rate_figure offpiste evaluate runs/dc --dataset data.zarr
"""

import numpy as np

from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.report_figures import deciding_errors, report_figure, title_of
from offpiste.evaluation.report_figures.distance_error import binned_plot
from offpiste.report.chart import Chart

CAPTION = "Mean distance error after 5 s by the initial yaw rate; all bins hold equal numbers of windows."
TURNING = 1e-3
"""With less yaw rate in every window, the figure is left out [rad/s]."""


@report_figure("yaw_rate", section="Error by yaw rate", caption=CAPTION)
def draw(evaluation: Evaluation) -> Chart | None:
    """Error by the magnitude of the yaw rate; None where no window turns."""
    yaw_rate = np.abs(evaluation.windows.start_state[:, 5])
    if yaw_rate.max() < TURNING:
        return None
    axis = "Yaw rate at the start [rad/s]"
    return binned_plot(deciding_errors(evaluation), yaw_rate, axis=axis, title=title_of(evaluation))
