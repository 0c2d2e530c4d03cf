"""Figures drawn from one description: by Matplotlib, and by Plotly, whose charts are valid and end no script."""

import base64
import json

import cv2
import numpy as np
import plotly.graph_objects as go
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from offpiste.report.chart import Chart, Line, Panel, Raster, by_end, draw
from offpiste.report.plotly_charts import MOST_POINTS, charts_json, charts_of

X = np.linspace(1, 5, 5)


def valid(chart: Chart) -> go.Figure:
    """The first panel as Plotly's package knows it, which raises for a name or value that is not Plotly's."""
    first = charts_of(chart)[0]
    return go.Figure({"data": first["traces"], "layout": first["layout"]})


def one(x: np.ndarray, y: np.ndarray) -> Chart:
    return Chart([Panel("", lines=[Line("b", x, y, "#0072b2")])])


def test_text_of_a_chart_ends_no_script_and_keeps_its_meaning() -> None:
    text = charts_json(Chart([Panel("</script><b> & 'x'", "", [Line("<b>", X, X * np.inf, "#0072b2")], title="<t>")]))
    assert not {"<", ">", "&"} & set(text)
    (again,) = json.loads(text)
    assert again["layout"]["xaxis"]["title"]["text"] == "&lt;/script&gt;&lt;b&gt; &amp; 'x'"
    assert again["traces"][0]["name"] == "&lt;b&gt;", "Plotly takes < for markup"
    assert (again["traces"][0]["y"], again["title"]) == ([None] * 5, "<t>")


def lines() -> Chart:
    failing = np.array([1.0, 2.0, np.inf, np.inf, np.inf])
    shown = [
        Line("<low>", X, X, "#0072b2", marker="o", low=X - 1, high=X + 1),
        Line("high", X, 2 * X, "#d55e00", "--", marker="o"),
        Line("f", X, failing, "#000000", marker="o"),
    ]
    return Chart([Panel("Horizon [s]", "Error [m]", by_end(shown))])


def test_lines_are_drawn_alike_as_picture_and_as_chart() -> None:
    figure, drawn = draw(lines()), valid(lines())
    FigureCanvasAgg(figure).draw()
    named = {trace.name: trace for trace in drawn.data if trace.showlegend is None}
    assert list(named) == ["high", "&lt;low&gt;", "f"], "in the order of their ends"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["high", "<low>", "f"]
    assert named["high"].y == (2, 4, 6, 8, 10)
    assert named["high"].line.dash == "dash"
    assert named["f"].line.color == "var(--op-ink)", "readable on a dark page"
    (band,) = (trace for trace in drawn.data if trace.fill)
    assert (min(band.y), max(band.y)) == (0, 6)
    assert band.fillcolor == "rgba(0,114,178,0.15)"
    assert drawn.layout.xaxis.title.text == figure.axes[0].get_xlabel() == "Horizon [s]"
    assert drawn.layout.yaxis.range == (0, pytest.approx(10.5))


def test_lines_of_one_name_share_an_entry_of_the_legend() -> None:
    shown = Chart([Panel("", lines=[Line(name, X, X, "#0072b2") for name in ("drive", "drive", "all", "drive", "")])])
    assert [trace.name for trace in valid(shown).data if trace.showlegend is None] == ["drive", "all"]
    assert [text.get_text() for text in draw(shown).legends[0].get_texts()] == ["drive", "all"]


def test_long_lines_are_thinned_between_their_ends_and_failures_leave_an_axis() -> None:
    x = np.linspace(0, 1, 5000)
    (trace,) = valid(one(x, x**2)).data
    assert len(trace.x) == MOST_POINTS
    assert (trace.x[0], trace.x[-1]) == (0, 1)
    failed = one(X, np.full(5, np.inf))
    FigureCanvasAgg(draw(failed)).draw()
    assert valid(failed).layout.yaxis.range[1] > 0


def test_an_image_below_the_lines_keeps_its_colours_and_what_is_transparent() -> None:
    rgba = np.zeros((40, 40, 4), np.uint8)
    rgba[:, :20] = (250, 20, 20, 255)
    (image,) = charts_of(Chart([Panel("", raster=Raster(rgba, (0.0, 4.0, -2.0, 2.0)))]))[0]["layout"]["images"]
    kind, _, data = image["source"].partition(",")
    again = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED)
    assert kind == "data:image/webp;base64"
    assert again[20, 5, 2] > 200, "red, which OpenCV has last"
    assert (again[20, 5, 3], again[20, 35, 3]) == (255, 0)
    assert (image["x"], image["y"], image["sizex"], image["sizey"]) == (0.0, 2.0, 4.0, 4.0)
