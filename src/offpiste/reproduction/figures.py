"""The paper's figures 3 and 4."""

import numpy as np
from matplotlib.figure import Figure

from offpiste.core.conventions import FEATURE_SETS
from offpiste.evaluation.box_plots import grouped_box_plot, whisker_top
from offpiste.evaluation.evaluate import Reading
from offpiste.reproduction.results import HINDSIGHT, MAP, FigureResults
from offpiste.reproduction.settings import BASELINE, compression_sizes, feature_numbers, paper_name

CAPTION = (
    "Boxes: quartiles; whiskers: last value within 1.5 IQR, written at their ends; green: median; orange: mean. "
    "The error of a window is the mean over seeds."
)

ABOUT = {
    "3a": "B reads no terrain features, DF reads raw features, CF compresses them.",
    "3b": "CF by the length of its code; C 4 is CF.",
    "3c": "CF by the number of PCA features.",
    "4a": "DF and CF, trained on features of hindsight, B, and B trained on normals of hindsight alone as in the "
    "paper, by the viewing distance of features and normals.",
    "4b": "DC, trained on a random viewing distance for each trajectory, and B.",
    "4": "The map as it was at the window's start, read at predicted places.",
}


def fig3(results: FigureResults, stored: int) -> dict[str, Figure]:
    """Draw figures 3a, 3b and 3c (compression, code length, number of features), at recorded places and on the map."""
    parts = {
        "a": ("Compression type", {name.upper(): name for name in (BASELINE, "df", "cf")}),
        "b": ("Compression size n", {f"C {n}": model.label for n, model in compression_sizes(stored).items()}),
        "c": ("Number of features", {f"C {n}": model.label for n, model in feature_numbers(stored).items()}),
    }
    figures: dict[str, Figure] = {}
    for reading, where, name in ((HINDSIGHT, "recorded, hindsight", ""), (MAP, "map at predicted places", " map")):
        if reading in results.readings:
            groups = {}
            for part, (title, labels) in parts.items():
                own = {shown: _by_name(results, [label], reading) for shown, label in labels.items()}
                groups[f"3{part}{name}"] = (f"{title}\n({where})", own)
            figures |= _same_axis(groups)
    return figures


def fig4(results: FigureResults) -> dict[str, Figure]:
    """Draw figures 4a (trained on hindsight) and 4b (`dc`) by viewing distance, and all models on the map."""
    parts = {
        "4a": ("Trained on features of hindsight, recorded lookup", (BASELINE, "b-hindsight", "df", "cf")),
        "4b": ("Trained on random distances, recorded lookup", (BASELINE, "dc")),
    }
    groups = {
        part: (title, {name: _by_name(results, labels, ("recorded", name)) for name in FEATURE_SETS})
        for part, (title, labels) in parts.items()
    }
    figures = _same_axis(groups, axis="viewing distance [m]")
    if MAP in results.readings:
        on_map = {paper_name(label).replace(" ", "\n"): _by_name(results, [label], MAP) for label in results.models}
        figures |= _same_axis({"4 map": ("Map at predicted places", on_map)})
    return figures


Groups = dict[str, dict[str, np.ndarray]]


def _by_name(results: FigureResults, labels: list[str] | tuple[str, ...], reading: Reading) -> dict[str, np.ndarray]:
    """Return the distance errors of some models by their names in the figure."""
    return {paper_name(results.models[label].model): results.errors(label, reading).mean.distance() for label in labels}


def _same_axis(groups: dict[str, tuple[str, Groups]], axis: str = "") -> dict[str, Figure]:
    """Draw titled groups of boxes with the same vertical axis, as the paper does."""
    top = max(whisker_top(group) for _, group in groups.values())
    return {name: grouped_box_plot(group, title=title, axis=axis, top=top) for name, (title, group) in groups.items()}


def caption(name: str, results: FigureResults) -> str:
    """Return the caption of a figure, with the numbers of drives, blocks and seeds."""
    reading = MAP if "map" in name else HINDSIGHT
    return f"Fig. {name}: {ABOUT[name.split()[0]]} {CAPTION} Windows: {results.levels(reading).text()}."
