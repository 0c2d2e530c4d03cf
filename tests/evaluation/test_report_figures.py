import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from offpiste.evaluation.box_plots import box_plot, styles
from offpiste.evaluation.intervals import Levels, Statistics
from offpiste.evaluation.metrics import ResultRow
from offpiste.evaluation.report_figures.distance_error import binned_plot, distribution_plot, growth_plot
from offpiste.evaluation.report_figures.worst_windows import WorstWindow, worst_plot

VALUES = np.array([0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 11.0, 30.0])
SPEED = "Speed at the start [m/s]"


def drawn(figure: Figure) -> Figure:
    FigureCanvasAgg(figure).draw()
    return figure


def test_axes_have_names_and_units() -> None:
    errors = {"b": VALUES, "kinematic": VALUES}
    by_speed = binned_plot(errors, np.linspace(2, 9, len(VALUES)), axis=SPEED)
    figures = [box_plot(errors), distribution_plot(errors), by_speed]
    for figure in figures:
        assert "[" in figure.axes[0].get_ylabel()
    assert "[m]" in figures[1].axes[0].get_xlabel()
    assert "[m/s]" in figures[2].axes[0].get_xlabel()


def test_binned_plot_has_bins_of_equal_size_worked_by_hand() -> None:
    speed = np.arange(12.0)
    line = binned_plot({"b": 2 * speed}, speed, axis=SPEED).axes[0].lines[0]
    assert line.get_xdata().tolist() == [0.5, 2.5, 4.5, 6.5, 8.5, 10.5]
    assert line.get_ydata().tolist() == [1.0, 5.0, 9.0, 13.0, 17.0, 21.0]


def test_binned_plot_of_one_speed() -> None:
    assert drawn(binned_plot({"b": VALUES}, np.full(len(VALUES), 3.0), axis=SPEED)).axes[0].lines


def test_distribution_of_a_failing_model_never_reaches_the_top() -> None:
    line = distribution_plot({"b": np.array([1.0, 2.0, np.inf, np.inf])}).axes[0].lines[0]
    finite = np.isfinite(line.get_xdata())
    assert line.get_ydata()[finite].max() == 50.0


def row(seconds: float, mean: float) -> ResultRow:
    one = Statistics(mean, mean, mean, mean, mean, (mean - 0.5, mean + 0.5))
    names = ("distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "yaw_rate_error_radps", "loss")
    about = {"model": "b", "variant": "", "seed": None, "fold": None, "start": "causal", "feature_set": None}
    rest = {
        "lookup": None,
        "part": "test",
        "horizon_s": seconds,
        "n": 9,
        "n_failed": 0,
        "minus": {},
        "levels": Levels(3, 9),
    }
    return ResultRow(**about, **rest, **dict.fromkeys(names, one))


def test_growth_has_a_line_and_a_band_a_model() -> None:
    rows = [row(float(s), 1.0 * s) for s in range(1, 6)]
    worse = [row(float(s), 2.0 * s) for s in range(1, 6)]
    axes = drawn(growth_plot({"b": rows, "kinematic": worse})).axes[0]
    assert axes.lines[0].get_ydata().tolist() == [1, 2, 3, 4, 5]
    band = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (0.5, 5.5)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["kinematic", "b"], "as the eye meets them"


def test_growth_of_a_failed_model_draws_what_is_finite() -> None:
    drawn(growth_plot({"b": [row(1.0, 1.0), row(2.0, np.inf)], "c": [row(1.0, np.nan), row(2.0, np.nan)]}))


def test_models_keep_their_colours_and_variants_differ() -> None:
    alone, together = styles(["b"]), styles(["kinematic", "b", "b (flat)", "mine"])
    assert alone["b"] == together["b"]
    assert together["b"][0] == together["b (flat)"][0]
    assert together["b"][1] != together["b (flat)"][1]
    assert len({colour for colour, _ in (together["kinematic"], together["b"])}) == 2


def window(error: float, runs: int = 1) -> WorstWindow:
    ahead = np.stack((np.linspace(0.1, 25, 250), np.linspace(0, 2, 250)), axis=1)
    predicted = {"b": tuple(ahead * (0.9 - 0.1 * i) for i in range(runs)), "kinematic": (ahead * 1.1,)}
    return WorstWindow("drive", 12.34, np.radians(-90), 5.0, error, ahead, predicted)


def test_worst_windows_are_drawn_heading_up_with_left_to_the_left() -> None:
    figure = drawn(worst_plot([window(3.0, runs=2)] + [window(2.0)] * 9))
    panels = [axes for axes in figure.axes if axes.axison]
    assert len(panels) == 10
    recorded = panels[0].lines[0]
    assert recorded.get_xdata()[-1] == pytest.approx(-2.0)
    assert recorded.get_ydata()[-1] == pytest.approx(25.0)
    title = panels[0].get_title()
    assert all(part in title for part in ("error 3.00 m", "5.0 m/s", "270°", "12.3 s"))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["recorded", "b", "kinematic"]
    assert "[m]" in panels[0].get_ylabel()


@pytest.mark.parametrize("count", [0, 1, 3, 7])
def test_fewer_windows_than_ten(count: int) -> None:
    figure = drawn(worst_plot([window(2.0)] * count))
    assert len([axes for axes in figure.axes if axes.axison and axes.lines]) == count


def test_a_failed_prediction_is_drawn_as_far_as_it_goes() -> None:
    failed = window(np.inf)
    failed.predicted["b"][0][100:] = np.nan
    axes = drawn(worst_plot([failed])).axes[0]
    assert "failed" in axes.get_title()
    assert len(axes.lines[2].get_xdata()) == 101
