"""Typical and worst windows of a model: recorded and predicted paths on the ground known at the start."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from offpiste.core.conventions import DT, HISTORY_STEPS, HORIZON_STEPS
from offpiste.core.geometry import planar_body_from_world
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.evaluation.box_plots import RECORDED, colour_of
from offpiste.evaluation.errors import Errors, trajectories
from offpiste.evaluation.evaluate import Evaluation, Prediction
from offpiste.evaluation.evaluated_windows import EvaluatedWindows
from offpiste.evaluation.metrics import Case, display
from offpiste.evaluation.report_figures import deciding_cases, report_figure, title_of
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.report.chart import Chart, Line, Panel, Raster
from offpiste.report.feature_colours import colour_limits, colours
from offpiste.report.figure import SOFT

QUARTILES = {0.25: "lower quartile", 0.5: "median", 0.75: "upper quartile"}
EACH = 2
"""Number of windows at each quartile."""
WORST = 10
"""Number of worst windows."""
APART: Final = HISTORY_STEPS + HORIZON_STEPS
"""Number of rows between the starts of windows from which they share no row."""
NEAR = 0.1
"""Largest difference between the rank of a typical window and its quartile, as a share of all windows."""
NOT_WORST = 0.75
"""Share of the windows that are never shown as worst windows."""
MARGIN = 4.0
"""Margin around the paths [m]."""
MOST_REACH = 2.0
"""Largest size of a panel relative to the recorded path; predictions beyond it are cut off."""
PIXELS = 240
"""Width of a picture of the ground."""
GREY = 150
"""Grey level of ground without features."""
FADED = 0.55
"""Opacity of the ground, so that lines on it are visible."""
START: Final = Line("", np.zeros(1), np.zeros(1), RECORDED, marker="^")
"""Triangle at the start of a window."""

Square = tuple[tuple[float, float], float]
"""Centre (ahead, left) and half the width of a square in the frame of a window's start [m]."""

PANELS = (
    "Each panel starts at the triangle, with the initial heading upwards; dots are the positions after 5 s. A model "
    "with several runs has a line for each run. Colours of the ground: the first three features of the vehicle's map, "
    "as it was at the start if the dataset has a snapshot; grey: ground without features. Without visual features: the "
    "path of the whole drive as a broad line."
)


@report_figure(
    "typical",
    section="Typical windows",
    caption=f"Windows at the quartiles of the error, as far as some do not overlap. {PANELS}",
)
def draw_typical(evaluation: Evaluation) -> Chart | None:
    """Draw windows at the quartiles of the first model's error."""
    chosen, shares = typical_windows(evaluation.errors[evaluation.shown], tuple(QUARTILES), each=EACH)
    return _chart(evaluation, "Windows at the quartiles of", chosen, [f"{QUARTILES[share]}: " for share in shares])


@report_figure(
    "worst",
    section="Worst windows",
    caption=f"Windows with the largest distance errors after 5 s, without overlap, of the worst quarter. {PANELS}",
)
def draw_worst(evaluation: Evaluation) -> Chart | None:
    """Draw the first model's worst windows."""
    chosen = worst_windows(evaluation.errors[evaluation.shown], count=WORST)
    return _chart(evaluation, "Worst windows of", chosen, [""] * WORST)


def worst_windows(errors: Errors, *, count: int) -> Errors:
    """Return at most `count` windows with the largest distance errors after 5 s that do not overlap.

    Only the worst quarter of all windows is used (`NOT_WORST`), so that a short part gives fewer.
    """
    distance = errors.distance()
    order = np.argsort(-distance, kind="stable")
    bad = distance >= np.quantile(distance, NOT_WORST, method="nearest")
    return errors.take(np.array(_apart(errors, order[bad[order]], count), np.int64))


def typical_windows(errors: Errors, shares: Sequence[float], *, each: int) -> tuple[Errors, list[float]]:
    """Return windows close to quantiles of the distance error after 5 s that do not overlap.

    Windows whose rank differs by more than `NEAR`, and quantiles that are not finite, are left out.

    Args:
        shares: quantiles, 0 to 1.
        each: number of windows for each.

    Returns:
        Errors, and the quantile of each window.
    """
    distance, chosen = errors.distance(), dict[int, float]()
    for share in each * sorted(shares, key=lambda share: abs(share - 0.5)):  # the median first
        low, wanted, high = np.quantile(distance, np.clip((share - NEAR, share, share + NEAR), 0, 1), method="nearest")
        if np.isfinite(wanted):
            near = np.argsort(np.abs(distance - wanted), kind="stable")
            near = near[(distance[near] >= low) & (distance[near] <= high) & np.isfinite(distance[near])]
            chosen |= dict.fromkeys(_apart(errors, near, 1, tuple(chosen)), share)
    order = sorted(chosen, key=lambda index: chosen[index])
    return errors.take(np.array(order, np.int64)), [chosen[index] for index in order]


