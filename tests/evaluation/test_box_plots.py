"""Box plots: what is drawn is what the paper's caption says."""

import numpy as np
import pytest

from offpiste.evaluation.box_plots import MEAN, MEDIAN, grouped_box_plot, whisker_top

RNG = np.random.default_rng(0)
GROUPS = {
    "0": {"b": RNG.gamma(2.0, 1.0, 500), "df": RNG.gamma(2.0, 2.0, 500)},
    "10": {"b": RNG.gamma(3.0, 1.0, 500), "df": RNG.gamma(1.0, 1.0, 500)},
}


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
