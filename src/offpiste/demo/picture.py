"""The demo's picture: the course, what the camera saw, what the map knew, and predictions beside what happened."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.core.conventions import DT
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.demo.comparison import WHAT, Predictions
from offpiste.evaluation.errors import in_start_frame
from offpiste.logs.drive import Drive
from offpiste.logs.measurements import Image
from offpiste.logs.opening import open_log
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.report.feature_colours import colour_limits, colours
from offpiste.simulation.top_view import draw_top_view
from offpiste.simulation.world.world import World

COLOURS: Final = {"b": "#0072b2", "dc": "#d55e00"}
MOMENTS: Final = 3
"""Number of predictions that are drawn, evenly spread over the drive."""
MARGIN: Final = 12.0
"""Around the driven paths [m]."""
AHEAD, REACH, LATER = 14.0, 13.0, 8
"""The map is shown around the place so far ahead [m], to each side [m], and again so many snapshots later."""

_UNKNOWN: Final = 235


def demo_picture(
    world: World,
    dataset: Dataset,
    predictions: Predictions,
    log: Path,
    courses: Mapping[str, Drive],
    title: str,
) -> Figure:
    """One page that shows what the demo did.

    Args:
        dataset, log: of the drive that is predicted.
        courses: the same course driven with each model.
    """
    figure = Figure(figsize=(14, 9.2), dpi=110, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=12)
    grid = figure.add_gridspec(3, 4, height_ratios=(1.0, 1.0, 1.25))
    (drive,) = dataset.drives
    number = _shown(drive)
    _camera(figure.add_subplot(grid[0, :2]), dataset, log, _time(drive, number))
    _ground(figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1]), drive, number)
    _courses(figure.add_subplot(grid[:2, 2:]), world, courses)
    chosen = np.linspace(0, len(predictions.row) - 1, MOMENTS + 2).round().astype(int)[1:-1]
    for column, moment in enumerate(chosen):
        _prediction(figure.add_subplot(grid[2, column]), drive, predictions, int(moment))
    _errors(figure.add_subplot(grid[2, 3]), predictions)
    return figure


def _courses(axes: Axes, world: World, courses: Mapping[str, Drive]) -> None:
    draw_top_view(world, axes)
    paths = {model: drive.channels["position"].values[:, :2] for model, drive in courses.items()}
    for (model, path), width in zip(paths.items(), (5.0, 2.0), strict=True):
        axes.plot(*path.T, color=COLOURS[model], linewidth=width, label=f"driven with {WHAT[model]}")
        axes.plot(*path[-1], marker="o", color=COLOURS[model], markeredgecolor="white", markersize=2 + 2 * width)
    axes.plot(*paths["dc"][0], marker="o", color="white", markeredgecolor="black", linestyle="", label="start")
    every = np.concatenate(list(paths.values()))
    (left, bottom), (right, top) = every.min(axis=0) - MARGIN, every.max(axis=0) + MARGIN
    axes.set_xlim(left, right, auto=True)  # not fixed:
    axes.set_ylim(bottom, top, auto=True)
    axes.set_aspect("equal", adjustable="datalim")  # more of the world instead of white beside it
    axes.set_title("The same course, driven with both", fontsize=10, loc="left")
    axes.legend(loc="best", fontsize=8)


def _shown(drive: StoredDrive) -> int:
    """Number of the snapshot that is shown: the middle one, with as many after it as are looked ahead, if there are."""
    assert drive.snapshots is not None
    count = len(drive.snapshots.row)
    return max(0, min(count // 2, count - 1 - LATER))


def _time(drive: StoredDrive, number: int) -> float:
    assert drive.snapshots is not None
    return float(np.asarray(drive.rows.time)[drive.snapshots.row[number]])


def _camera(axes: Axes, dataset: Dataset, log: Path, time: float) -> None:
    sensors = open_sensors(open_log(log, clock=dataset.rig.clock), dataset.rig)
    images = [m for m in sensors.stream(sensors.cameras, start=time - 1.0, end=time) if isinstance(m, Image)]
    if images:
        axes.imshow(images[-1].pixels)
    axes.set_title("What the camera saw", fontsize=10, loc="left")
    axes.set_axis_off()


def _ground(far: Axes, near: Axes, drive: StoredDrive, number: int) -> None:
    """The same ground on the map, seen from afar and later from nearby: features in colours, with the driven path."""
    assert drive.snapshots is not None
    later = min(number + LATER, len(drive.snapshots.row) - 1)
    state = np.asarray(drive.rows.state)
    path = drive.rows.origin + state[:, :2]
    row = drive.snapshots.row[number]
    centre = path[row] + AHEAD * np.array([np.cos(state[row, 2]), np.sin(state[row, 2])])
    maps = [drive.snapshots.load(n).cropped(centre - REACH, centre + REACH) for n in (number, later)]
    limits = colour_limits(maps[-1].features)
    for axes, shown, until in ((far, maps[0], row), (near, maps[1], drive.snapshots.row[later])):
        _features(axes, shown, limits)
        axes.set_facecolor((_UNKNOWN / 255,) * 3)
        axes.plot(*path[: until + 1].T, color="black", linewidth=1.5)
        axes.plot(*path[until], marker="^", color="white", markeredgecolor="black", markersize=7)
        axes.set(
            xlim=centre[0] + np.array([-REACH, REACH]), ylim=centre[1] + np.array([-REACH, REACH]), xticks=[], yticks=[]
        )
    seconds = DT * float(drive.snapshots.row[later] - row)
    far.set_title("The ground ahead, as the map knew it …", fontsize=10, loc="left")
    near.set_title(f"… and {seconds:.0f} s later, from nearby", fontsize=10, loc="left")


def _features(axes: Axes, shown: TerrainMap, limits: Float[np.ndarray, "2 3"]) -> None:
    picture = colours(shown.features.astype(np.float32), limits)
    picture[~np.isfinite(shown.features).all(axis=-1)] = _UNKNOWN
    ny, nx = shown.elevation.shape
    (x, y), half = shown.origin, shown.resolution / 2
    extent = (x - half, x + nx * shown.resolution - half, y - half, y + ny * shown.resolution - half)
    axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest")


def _prediction(axes: Axes, drive: StoredDrive, predictions: Predictions, moment: int) -> None:
    """One moment: where both models saw the vehicle go in 5 s, and where it went."""
    row = int(predictions.row[moment])
    yaw = np.asarray(drive.rows.state)[[row], 2]
    for name, path in (("recorded", predictions.recorded), *predictions.paths.items()):
        ahead, left = in_start_frame(path[[moment]], yaw)[0].T
        colour = COLOURS.get(name, "black")
        axes.plot(-left, ahead, color=colour, linewidth=2, label=name)
        axes.plot(-left[-1], ahead[-1], marker="o", color=colour)
    axes.plot(0, 0, marker="^", color="black")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    axes.set_title(f"5 s ahead [m], predicted {DT * row:.0f} s into the drive", fontsize=10, loc="left")
    axes.legend(fontsize=8, loc="lower right")


def _errors(axes: Axes, predictions: Predictions) -> None:
    """All errors after 5 s, one point a moment."""
    models = list(predictions.paths)
    most = max(float(predictions.errors(model).max()) for model in models)
    axes.axline((0, 0), slope=1, color="black", linewidth=0.8)
    b, dc = (predictions.errors(model) for model in models)
    axes.scatter(b, dc, s=22, color=np.where(dc < b, COLOURS["dc"], COLOURS["b"]), zorder=3)
    limits = (0, 1.05 * most)
    axes.set(xlabel="b off by [m]", ylabel="dc off by [m]", xlim=limits, ylim=limits, aspect="equal")
    axes.set_title(f"dc nearer in {(dc < b).sum()} of {len(b)} (orange)", fontsize=10, loc="left")
    axes.grid(alpha=0.3)