def _apart(errors: Errors, order: Int[np.ndarray, " n"], count: int, used: Sequence[int] = ()) -> list[int]:
    """Return the first `count` windows in this order that overlap neither each other nor used ones."""
    chosen: list[int] = []
    for i in order:
        others = [*used, *chosen]
        near = np.abs(errors.row[others] - errors.row[i]) <= APART
        if len(chosen) < count and not (near & (errors.drive[others] == errors.drive[i])).any():
            chosen.append(int(i))
    return chosen


def _chart(evaluation: Evaluation, title: str, chosen: Errors, notes: Sequence[str]) -> Chart | None:
    """Predict windows again with every run, and describe a panel for each; None without windows."""
    if not len(chosen.row):
        return None
    dataset, cases = evaluation.windows.dataset, _cases(evaluation)
    windows = EvaluatedWindows(dataset, chosen.drive, chosen.row)
    poses = windows.at_start("state_causal" if cases[0].start == "causal" else "state")
    predicted: list[dict[Case, list[np.ndarray]]] = [{case: [] for case in cases} for _ in chosen.row]
    for prediction in evaluation.predictions:
        if prediction.case in cases:
            for i, path in _paths(prediction, chosen, poses):
                predicted[i][prediction.case].append(path)
    driven, recorded, squares = [], [], []
    for drive, row, pose, paths in zip(chosen.drive, chosen.row, poses, predicted, strict=True):
        driven.append(planar_body_from_world(dataset.drives[drive].rows.state[:, :2] - pose[:2], pose[2:3]))
        recorded.append(driven[-1][row + 1 : row + 1 + HORIZON_STEPS])
        squares.append(_square(recorded[-1], [path for runs in paths.values() for path in runs]))
    panels = []
    for i, ground in enumerate(ground_pictures(dataset, chosen.drive, chosen.row, poses[:, :3], squares)):
        drive, error, ((ahead, left), half) = dataset.drives[chosen.drive[i]], chosen.distance()[i], squares[i]
        x_range, y_range = (-left - half, -left + half), (ahead - half, ahead + half)
        lines = [path_line("recorded", RECORDED, recorded[i], recorded[i])]
        if ground is None:
            ahead_of, left_of = _inside(driven[i], drive.rows.valid, squares[i]).T
            lines.insert(0, Line("", -left_of, ahead_of, SOFT, width=5.0, opacity=0.3))
        for case, runs in predicted[i].items():
            name, width = display(case.label), 1.0 if len(runs) > 1 else 1.6
            lines += [path_line(name, colour_of(case.label), path, recorded[i], width) for path in runs]
        panels.append(
            Panel(
                "to the right [m]",
                "ahead [m]",
                [*lines, START],
                raster=None if ground is None else Raster(ground, (*x_range, *y_range), FADED),
                title=f"{notes[i]}error {f'{error:.2f} m' if np.isfinite(error) else 'failed'}\n"
                f"{windows.start_speed[i]:.1f} m/s, heading {np.degrees(poses[i, 2]) % 360:.0f}°\n"
                f"{drive.name}, at {chosen.row[i] * DT:.1f} s",
                x_range=x_range,
                y_range=y_range,
                equal=True,
                hover="closest",
            )
        )
    return Chart(panels, f"{title} {evaluation.shown.reading_label}, {title_of(evaluation)}")


def _cases(evaluation: Evaluation) -> list[Case]:
    """Return the deciding case of each model, the first model last, so that its line lies on top."""
    first = {case.label: case for case in reversed(deciding_cases(evaluation))}
    others = [case for case in reversed(first.values()) if case.label != evaluation.shown.label]
    return [*others, evaluation.shown]


def _paths(
    prediction: Prediction, chosen: Errors, poses: Float[np.ndarray, "n 6"]
) -> Iterator[tuple[int, Float[np.ndarray, "T 2"]]]:
    """Yield the indices of the chosen windows among those of a run, and its path in each."""
    model, windows = prediction.model, prediction.windows
    row = windows.row_in_drive(np.arange(len(windows)))
    place, index = np.nonzero((windows.drive == chosen.drive[:, None]) & (row == chosen.row[:, None]))
    states = trajectories(model.dynamics, windows, index, lookup=prediction.case.lookup)
    finite = np.where(np.isfinite(states[..., :2]), states[..., :2], np.nan)
    yield from zip(place.tolist(), planar_body_from_world(finite, poses[place, 2, None]), strict=True)


def _square(recorded: np.ndarray, predicted: Sequence[np.ndarray]) -> Square:
    """Return a square around the recorded path, and the predicted ones within `MOST_REACH`."""
    own = np.concatenate((np.zeros((1, 2)), recorded))
    low, high = own.min(axis=0), own.max(axis=0)
    middle, reach = (low + high) / 2, MOST_REACH * max(float((high - low).max()) / 2, MARGIN)
    shown = np.concatenate([own, *predicted])
    shown = shown[np.isfinite(shown).all(axis=1)].clip(middle - reach, middle + reach)
    low, high = shown.min(axis=0), shown.max(axis=0)
    ahead, left = (low + high) / 2
    return (float(ahead), float(left)), float((high - low).max()) / 2 + MARGIN


