"""The paper's figures 3 and 4, and predictions of ten windows with features of every viewing distance."""

from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from jaxtyping import Float, Int
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from offpiste.core.conventions import DT, FEATURE_SETS, HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Dynamics
from offpiste.evaluation.box_plots import RECORDED, grouped_box_plot, whisker_top
from offpiste.evaluation.errors import in_start_frame, trajectories
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.report_figures.windows import START, path_line
from offpiste.report.chart import Chart, Panel
from offpiste.reproduction.results import HINDSIGHT, MAP, FigureResults
from offpiste.reproduction.settings import BASELINE, compression_sizes, feature_numbers, paper_name

CAPTION = (
    "Boxes: quartiles; whiskers: last value within 1.5 IQR, written beside the arrows; green: median; orange: mean. "
    "The error of a window is the mean over seeds."
)

SHOWN = 10
"""Number of windows drawn."""


def fig3(results: FigureResults, stored: int) -> dict[str, Figure]:
    """Draw figures 3a, 3b and 3c (compression, code length, number of features), at recorded places and on the map."""
    parts = {
        "a": ("Compression type", {name.upper(): name for name in (BASELINE, "df", "cf")}),
        "b": ("Compression size n", {f"C {n}": model.label for n, model in compression_sizes(stored).items()}),
        "c": ("Number of features", {f"C {n}": model.label for n, model in feature_numbers(stored).items()}),
    }
    figures = {}
    for reading, where in ((HINDSIGHT, "recorded, hindsight"), (MAP, "map at predicted places")):
        if reading not in results.readings:
            continue
        groups = {
            part: {
                name: {paper_name(results.models[label].model): _distance(results, label, reading)}
                for name, label in models.items()
            }
            for part, (_, models) in parts.items()
        }
        top = max(whisker_top(group) for group in groups.values())  # the paper uses the same axis
        for part, group in groups.items():
            name = f"3{part}" if reading == HINDSIGHT else f"3{part} map"
            figures[name] = grouped_box_plot(group, title=f"{parts[part][0]}\n({where})", top=top)
    return figures


def fig4(results: FigureResults) -> dict[str, Figure]:
    """Draw figures 4a (trained on hindsight) and 4b (`dc`) by viewing distance, and all models on the map."""
    parts = {
        "4a": ("Trained on features of hindsight, recorded lookup", (BASELINE, "b-hindsight", "df", "cf")),
        "4b": ("Trained on random distances, recorded lookup", (BASELINE, "dc")),
    }
    sets = [name for name in FEATURE_SETS if ("recorded", name) in results.readings]
    groups = {
        part: {
            name: {paper_name(label): _distance(results, label, ("recorded", name)) for label in labels}
            for name in sets
        }
        for part, (_, labels) in parts.items()
    }
    top = max(whisker_top(group) for group in groups.values())
    figures = {
        part: grouped_box_plot(group, title=parts[part][0], axis="viewing distance [m]", top=top)
        for part, group in groups.items()
    }
    if MAP in results.readings:
        names = {label: paper_name(label) for label in results.models}
        on_map = {name.replace(" ", "\n"): {name: _distance(results, label, MAP)} for label, name in names.items()}
        figures["4 map"] = grouped_box_plot(on_map, title="Map at predicted places")
    return figures


def _distance(results: FigureResults, label: str, reading: Reading) -> np.ndarray:
    return results.by_seed(results.models[label], reading).mean.distance()


def caption(name: str, results: FigureResults) -> str:
    """Return the caption of a figure, with the numbers of drives, blocks and seeds."""
    about = {
        "3a": "B reads no terrain features, DF reads raw features, CF compresses them.",
        "3b": "CF by the length of its code; C 4 is CF.",
        "3c": "CF by the number of PCA features.",
        "4a": "DF and CF, trained on features of hindsight, B, and B trained on normals of hindsight alone as in the "
        "paper, by the viewing distance of features and normals.",
        "4b": "DC, trained on a random viewing distance for each trajectory, and B.",
        "4": "The map as it was at the window's start, read at predicted places.",
    }
    reading = MAP if "map" in name else HINDSIGHT
    return f"Fig. {name}: {about[name.split()[0]]} {CAPTION} Windows: {results.levels(reading).text()}."


def spaced_windows(windows: Windows, *, count: int = SHOWN) -> Int[np.ndarray, " n"]:
    """Return at most `count` windows that are far apart and do not overlap."""
    chosen: list[int] = []
    row, apart = windows.row_in_drive(np.arange(len(windows))), HISTORY_STEPS + HORIZON_STEPS
    for i in np.linspace(0, len(windows) - 1, 20 * count).astype(int):
        near = chosen and windows.drive[i] == windows.drive[chosen[-1]] and row[i] - row[chosen[-1]] <= apart
        if not near:
            chosen.append(int(i))
    index = np.array(chosen, dtype=np.int64)
    return index[np.unique(np.linspace(0, len(index) - 1, min(count, len(index))).astype(int))]


def same_windows_chart(models: Mapping[str, Dynamics], windows: Windows) -> Chart:
    """Describe predictions with features of every set: a row per model, a column per window, initial heading up.

    Args:
        models: by label.
    """
    index = spaced_windows(windows)
    batch = windows.gather(index)
    yaw = batch.state[:, 2].cpu().numpy()
    recorded = in_start_frame(batch.target[..., :2].cpu().numpy(), yaw)
    names = [
        f"{windows.drive_names[drive]}\n{DT * row:.0f} s"
        for drive, row in zip(windows.drive[index], windows.row_in_drive(index), strict=True)
    ]
    colours, panels = _colours(FEATURE_SETS[: windows.sets]), list[Panel]()
    for label, dynamics in models.items():
        paths = {}
        for name in colours:
            states = trajectories(dynamics, windows.with_feature_set(name), index, lookup="recorded")
            paths[name] = in_start_frame(states[..., :2], yaw)
        for i, (title, path) in enumerate(zip(names, recorded, strict=True)):
            lines = [
                path_line(name if name == "hindsight" else f"{name} m", colours[name], mine[i], path, 1.1)
                for name, mine in reversed(paths.items())  # hindsight lies on top
            ]
            x_range, y_range = _ranges(path)
            panels.append(
                Panel(
                    "",
                    f"{paper_name(label)}\nahead [m]",
                    [*lines, path_line("recorded", RECORDED, path, path), START],
                    title="" if len(panels) >= len(names) else title,
                    x_range=x_range,
                    y_range=y_range,
                    equal=True,
                    hover="closest",
                )
            )
    return Chart(panels, columns=len(names))


def _ranges(recorded: Float[np.ndarray, "T 2"]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return ranges of the axes around a recorded path, the same for all models."""
    ahead, left = np.concatenate((np.zeros((1, 2)), recorded)).T
    tall = max(float(np.ptp(ahead)), 1.6 * float(np.ptp(left)), 6.0) * 1.35
    across, along = -float(left.min() + left.max()) / 2, float(ahead.min() + ahead.max()) / 2
    return (across - 0.36 * tall, across + 0.36 * tall), (along - tall / 2, along + tall / 2)


def _colours(names: Sequence[str]) -> dict[str, str]:
    """Return colours by feature set: green for hindsight, darker for smaller distances."""
    scale = matplotlib.colormaps["plasma"](np.linspace(0, 0.9, max(len(names) - 1, 1)))
    return {"hindsight": "#1a7f37", **{name: to_hex(c) for name, c in zip(names[1:], scale, strict=False)}}
