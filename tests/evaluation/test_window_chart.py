"""Panels of windows: paths in the frame of the start, on their ground."""

from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from offpiste.evaluation.ground_pictures import GroundPicture
from offpiste.evaluation.window_chart import window_chart
from offpiste.evaluation.window_paths import WindowPaths
from offpiste.report.chart import draw
from offpiste.report.plotly_charts import charts_of

GROUND = GroundPicture(np.full((8, 8, 4), 200, np.uint8), at_start=True)


def drawn(*windows: WindowPaths) -> Figure:
    figure = draw(window_chart(windows))
    FigureCanvasAgg(figure).draw()
    return figure


def window(error: float, runs: int = 1, **others) -> WindowPaths:
    ahead = np.stack((np.linspace(0.1, 25, 250), np.linspace(0, 2, 250)), axis=1)
    predicted = {"b": tuple(ahead * (0.9 - 0.1 * i) for i in range(runs)), "kinematic": (ahead * 1.1,)}
    return WindowPaths("drive", 12.34, np.radians(-90), 5.0, error, ahead, predicted, **others)


def panels(*windows: WindowPaths) -> list[go.Figure]:
    charts = charts_of(window_chart(windows))
    return [go.Figure({"data": chart["traces"], "layout": chart["layout"]}) for chart in charts]


def test_windows_are_drawn_heading_up_with_left_to_the_left() -> None:
    figure = drawn(window(3.0, runs=2), *[window(2.0)] * 9)
    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == 10
    recorded = shown[0].lines[0]
    assert recorded.get_xdata()[-1] == pytest.approx(-2.0)
    assert recorded.get_ydata()[-1] == pytest.approx(25.0)
    title = shown[0].get_title()
    assert all(part in title for part in ("error 3.00 m", "5.0 m/s", "270°", "12.3 s"))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["recorded", "b", "kinematic"]
    assert "[m]" in shown[0].get_ylabel()


@pytest.mark.parametrize("count", [1, 3, 7])
def test_any_number_of_windows(count: int) -> None:
    figure = drawn(*[window(2.0)] * count)
    assert len([axes for axes in figure.axes if axes.axison and axes.lines]) == count
    assert len(panels(*[window(2.0)] * count)) == count


def test_a_failed_prediction_is_drawn_as_far_as_it_goes() -> None:
    failed = window(np.inf)
    failed.predicted["b"][0][100:] = np.nan
    axes = drawn(failed, failed).axes[0]
    assert "failed" in axes.get_title()
    assert len(axes.lines[1].get_xdata()) == 101
    (panel,) = panels(failed)
    assert next(trace for trace in panel.data if trace.name == "b").hovertext[-1].startswith("b after 2.0 s")


def test_a_panel_shows_time_and_distance_to_the_recorded_place() -> None:
    (panel,) = panels(window(3.0, runs=2, note="median"))
    traces = [trace for trace in panel.data if trace.name]
    assert [trace.name for trace in traces] == ["recorded", "b", "b", "kinematic"]
    assert traces[0].x[-1] == pytest.approx(-2.0)
    assert traces[1].hovertext[-1] == f"b after 5.0 s<br>{0.1 * np.hypot(25, 2):.2f} m from the recorded place"
    assert panel.layout.yaxis.scaleanchor == "x", "a metre ahead is as long as a metre aside"
    assert window_chart([window(3.0, note="median")]).panels[0].title.startswith("median: error 3.00 m")


def test_the_ground_lies_below_the_paths_and_replaces_the_driven_path() -> None:
    driven = np.stack((np.linspace(-10, 10, 50), np.zeros(50)), axis=1)
    bare, on_path = window(1.0), window(1.0, driven=driven, centre=(10.0, 2.0), half=20.0)
    on_ground = replace(on_path, ground=GROUND)
    first, second, third = panels(bare, on_path, on_ground)
    assert len(second.data) == len(first.data) + 1
    assert len(third.data) == len(first.data)
    (image,) = third.layout.images
    assert image.source.startswith("data:image/webp;base64,")
    assert (image.x, image.y, image.sizex, image.sizey) == (-22.0, 30.0, 40.0, 40.0)
    assert third.layout.xaxis.range == (-22.0, 18.0)
    axes = drawn(on_ground).axes[0]
    assert axes.images[0].get_extent() == [-22.0, 18.0, -10.0, 30.0]
