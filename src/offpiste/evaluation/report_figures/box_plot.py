"""Box plot of the distance errors."""

from matplotlib.figure import Figure

from offpiste.evaluation.box_plots import box_plot
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.report_figures import distance_errors, report_figure, title_of

CAPTION = (
    "Distance error after 5 s. Boxes: quartiles; whiskers: last value within 1.5 IQR, given by the values with "
    "arrows; green: median; orange: mean. Values beyond the whiskers are not drawn."
)


@report_figure("box", section="Mean distance error by horizon", caption=CAPTION)
def draw(evaluation: Evaluation) -> Figure:
    """Distance errors after 5 s by model and terrain lookup."""
    return box_plot(distance_errors(evaluation), title=title_of(evaluation))
