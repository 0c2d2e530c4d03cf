"""The paper's figures 3 and 4, in its form."""

import numpy as np
from matplotlib.figure import Figure

from offpiste.conventions import FEATURE_SETS
from offpiste.evaluation.grouped import grouped_boxes, whisker_top
from offpiste.evaluation.ways import Way
from offpiste.experiments.reproduce.claims import HINDSIGHT, MAP
from offpiste.experiments.reproduce.models import Member, compression_sizes, feature_numbers, usual
from offpiste.experiments.reproduce.results import Findings

CAPTION = (
    "Boxes: quartiles; whiskers: last value within 1.5 IQR, given by the values with arrows; green: median; orange: "
    "mean. Several seeds: each window's error is their mean."
)


def fig3(found: Findings, stored: int) -> dict[str, Figure]:
    """3a compression type, 3b compression size, 3c number of features; each at recorded places and on the map."""
    named: dict[str, dict[str, Member]] = {
        "a": {name.upper(): usual(name, stored) for name in ("b", "df", "cf")},
        "b": {f"C {n}": member for n, member in compression_sizes(stored).items()},
        "c": {f"C {n}": member for n, member in feature_numbers(stored).items()},
    }
    titles = {"a": "Compression type", "b": "Compression size n", "c": "Number of features"}
    figures = {}
    for way, where in ((HINDSIGHT, "recorded, hindsight"), (MAP, "map at predicted places")):
        if way not in found.ways:
            continue
        groups = {
            part: {name: {member.model: _distance(found, member, way)} for name, member in models.items()}
            for part, models in named.items()
        }
        top = max(whisker_top(group) for group in groups.values())  # the paper keeps the axis the same
        for part, group in groups.items():
            name = f"3{part}" if way == HINDSIGHT else f"3{part} map"
            figures[name] = grouped_boxes(group, title=f"{titles[part]}\n({where})", top=top)
    return figures


def fig4(found: Findings) -> dict[str, Figure]:
    """4a naive training, 4b `dc`, by the distance that features were seen from; and all of them on the map."""
    by_label = {member.label: member for member in found.members}
    sets = [name for name in FEATURE_SETS if ("recorded", name) in found.ways]
    groups: dict[str, dict[str, dict[str, np.ndarray]]] = {
        part: {
            name: {label: _distance(found, by_label[label], ("recorded", name)) for label in labels} for name in sets
        }
        for part, labels in {"4a": ("b", "df", "cf"), "4b": ("b", "dc")}.items()
    }
    top = max(whisker_top(group) for group in groups.values())
    titles = {"4a": "Trained on hindsight, recorded lookup", "4b": "Trained on random distances, recorded lookup"}
    figures = {
        part: grouped_boxes(group, title=titles[part], axis="features seen from [m]", top=top)
        for part, group in groups.items()
    }
    if MAP in found.ways:
        models = {label: {label: _distance(found, member, MAP)} for label, member in by_label.items()}
        figures["4 map"] = grouped_boxes(models, title="Map at predicted places")
    return figures


def _distance(found: Findings, member: Member, way: Way) -> np.ndarray:
    return found.over_seeds(member, way).distance()


def caption(name: str) -> str:
    """What stands below a picture."""
    about = {
        "3a": "B knows nothing of the ground, DF reads features as they are, CF compresses them.",
        "3b": "CF by the length of its code; C 4 is CF.",
        "3c": "CF by the number of features that it reads, the first ones of the PCA.",
        "4a": "DF and CF, trained on hindsight, and B, by the distance that features and normals were seen from.",
        "4b": "DC, trained on a random distance per trajectory, and B.",
        "4": "The map as it was at the window's start, read where predictions go.",
    }
    return f"Fig. {name}: {about[name.split()[0]]} {CAPTION}"
