"""The report's box plot: what is drawn is what its caption says, at any number of models."""

import numpy as np
import plotly.graph_objects as go
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from offpiste.evaluation.box_plots import MEAN, MEDIAN, box_chart
from offpiste.report.chart import Chart, draw
from offpiste.report.plotly_charts import LINE_PIXELS, charts_of

VALUES = np.array([0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 11.0, 30.0])
"""Quartiles 3, 5, 7; IQR 4; whiskers reach to the last values within -3 ... 13: 0 and 11."""

FAILING = {"b · map": np.append(VALUES, [np.inf, np.inf]), "c": np.full(3, np.inf)}


def drawn(chart: Chart) -> Figure:
    figure = draw(chart)
    FigureCanvasAgg(figure).draw()
    return figure


def plotly(chart: Chart) -> go.Figure:
    (one,) = charts_of(chart)
    return go.Figure({"data": one["traces"], "layout": one["layout"]})


def test_picture_has_quartiles_whiskers_median_and_mean() -> None:
    axes = drawn(box_chart({"b": VALUES})).axes[0]
    box = axes.patches[0].get_path().vertices[:, 0]
    assert (box.min(), box.max()) == (3.0, 7.0)
    lines = {(line.get_color(), tuple(line.get_xdata())) for line in axes.lines if len(line.get_xdata()) == 2}
    assert (MEDIAN, (5.0, 5.0)) in lines
    assert [x for colour, (x, _) in lines if colour == MEAN] == [pytest.approx(VALUES.mean())]
    ends = {x for _, xs in lines for x in xs}
    assert (min(ends), max(ends)) == (0.0, 11.0), "no fliers"
    assert [text.get_text() for text in axes.texts] == ["median", "5.00", "mean", f"{VALUES.mean():.2f}"]


def test_chart_has_the_same_numbers() -> None:
    figure = plotly(box_chart({"b": VALUES}))
    box, means = figure.data
    assert (box.q1, box.median, box.q3, box.lowerfence, box.upperfence) == ((3,), (5,), (7,), (0,), (11,))
    assert means.x == (pytest.approx(VALUES.mean(), abs=1e-3),)
    assert means.hovertext == (
        f"median 5.00, mean {VALUES.mean():.2f}<br>quartiles 3.00 and 7.00<br>whiskers 0.00 and 11.00",
    )
    assert figure.layout.yaxis.ticktext == ("b",)


def test_failed_predictions_are_counted() -> None:
    chart = box_chart(FAILING)
    axes = drawn(chart).axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["b\nmap\n2 failed", "c\n3 failed"]
    means = [line.get_xdata()[0] for line in axes.lines if line.get_color() == MEAN and len(line.get_xdata())]
    assert np.isnan(means).all(), "a model that fails has no mean"
    box = axes.patches[0].get_path().vertices[:, 0]
    assert (box.min(), box.max()) == (3.5, 20.5), "failed windows count in the quartiles"
    assert np.isnan(axes.patches[1].get_path().vertices[:, 0]).all(), "and, where most fails, there is no box"
    figure = plotly(chart)
    assert [trace.type for trace in figure.data] == ["box", "scatter"], "one box, and its mean"
    assert [text.text for text in figure.layout.annotations] == ["median", "6.00", "–", "mean", "–", "–"]


@pytest.mark.parametrize("count", [1, 6, 18, 60])
def test_every_box_has_room_at_any_number(count: int) -> None:
    chart = box_chart({f"model-{i} · recorded -20 m": VALUES * (1 + i % 3) for i in range(count)})
    figure = drawn(chart)
    axes = figure.axes[0]
    assert axes.get_window_extent().height / count > 40, "dots at 150 dots an inch"
    assert charts_of(chart)[0]["height"] >= LINE_PIXELS * count
    renderer = figure.canvas.get_renderer()
    for group in (axes.get_yticklabels(), axes.texts):
        boxes = [text.get_window_extent(renderer) for text in group]
        for i, one in enumerate(boxes):
            assert not any(one.overlaps(other) for other in boxes[i + 1 :])
