"""Charts of pages: what Plotly is given is valid, small and cannot end the script that holds it."""

import base64
import gzip
import json

import numpy as np
import plotly.graph_objects as go
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from offpiste.report.chart import Chart, charts_json, escaped, layout, plotly_base64, translucent
from offpiste.report.line_chart import MOST_POINTS, Line, LineChart

X = np.linspace(1, 5, 5)


def valid(chart: Chart) -> go.Figure:
    """The chart as Plotly's package knows it, which raises for a name or value that is not Plotly's."""
    return go.Figure({"data": list(chart.traces), "layout": dict(chart.layout)})


def test_text_of_a_chart_ends_no_script_and_keeps_its_meaning() -> None:
    chart = Chart(100, [{"name": "</script><b> & 'x'", "y": [1.0, np.nan, np.inf]}], title="<t>")
    text = charts_json([chart])
    assert not {"<", ">", "&"} & set(text)
    (again,) = json.loads(text)
    assert again["traces"] == [{"name": "</script><b> & 'x'", "y": [1.0, None, None]}]
    assert (again["height"], again["title"]) == (100, "<t>")


def test_plotly_is_whole_and_compressed() -> None:
    script = gzip.decompress(base64.b64decode(plotly_base64())).decode()
    assert "Plotly" in script
    assert "MIT license" in script[:400]
    assert len(plotly_base64()) < 0.5 * len(script)


def test_colours_and_markup() -> None:
    assert translucent("#0a1420", 0.25) == "rgba(10,20,32,0.25)"
    assert escaped('<a href="x">') == '&lt;a href="x"&gt;'


def test_layout_has_the_look_and_the_settings() -> None:
    look = layout(x={"range": (0, 1)}, y={}, hovermode="y")
    assert (look["xaxis"]["range"], look["hovermode"]) == ((0, 1), "y")
    assert look["font"]["color"] == "var(--op-ink)"


def lines(**settings) -> LineChart:
    band = {"low": X - 1, "high": X + 1}
    failing = np.array([1.0, 2.0, np.inf, np.inf, np.inf])
    shown = [
        Line("<low>", X, X, "#0072b2", **band),
        Line("high", X, 2 * X, "#d55e00", "--"),
        Line("f", X, failing, "#000000"),
    ]
    return LineChart(shown, "Horizon [s]", "Error [m]", **settings)


def test_lines_are_drawn_alike_as_picture_and_as_chart() -> None:
    figure, (chart,) = lines().figure(), lines().charts()
    FigureCanvasAgg(figure).draw()
    drawn = valid(chart)
    named = {trace.name: trace for trace in drawn.data if trace.showlegend is None}
    assert list(named) == ["high", "&lt;low&gt;", "f"], "as the eye meets their ends"
    assert named["high"].y == (2, 4, 6, 8, 10)
    assert named["high"].line.dash == "dash"
    (band,) = (trace for trace in drawn.data if trace.fill)
    assert (min(band.y), max(band.y)) == (0, 6)
    assert drawn.layout.xaxis.title.text == figure.axes[0].get_xlabel() == "Horizon [s]"
    assert drawn.layout.yaxis.range == (0, pytest.approx(10.5))


def test_long_lines_are_thinned_between_their_ends() -> None:
    x = np.linspace(0, 1, 5000)
    (trace,) = LineChart([Line("b", x, x**2, "#0072b2")], "", "", markers=False).charts()[0].traces
    assert len(trace["x"]) == MOST_POINTS
    assert (trace["x"][0], trace["x"][-1]) == (0, 1)


def test_lines_of_nothing_but_failures() -> None:
    chart = LineChart([Line("b", X, np.full(5, np.inf), "#0072b2")], "", "")
    FigureCanvasAgg(chart.figure()).draw()
    assert valid(chart.charts()[0]).layout.yaxis.range[1] > 0
