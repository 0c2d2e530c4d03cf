"""Comparison of both models in the demo: predictions, table, sentences and picture."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.core.conventions import DT
from offpiste.core.errors import DatasetError
from offpiste.core.geometry import planar_body_from_world
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.evaluation.model_card import driving_words, load_card
from offpiste.logs.drive import Drive
from offpiste.logs.log import open_log
from offpiste.logs.measurements import Image
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.report.feature_colours import colour_limits, colours
from offpiste.report.figure import plain
from offpiste.report.text_table import TextTable, interval, number
from offpiste.simulation.top_view import draw_top_view
from offpiste.simulation.world.world import World
from offpiste.training.prediction import in_parts, roll_out
from offpiste.training.run import load_run

NAMES: Final = {"b": "blind", "dc": "visual"}
"""Display names of the models."""
COLOURS: Final = {"b": "#0072b2", "dc": "#d55e00"}
MOMENTS: Final = 3
"""Number of drawn predictions."""
MARGIN: Final = 12.0
"""Margin around the driven paths [m]."""
AHEAD, REACH, LATER = 14.0, 13.0, 8
"""Distance ahead [m] and half size [m] of the shown map, and number of snapshots until it is shown again."""
UNKNOWN: Final = 235
"""Grey of unknown ground."""


@dataclass(frozen=True)
class Predictions:
    """Predictions of models from the same times on the map of that time."""

    row: Int[np.ndarray, " n"]  # row of the drive at each time
    recorded: Float[np.ndarray, "n T 2"]  # path in the next 5 s relative to the start, in world axes [m]
    paths: Mapping[str, Float[np.ndarray, "n T 2"]]  # predicted paths by model [m]
    folders: Mapping[str, Path]  # of the models

    def errors(self, model: str) -> Float[np.ndarray, " n"]:
        """Return the distance errors after 5 s [m]."""
        return np.asarray(np.linalg.norm(self.paths[model][:, -1] - self.recorded[:, -1], axis=1))


@torch.no_grad()
def predict(dataset: Dataset, folders: Mapping[str, Path]) -> Predictions:
    """Predict with shipped models from all times with a stored map.

    Raises:
        DatasetError: the drive is too short.
    """
    try:
        windows = Windows(dataset, "test", start="causal")
        index = windows.evaluation_indices(1)
    except DatasetError as error:
        how = "choose another world with --seed"
        raise DatasetError("the drive is too short to predict 5 s", where=dataset.path, how=how) from error
    recorded: list[np.ndarray] = []
    paths: dict[str, np.ndarray] = {}
    for model, folder in folders.items():
        dynamics = load_run(folder).dynamics
        pieces = [roll_out(dynamics, windows, part, "map")[:2] for part in in_parts(index, windows, "map")]
        recorded = [batch.target[..., :2].numpy() for batch, _ in pieces]
        paths[model] = np.concatenate([trajectory.state[..., :2].numpy() for _, trajectory in pieces])
    return Predictions(windows.row_in_drive(index), np.concatenate(recorded), paths, folders)


def comparison_table(predictions: Predictions, results: Mapping[str, Mapping[str, Any]], speed: float) -> TextTable:
    """Return prediction errors of both models and their results on the course with a target speed [m/s]."""
    models = tuple(results)
    measures = {
        "time for the course [s]": ("time_s", 1),
        "path error, mean [m]": ("mean_path_error_m", 2),
        "path error, worst [m]": ("worst_path_error_m", 2),
        f"speed error from {speed:g} m/s, mean [m/s]": ("mean_speed_error_mps", 2),
    }
    errors = (number(float(predictions.errors(model).mean())) for model in models)
    rows = [("error of the predicted position after 5 s [m]", *errors)]
    for text, (key, digits) in measures.items():
        rows.append((text, *(number(float(results[m][key]), digits) for m in models)))
    rows.append(("end of the drive", *(ending(results[m]) for m in models)))
    return TextTable("This drive", ("", *(NAMES[model] for model in models)), tuple(rows))


def closing_words(predictions: Predictions) -> Iterator[str]:
    """Yield sentences on the gain here and in general."""
    blind, visual = (predictions.errors(model) for model in ("b", "dc"))
    gain = 1 - visual.mean() / blind.mean()
    side = "closer to" if gain >= 0 else "farther from"
    yield (
        f"Here, predictions of the visual model end {abs(100 * gain):.0f} % {side} the vehicle's true position: error"
        f" after 5 s {visual.mean():.2f} m instead of {blind.mean():.2f} m; it is closer in"
        f" {int((visual < blind).sum())} of {len(blind)} predictions."
    )
    card = load_card(predictions.folders["dc"])
    figures = card.over_seeds
    if figures.against_b is not None:
        low, high = (-100 * bound for bound in reversed(figures.against_b.ci95))
        yield (
            f"Typically {-100 * figures.against_b.mean:.0f} % {interval((low, high), 0)} closer (95 % interval):"
            f" {figures.windows} windows in {figures.levels.drives} worlds unseen in training,"
            f" {figures.levels.seeds} training{'s' * (figures.levels.seeds > 1)} each. A single drive may differ."
        )
    if card.driving is not None:
        yield f"Driving with the visual model: {driving_words(card.driving).replace('`b`', 'the blind model')}"


def ending(result: Mapping[str, Any]) -> str:
    """Describe the end of a drive along the course."""
    for key, text in (("rollover", "rolled over"), ("collision", "collided"), ("stuck", "stuck")):
        if result[key]:
            return text
    return (
        "reached the end" if result["finished"] else f"after {result['progress_m']:.0f} of {result['course_m']:.0f} m"
    )


def demo_picture(
    world: World, dataset: Dataset, predictions: Predictions, log: Path, courses: Mapping[str, Drive], title: str
) -> Figure:
    """Draw a page on the predicted drive (dataset and log) and the drives of the course by model."""
    figure = Figure(figsize=(14, 9.2), dpi=110, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=12)
    grid = figure.add_gridspec(3, 4, height_ratios=(1.0, 1.0, 1.25))
    (drive,) = dataset.drives
    assert drive.snapshots is not None
    count = len(drive.snapshots.row)
    number = max(0, min(count // 2, count - 1 - LATER))
    time = float(np.asarray(drive.rows.time)[drive.snapshots.row[number]])
    _camera(figure.add_subplot(grid[0, :2]), dataset, log, time)
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
        axes.plot(*path.T, color=COLOURS[model], linewidth=width, label=f"driven with the {NAMES[model]} model")
        axes.plot(*path[-1], marker="o", color=COLOURS[model], markeredgecolor="white", markersize=2 + 2 * width)
    axes.plot(*paths["dc"][0], "o", color="white", markeredgecolor="black", label="start")
    every = np.concatenate(list(paths.values()))
    x, y = np.stack((every.min(axis=0) - MARGIN, every.max(axis=0) + MARGIN), axis=1).tolist()
    axes.set_xlim(*x, auto=True)
    axes.set_ylim(*y, auto=True)
    axes.set_aspect("equal", adjustable="datalim")  # fills the axes with more of the world
    axes.set_title("The same course, driven with both models", fontsize=10, loc="left")
    axes.legend(loc="best", fontsize=8)


def _camera(axes: Axes, dataset: Dataset, log: Path, time: float) -> None:
    sensors = open_sensors(open_log(log, clock=dataset.rig.clock), dataset.rig)
    images = [m for m in sensors.stream(sensors.cameras, start=time - 1.0, end=time) if isinstance(m, Image)]
    if images:
        axes.imshow(images[-1].pixels)
    axes.set_title("Camera image", fontsize=10, loc="left")
    axes.set_axis_off()


def _ground(far: Axes, near: Axes, drive: StoredDrive, number: int) -> None:
    """Draw features of the same ground on the map, from afar and later from nearby, with the driven path."""
    assert drive.snapshots is not None
    later = min(number + LATER, len(drive.snapshots.row) - 1)
    state = np.asarray(drive.rows.state)
    path = drive.rows.origin + state[:, :2]
    row = drive.snapshots.row[number]
    centre = path[row] + AHEAD * np.array([np.cos(state[row, 2]), np.sin(state[row, 2])])
    maps = [drive.snapshots.load(n).cropped(centre - REACH, centre + REACH) for n in (number, later)]
    limits, (xlim, ylim) = colour_limits(maps[-1].features), centre[:, None] + np.array([-REACH, REACH])
    for axes, shown, until in ((far, maps[0], row), (near, maps[1], drive.snapshots.row[later])):
        _features(axes, shown, limits)
        axes.plot(*path[: until + 1].T, color="black", linewidth=1.5)
        axes.plot(*path[until], marker="^", color="white", markeredgecolor="black", markersize=7)
        axes.set(xlim=xlim, ylim=ylim, xticks=[], yticks=[], facecolor=(UNKNOWN / 255,) * 3)
    seconds = DT * float(drive.snapshots.row[later] - row)
    far.set_title("Ground ahead in the map", fontsize=10, loc="left")
    near.set_title(f"{seconds:.0f} s later, from nearby", fontsize=10, loc="left")


def _features(axes: Axes, shown: TerrainMap, limits: Float[np.ndarray, "2 3"]) -> None:
    picture = colours(shown.features.astype(np.float32), limits)
    picture[~np.isfinite(shown.features).all(axis=-1)] = UNKNOWN
    ny, nx = shown.elevation.shape
    (x, y), half = shown.origin, shown.resolution / 2
    extent = (x - half, x + nx * shown.resolution - half, y - half, y + ny * shown.resolution - half)
    axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest")


def _prediction(axes: Axes, drive: StoredDrive, predictions: Predictions, moment: int) -> None:
    """Draw predictions of both models and the recorded path over 5 s from one time."""
    row = int(predictions.row[moment])
    yaw = np.asarray(drive.rows.state)[[row], 2]
    for name, path in (("recorded", predictions.recorded), *predictions.paths.items()):
        ahead, left = planar_body_from_world(path[moment], yaw).T
        colour = COLOURS.get(name, "black")
        axes.plot(-left, ahead, color=colour, linewidth=2, label=NAMES.get(name, name))
        axes.plot(-left[-1], ahead[-1], marker="o", color=colour)
    axes.plot(0, 0, marker="^", color="black")
    axes.set_aspect("equal", adjustable="datalim")
    plain(axes, f"5 s ahead [m], predicted {DT * row:.0f} s into the drive")
    axes.legend(fontsize=8, loc="lower right")


def _errors(axes: Axes, predictions: Predictions) -> None:
    """Draw the errors after 5 s of both models at all times."""
    axes.axline((0, 0), slope=1, color="black", linewidth=0.8)
    blind, visual = (predictions.errors(model) for model in ("b", "dc"))
    axes.scatter(blind, visual, s=22, color=np.where(visual < blind, COLOURS["dc"], COLOURS["b"]), zorder=3)
    limits = (0, 1.05 * float(max(blind.max(), visual.max())))
    axes.set(xlabel="error of blind [m]", ylabel="error of visual [m]", xlim=limits, ylim=limits, aspect="equal")
    plain(axes, f"visual closer in {(visual < blind).sum()} of {len(blind)} (orange)")