def _inside(path: Float[np.ndarray, "N 2"], valid: Bool[np.ndarray, " N"], square: Square) -> Float[np.ndarray, "M 2"]:
    """Return every fifth point of a path in a square, with NaN between its pieces."""
    shown = (valid & (np.abs(path - square[0]).max(axis=1) <= square[1]))[::5]
    kept = shown | np.roll(shown, 1)
    return np.where(shown[:, None], path[::5], np.nan)[kept]


def path_line(
    label: str, colour: str, path: Float[np.ndarray, "T 2"], recorded: Float[np.ndarray, "T 2"], width: float = 1.6
) -> Line:
    """Describe a path up to its first value that is not finite; points show time and distance to the recorded path."""
    failed = ~np.isfinite(path).all(axis=1)
    shown = np.concatenate((np.zeros((1, 2)), path[: int(np.argmax(failed)) if failed.any() else None]))
    away = np.linalg.norm(shown - np.concatenate((np.zeros((1, 2)), recorded))[: len(shown)], axis=1)
    hover = [f"{label} after {step * DT:.1f} s" for step in range(len(shown))]
    if path is not recorded:
        hover = [f"{text}\n{metres:.2f} m from the recorded position" for text, metres in zip(hover, away, strict=True)]
    return Line(label, -shown[:, 1], shown[:, 0], colour, width=width, marker="o", marked="last", hover=hover)


def ground_pictures(
    dataset: Dataset,
    drive: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    poses: Float[np.ndarray, "n 3"],
    squares: Sequence[Square],
) -> list[UInt8[np.ndarray, "h w 4"] | None]:
    """Return pictures (RGBA) of the ground of windows, with the initial heading upwards; None without features.

    Ground without features is grey; unknown ground is transparent. The map is that at the window's start if the dataset
    has a snapshot, else that of the whole drive.

    Args:
        drive, row: of the windows.
        poses: px, py, yaw at the starts, in the frame of the drive's rows.
    """
    if not dataset.features:
        return [None] * len(row)
    whole: dict[int, TerrainMap] = {}
    sampled: list[tuple[np.ndarray, np.ndarray] | None] = []
    for number, at, pose, square in zip(drive.tolist(), row.tolist(), poses, squares, strict=True):
        stored = dataset.drives[number]
        terrain = _snapshot(stored, at)
        if terrain is None and stored.load_map is not None:
            terrain = whole[number] = whole.get(number) or stored.load_map()
        place = pose + np.append(stored.rows.origin, 0.0)
        sampled.append(None if terrain is None else _sample(terrain, place, square))
    parts = [part[0].reshape(-1, part[0].shape[-1]) for part in sampled if part is not None]
    limits = colour_limits(np.concatenate(parts)) if parts else np.zeros((2, 3))
    return [None if part is None else _coloured(*part, limits) for part in sampled]


def _snapshot(drive: StoredDrive, row: int) -> TerrainMap | None:
    """Return the stored map of a row, if any."""
    if drive.snapshots is None:
        return None
    number = np.flatnonzero(drive.snapshots.row == row)
    return drive.snapshots.load(int(number[0])) if len(number) else None


def _sample(
    terrain: TerrainMap, pose: Float[np.ndarray, " 3"], square: Square
) -> tuple[Float[np.ndarray, "h w F"], Float[np.ndarray, "h w"]]:
    """Return features (at most three) and elevation at a picture's pixels, first row farthest ahead; NaN if unknown."""
    (ahead, left), half = square
    steps = half * (1 - (2 * np.arange(PIXELS) + 1) / PIXELS)
    forward, side = np.meshgrid(ahead + steps, left + steps, indexing="ij")
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    places = np.stack((pose[0] + cos * forward - sin * side, pose[1] + sin * forward + cos * side), axis=-1)
    column, row = np.moveaxis(np.rint((places - terrain.origin) / terrain.resolution).astype(int), -1, 0)
    ny, nx = terrain.elevation.shape
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    row, column = row.clip(0, ny - 1), column.clip(0, nx - 1)
    features = np.asarray(terrain.features[row, column, :3], np.float32)
    return np.where(inside[..., None], features, np.nan), np.where(inside, terrain.elevation[row, column], np.nan)


def _coloured(
    features: Float[np.ndarray, "h w F"], elevation: Float[np.ndarray, "h w"], limits: Float[np.ndarray, "2 3"]
) -> UInt8[np.ndarray, "h w 4"]:
    seen = np.isfinite(features).all(axis=-1)
    shade = np.where(seen[..., None], colours(features, limits), GREY)
    opaque = np.where(seen | np.isfinite(elevation), 255, 0)[..., None]
    return np.concatenate((shade, opaque), axis=-1).astype(np.uint8)
