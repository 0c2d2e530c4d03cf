"""Box plots: what is drawn is what the paper's caption says."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from offpiste.evaluation.box_plots import MEAN, MEDIAN, box_plot, grouped_box_plot, whisker_top

VALUES = np.array([0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 11.0, 30.0])
"""Quartiles 3, 5, 7; IQR 4; whiskers reach to the last values within -3 ... 13: 0 and 11."""

RNG = np.random.default_rng(0)
GROUPS = {
    "0": {"b": RNG.gamma(2.0, 1.0, 500), "df": RNG.gamma(2.0, 2.0, 500)},
    "10": {"b": RNG.gamma(3.0, 1.0, 500), "df": RNG.gamma(1.0, 1.0, 500)},
}


def drawn(figure: Figure) -> Figure:
    FigureCanvasAgg(figure).draw()
    return figure


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.axes[0].texts]


def test_box_plot_has_quartiles_whiskers_median_and_mean() -> None:
    axes = drawn(box_plot({"b": VALUES})).axes[0]
    box = axes.patches[0].get_path().vertices[:, 1]
    assert (box.min(), box.max()) == (3.0, 7.0)
    lines = {(line.get_color(), tuple(line.get_ydata())) for line in axes.lines if len(line.get_ydata()) == 2}
    assert (MEDIAN, (5.0, 5.0)) in lines
    assert [y for colour, (y, _) in lines if colour == MEAN] == [pytest.approx(VALUES.mean())]
    ends = {y for _, ys in lines for y in ys}
    assert {0.0, 11.0} <= ends
    assert max(ends) == 11.0, "no fliers"


def test_whiskers_are_given_by_values_with_arrows() -> None:
    figure = drawn(box_plot({"b": VALUES, "kinematic": VALUES + 1}))
    assert texts(figure) == ["0.00", "11.00", "1.00", "12.00"]
    assert all(text.arrow_patch is not None for text in figure.axes[0].texts)
    assert [text.xy[1] for text in figure.axes[0].texts] == [0.0, 11.0, 1.0, 12.0]


def test_box_plot_counts_failed_predictions() -> None:
    figure = drawn(box_plot({"b · map": np.append(VALUES, [np.inf, np.inf]), "c": np.full(3, np.inf)}))
    axes = figure.axes[0]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["b\nmap\n2 failed", "c\n3 failed"]
    means = [line.get_ydata()[0] for line in axes.lines if line.get_color() == MEAN and len(line.get_ydata())]
    assert np.isnan(means).all(), "a model that fails has no mean"
    assert np.isnan(axes.patches[1].get_path().vertices[:, 1]).all(), "and, where most fails, no box at all"
    box = axes.patches[0].get_path().vertices[:, 1]
    assert (box.min(), box.max()) == (3.5, 20.5), "failed windows count in the quartiles"


def test_no_label_lies_on_another() -> None:
    figure = box_plot({name: VALUES * scale for name, scale in zip("abcdef", (3, 1, 0.9, 0.3, 0.1, 1), strict=True)})
    renderer = drawn(figure).canvas.get_renderer()
    for group in (figure.axes[0].texts, figure.axes[0].get_xticklabels()):
        boxes = [text.get_window_extent(renderer) for text in group]
        for i, one in enumerate(boxes):
            assert not any(one.overlaps(other) for other in boxes[i + 1 :])


def whisker(values: np.ndarray) -> tuple[float, float]:
    q1, q3 = np.quantile(values, (0.25, 0.75))
    inside = values[(values >= q1 - 1.5 * (q3 - q1)) & (values <= q3 + 1.5 * (q3 - q1))]
    return inside.min(), inside.max()


def test_medians_means_and_whiskers_are_those_of_the_errors_in_order():
    axes = grouped_box_plot(GROUPS, axis="from [m]").axes[0]
    values = [errors for models in GROUPS.values() for errors in models.values()]
    for colour, statistic in ((MEDIAN, np.median), (MEAN, np.mean)):
        drawn = [line.get_ydata()[0] for line in axes.lines if line.get_color() == colour and len(line.get_ydata())]
        np.testing.assert_allclose(drawn, [statistic(v) for v in values])
    shown = [float(text.get_text()) for text in axes.texts]
    np.testing.assert_allclose(shown, [end for v in values for end in whisker(v)], atol=0.005)
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["0", "10"]


def test_figures_can_share_their_axis():
    top = whisker_top(GROUPS)
    assert top == pytest.approx(max(whisker(v)[1] for models in GROUPS.values() for v in models.values()))
    one = {"0": {"b": GROUPS["0"]["b"]}}
    assert grouped_box_plot(one, top=top).axes[0].get_ylim() == grouped_box_plot(GROUPS, top=top).axes[0].get_ylim()


def test_a_model_that_fails_is_said_to():
    axes = grouped_box_plot({"0": {"b": np.array([1.0, 2.0, 3.0]), "cf": np.full(3, np.inf)}}).axes[0]
    assert "failed" in [text.get_text() for text in axes.texts]
