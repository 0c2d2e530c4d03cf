import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from offpiste.evaluation.box_plots import box_chart, styles
from offpiste.evaluation.intervals import Levels, Statistics
from offpiste.evaluation.metrics import ResultRow
from offpiste.evaluation.report_figures.distance_error import binned_plot, distribution_plot, growth_plot
from offpiste.report.chart import Chart, draw

VALUES = np.array([0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 11.0, 30.0])
SPEED = "Speed at the start [m/s]"


def drawn(chart: Chart) -> Axes:
    figure = draw(chart)
    FigureCanvasAgg(figure).draw()
    return figure.axes[0]


def test_axes_have_names_and_units() -> None:
    errors = {"b": VALUES, "kinematic": VALUES}
    by_speed = binned_plot(errors, np.linspace(2, 9, len(VALUES)), axis=SPEED)
    shown = [drawn(chart) for chart in (box_chart(errors), distribution_plot(errors), by_speed)]
    names = [(axes.get_xlabel(), axes.get_ylabel()) for axes in shown]
    assert all("[m]" in x for x, _ in names[:2])
    assert "[m/s]" in names[2][0]
    assert all("[" in y for _, y in names[1:])


def test_binned_plot_has_bins_of_equal_size_worked_by_hand() -> None:
    speed = np.arange(12.0)
    (line,) = binned_plot({"b": 2 * speed}, speed, axis=SPEED).panels[0].lines
    assert line.x.tolist() == [0.5, 2.5, 4.5, 6.5, 8.5, 10.5]
    assert line.y.tolist() == [1.0, 5.0, 9.0, 13.0, 17.0, 21.0]


def test_binned_plot_of_one_speed() -> None:
    assert drawn(binned_plot({"b": VALUES}, np.full(len(VALUES), 3.0), axis=SPEED)).lines


def test_distribution_of_a_failing_model_never_reaches_the_top() -> None:
    (line,) = distribution_plot({"b": np.array([1.0, 2.0, np.inf, np.inf])}).panels[0].lines
    assert line.y[np.isfinite(line.x)].max() == 50.0


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
    axes = drawn(growth_plot({"b": rows, "kinematic": worse}))
    assert axes.lines[1].get_ydata().tolist() == [1, 2, 3, 4, 5]
    band = axes.collections[1].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (0.5, 5.5)
    assert [text.get_text() for text in axes.figure.legends[0].get_texts()] == ["kinematic", "b"], "from top to bottom"


def test_growth_of_a_failed_model_draws_what_is_finite() -> None:
    chart = growth_plot({"b": [row(1.0, 1.0), row(2.0, np.inf)], "c": [row(1.0, np.nan), row(2.0, np.nan)]})
    assert len(drawn(chart).lines) == 2


def test_models_keep_their_colours_and_variants_differ() -> None:
    alone, together = styles(["b"]), styles(["kinematic", "b", "b (flat)", "mine"])
    assert alone["b"] == together["b"]
    assert together["b"][0] == together["b (flat)"][0]
    assert together["b"][1] != together["b (flat)"][1]
    assert len({colour for colour, _ in (together["kinematic"], together["b"])}) == 2
