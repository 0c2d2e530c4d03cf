"""The paper's figures 3 and 4, and ten windows predicted with features of every set."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from jaxtyping import Float, Int
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from offpiste.core.conventions import FEATURE_SETS, HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Dynamics
from offpiste.evaluation.box_plots import RECORDED, grouped_box_plot, whisker_top
from offpiste.evaluation.errors import in_start_frame, trajectories
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.window_chart import START, path_line
from offpiste.report.chart import Chart, Line, Panel, draw
from offpiste.reproduction.results import HINDSIGHT, MAP, FigureResults
from offpiste.reproduction.settings import FigureModel, compression_sizes, feature_numbers, standard_model

CAPTION = (
    "Boxes: quartiles; whiskers: last value within 1.5 IQR, given by the values with arrows; green: median; orange: "
    "mean. Each window's error is the mean over seeds."
)


def fig3(results: FigureResults, stored: int) -> dict[str, Figure]:
    """Draw figures 3a, 3b and 3c (compression, code length, number of features), at recorded places and on the map."""
    named: dict[str, dict[str, FigureModel]] = {
        "a": {name.upper(): standard_model(name, stored) for name in ("b", "df", "cf")},
        "b": {f"C {n}": model for n, model in compression_sizes(stored).items()},
        "c": {f"C {n}": model for n, model in feature_numbers(stored).items()},
    }
    titles = {"a": "Compression type", "b": "Compression size n", "c": "Number of features"}
    figures = {}
    for reading, where in ((HINDSIGHT, "recorded, hindsight"), (MAP, "map at predicted places")):
        if reading not in results.readings:
            continue
        groups = {
            part: {name: {model.model: _distance(results, model, reading)} for name, model in models.items()}
            for part, models in named.items()
        }
        top = max(whisker_top(group) for group in groups.values())  # the paper uses the same axis
        for part, group in groups.items():
            name = f"3{part}" if reading == HINDSIGHT else f"3{part} map"
            figures[name] = grouped_box_plot(group, title=f"{titles[part]}\n({where})", top=top)
    return figures


def fig4(results: FigureResults) -> dict[str, Figure]:
    """Draw figures 4a (naive training) and 4b (`dc`) by viewing distance, and all models on the map."""
    by_label = {model.label: model for model in results.models}
    sets = [name for name in FEATURE_SETS if ("recorded", name) in results.readings]
    groups: dict[str, dict[str, dict[str, np.ndarray]]] = {
        part: {
            name: {label: _distance(results, by_label[label], ("recorded", name)) for label in labels} for name in sets
        }
        for part, labels in {"4a": ("b", "b-hindsight", "df", "cf"), "4b": ("b", "dc")}.items()
    }
    top = max(whisker_top(group) for group in groups.values())
    titles = {
        "4a": "Trained on features of hindsight, recorded lookup",
        "4b": "Trained on random distances, recorded lookup",
    }
    figures = {
        part: grouped_box_plot(group, title=titles[part], axis="features seen from [m]", top=top)
        for part, group in groups.items()
    }
    if MAP in results.readings:
        models = {label: {label: _distance(results, model, MAP)} for label, model in by_label.items()}
        figures["4 map"] = grouped_box_plot(models, title="Map at predicted places")
    return figures


def _distance(results: FigureResults, model: FigureModel, reading: Reading) -> np.ndarray:
    return results.over_seeds(model, reading).distance()


def caption(name: str, results: FigureResults) -> str:
    """Return the caption of a figure, with the numbers of drives, blocks and seeds."""
    about = {
        "3a": "B has no terrain features, DF reads features as they are, CF compresses them.",
        "3b": "CF by the length of its code; C 4 is CF.",
        "3c": "CF by the number of PCA features that it reads.",
        "4a": "DF and CF, trained on features of hindsight, B, and B trained on normals of hindsight alone as in the "
        "paper, by the distance that features and normals were seen from.",
        "4b": "DC, trained on a random distance per trajectory, and B.",
        "4": "The map as it was at the window's start, read where predictions go.",
    }
    reading = MAP if "map" in name else HINDSIGHT
    return f"Fig. {name}: {about[name.split()[0]]} {CAPTION} Windows: {results.levels(reading).text()}."


SHOWN = 10
"""Number of windows drawn."""


@dataclass(frozen=True)
class SameWindows:
    """Paths in the frame of each window's start: ahead and to the left [m].

    Attributes:
        names: drive and time of each window.
        recorded: driven paths.
        predicted: paths by model and feature set.
    """

    names: tuple[str, ...]
    recorded: Float[np.ndarray, "n T 2"]
    predicted: Mapping[str, Mapping[str, Float[np.ndarray, "n T 2"]]]


def spaced_windows(windows: Windows, *, count: int = SHOWN) -> Int[np.ndarray, " n"]:
    """Return windows far apart, no two of which share a row; fewer if there are not enough."""
    chosen: list[int] = []
    row, apart = windows.row_in_drive(np.arange(len(windows))), HISTORY_STEPS + HORIZON_STEPS
    for i in np.linspace(0, len(windows) - 1, 20 * count).astype(int):
        near = chosen and windows.drive[i] == windows.drive[chosen[-1]] and row[i] - row[chosen[-1]] <= apart
        if not near:
            chosen.append(int(i))
    index = np.array(chosen, dtype=np.int64)
    return index[np.unique(np.linspace(0, len(index) - 1, min(count, len(index))).astype(int))]


def predict_same(models: Mapping[str, Dynamics], windows: Windows) -> SameWindows:
    """Predict ten windows with features of every set, read at recorded places."""
    index = spaced_windows(windows)
    batch = windows.gather(index)
    yaw = batch.state[:, 2].cpu().numpy()
    sets = FEATURE_SETS[: windows.sets]
    predicted = {
        label: {
            name: in_start_frame(
                trajectories(dynamics, windows.with_feature_set(name), index, lookup="recorded")[..., :2], yaw
            )
            for name in sets
        }
        for label, dynamics in models.items()
    }
    row = windows.row_in_drive(index)
    names = [f"{windows.drive_names[d]}\n{0.02 * r:.0f} s" for d, r in zip(windows.drive[index], row, strict=True)]
    return SameWindows(tuple(names), in_start_frame(batch.target[..., :2].cpu().numpy(), yaw), predicted)


def draw_same(same: SameWindows) -> Figure:
    """Panels with a row per model and a column per window, heading up; the colour is the feature set."""
    colours = _colours(list(next(iter(same.predicted.values()))))
    first, panels = next(iter(same.predicted)), []
    for label, predicted in same.predicted.items():
        for number, (name, recorded) in enumerate(zip(same.names, same.recorded, strict=True)):
            lines = [
                path_line(each if each == "hindsight" else f"{each} m", colours[each], paths[number], recorded, 1.1)
                for each, paths in reversed([*predicted.items()])  # hindsight lies on top
            ]
            lines += [path_line("recorded", RECORDED, recorded, recorded), START]
            panels.append(_panel(f"{label}\nahead [m]", lines, recorded, name if label == first else ""))
    return draw(Chart(panels, columns=len(same.names)))


def _panel(y_axis: str, lines: Sequence[Line], recorded: Float[np.ndarray, "T 2"], title: str) -> Panel:
    """A panel around the recorded path, the same for all models."""
    ahead, left = np.concatenate((np.zeros((1, 2)), recorded)).T
    tall = max(float(np.ptp(ahead)), 1.6 * float(np.ptp(left)), 6.0) * 1.35
    across, along = -float(left.min() + left.max()) / 2, float(ahead.min() + ahead.max()) / 2
    x_range, y_range = (across - 0.36 * tall, across + 0.36 * tall), (along - tall / 2, along + tall / 2)
    return Panel("", y_axis, lines, title=title, x_range=x_range, y_range=y_range, equal=True, hover="closest")


def _colours(names: Sequence[str]) -> dict[str, str]:
    """Colours by feature set: green for hindsight; the nearer, the darker."""
    scale = matplotlib.colormaps["plasma"](np.linspace(0, 0.9, max(len(names) - 1, 1)))
    return {"hindsight": "#1a7f37", **{name: to_hex(c) for name, c in zip(names[1:], scale, strict=False)}}
