"""Figures of the distance error and of windows: numbers, colours, ground."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from feature_datasets import dataset_with_features, with_snapshots
from offpiste.dataset.store import Dataset
from offpiste.evaluation.box_plots import MEAN, MEDIAN, box_chart, grouped_box_plot, styles, whisker_top
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.intervals import Sampling
from offpiste.evaluation.metrics import Case, ResultRow, RunErrors, result_rows
from offpiste.evaluation.report_figures.distance_error import binned_plot, distribution_plot, growth_plot
from offpiste.evaluation.report_figures.windows import GREY, PIXELS, ground_pictures, typical_windows, worst_windows
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.report.chart import Chart, draw
from offpiste.report.plotly_charts import charts_of

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


def test_boxes_have_quartiles_whiskers_median_and_mean_in_both_drawings() -> None:
    axes = drawn(box_chart({"b": VALUES})).axes[0]
    box = axes.patches[0].get_path().vertices[:, 0]
    assert (box.min(), box.max()) == (3.0, 7.0)
    lines = {(line.get_color(), tuple(line.get_xdata())) for line in axes.lines if len(line.get_xdata()) == 2}
    assert (MEDIAN, (5.0, 5.0)) in lines
    assert [x for colour, (x, _) in lines if colour == MEAN] == [pytest.approx(VALUES.mean())]
    ends = {x for _, xs in lines for x in xs}
    assert (min(ends), max(ends)) == (0.0, 11.0), "no fliers"
    box, means = plotly(box_chart({"b": VALUES})).data
    assert (box.q1, box.median, box.q3, box.lowerfence, box.upperfence) == ((3,), (5,), (7,), (0,), (11,))
    assert means.x == (pytest.approx(VALUES.mean(), abs=1e-3),)
    numbers = f"median 5.00, mean {VALUES.mean():.2f}"
    assert means.hovertext == (f"{numbers}<br>quartiles 3.00 and 7.00<br>whiskers 0.00 and 11.00",)


def test_failed_predictions_are_counted() -> None:
    chart = box_chart(FAILING)
    axes = drawn(chart).axes[0]
    labels = [text.get_text() for text in axes.get_yticklabels()]
    assert labels == ["b · map\nmedian 6.00, mean –, 2 failed", "c\nmedian –, mean –, 3 failed"]
    means = [line.get_xdata()[0] for line in axes.lines if line.get_color() == MEAN and len(line.get_xdata())]
    assert np.isnan(means).all(), "a model that fails has no mean"
    box = axes.patches[0].get_path().vertices[:, 0]
    assert (box.min(), box.max()) == (3.5, 20.5), "failed windows count in the quartiles"
    figure = plotly(chart)
    assert [trace.type for trace in figure.data] == ["box", "scatter"], "one box, and its mean"
    assert [text.replace("<br>", "\n") for text in figure.layout.yaxis.ticktext] == labels


def test_grouped_boxes_state_their_whiskers_and_share_an_axis() -> None:
    groups = {"0": {"b": VALUES, "df": 2 * VALUES}, "10": {"b": VALUES + 1, "df": np.full(3, np.inf)}}
    axes = grouped_box_plot(groups).axes[0]
    medians = [line.get_ydata()[0] for line in axes.lines if line.get_color() == MEDIAN and len(line.get_ydata())]
    np.testing.assert_allclose(medians, [5, 10, 6, np.nan])
    shown = [text.get_text() for text in axes.texts]
    assert shown == ["0.00", "11.00", "0.00", "22.00", "1.00", "12.00", "failed"]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["0", "10"]
    assert whisker_top(groups) == 22.0
    other = grouped_box_plot({"0": {"b": VALUES}}, top=22.0).axes[0]
    assert other.get_ylim() == axes.get_ylim()


def test_bins_hold_equal_numbers_of_windows() -> None:
    speed = np.arange(12.0)
    (line,) = binned_plot({"b": 2 * speed}, speed, axis="Initial speed [m/s]").panels[0].lines
    assert line.x.tolist() == [0.5, 2.5, 4.5, 6.5, 8.5, 10.5]
    assert line.y.tolist() == [1.0, 5.0, 9.0, 13.0, 17.0, 21.0]
    assert drawn(binned_plot({"b": VALUES}, np.full(len(VALUES), 3.0), axis="one speed")).axes[0].lines


def test_the_distribution_of_a_failing_model_never_reaches_the_top() -> None:
    (line,) = distribution_plot({"b": np.array([1.0, 2.0, np.inf, np.inf])}).panels[0].lines
    assert line.y[np.isfinite(line.x)].max() == 50.0


def growing(by: float) -> list[ResultRow]:
    """Errors that grow by so much a second, in blocks that differ."""
    values = by * np.arange(1.0, 6.0)[None, :, None] * np.ones((60, 5, 5)) + np.repeat([-0.1, 0.1], 30)[:, None, None]
    errors = Errors(np.repeat(np.arange(6), 10), np.tile(np.arange(10) * 600 + 20, 6), values, np.ones(60))
    return result_rows({Case("b", "", "causal", None): [RunErrors(None, None, errors)]}, "test", Sampling())


def test_growth_has_a_line_and_a_band_for_each_model() -> None:
    axes = drawn(growth_plot({"b": growing(1.0), "kinematic": growing(2.0), "failed": growing(np.inf)})).axes[0]
    np.testing.assert_allclose(axes.lines[1].get_ydata(), [1, 2, 3, 4, 5])
    band = axes.collections[1].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == pytest.approx((0.9, 5.1))
    assert [text.get_text() for text in axes.figure.legends[0].get_texts()] == ["kinematic", "b", "failed"]


def test_models_keep_their_colours_and_variants_have_line_styles() -> None:
    alone, together = styles(["b"]), styles(["kinematic", "blind", "blind (flat)", "mine"])
    assert alone["b"] == together["blind"]
    assert together["blind"][0] == together["blind (flat)"][0] != together["kinematic"][0]
    assert together["blind"][1] != together["blind (flat)"][1]
    assert styles(["visual · recorded 20 m"]) != styles(["blind · map"])


def test_windows_are_typical_by_rank_also_on_a_short_part() -> None:
    """Twelve seconds: at most three windows that do not overlap, and errors that grow along them."""
    distance = np.linspace(0.5, 6.5, 61)
    values = np.broadcast_to(distance[:, None, None], (61, 5, 5))
    errors = Errors(np.zeros(61, np.int64), np.arange(61) * 10 + 20, values, distance)
    chosen, shares = typical_windows(errors, (0.25, 0.5, 0.75), each=2)
    np.testing.assert_allclose((chosen.distance() - 0.5) / 6, shares, atol=0.11)
    assert 0.5 in shares
    some = np.where(np.arange(61) % 2, np.inf, distance)
    some = replace(errors, values=np.broadcast_to(some[:, None, None], values.shape))
    assert np.isfinite(typical_windows(some, (0.25, 0.45), each=2)[0].distance()).all()
    failed = replace(errors, values=np.full(values.shape, np.inf))
    assert len(typical_windows(failed, (0.5,), each=2)[0].row) == 0
    worst = worst_windows(errors, count=10).distance()
    assert worst.max() == 6.5
    assert worst.min() >= np.quantile(distance, 0.75)
    assert len(worst_windows(errors, count=1).row) == 1


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("data") / "small.zarr", ("train", "test"), rows=600)


def picture(dataset: Dataset, row: int, yaw: float = 0.0, ahead: float = 8.0) -> np.ndarray | None:
    (found,) = ground_pictures(
        dataset, np.array([1]), np.array([row]), np.array([[0.0, 0.0, yaw]]), [((ahead, 0.0), 10.0)]
    )
    return found


def quadrants(dataset: Dataset) -> Dataset:
    """Features that grow towards +x (first) and +y (second); without them where y > 5; nothing where x > 15."""
    drive = dataset.drives[1]
    x, y = np.meshgrid(np.arange(-30, 31.0), np.arange(-30, 31.0))
    features = np.stack((x, y, np.zeros_like(x)), axis=-1)
    features[(y > 5) | (x > 15)] = np.nan
    terrain = TerrainMap(drive.rows.origin - 30.0, 1.0, np.where(x > 15, np.nan, 0.0), features)
    return replace(dataset, drives=(dataset.drives[0], replace(drive, load_map=lambda: terrain)))


def test_ground_ahead_is_up_and_ground_to_the_left_is_left(dataset: Dataset) -> None:
    rgba, middle = picture(quadrants(dataset), 100).astype(int), PIXELS // 2
    assert rgba[0, middle, 3] == 0, "18 m ahead, x > 15, nothing is known"
    assert rgba[middle, 0].tolist() == [GREY, GREY, GREY, 255], "10 m to the left, y > 5, there are no features"
    assert rgba[middle, -1, 3] == 255
    assert rgba[-10, middle, 0] < rgba[40, middle, 0], "the first feature grows ahead"
    assert rgba[middle, -10, 1] < rgba[middle, middle, 1], "the second grows to the left"
    straight, turned = (picture(quadrants(dataset), 100, yaw, 0.0) for yaw in (0.0, np.pi / 2))
    same = np.rot90(straight, -1) == turned
    assert same.all(axis=-1).mean() > 0.95, "the ground to the left lies ahead, but for pixels on the edges of cells"


def test_a_snapshot_replaces_the_map_of_the_drive(dataset: Dataset, tmp_path: Path) -> None:
    snapped = with_snapshots(dataset, tmp_path, [100])
    assert not np.array_equal(picture(snapped, 100), picture(dataset, 100))
    np.testing.assert_array_equal(picture(snapped, 101), picture(dataset, 101))
    assert picture(replace(dataset, features=()), 100) is None
    drives = tuple(replace(drive, load_map=None) for drive in dataset.drives)
    assert picture(replace(dataset, drives=drives), 100) is None
