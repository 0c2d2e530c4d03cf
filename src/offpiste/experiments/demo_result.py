"""What the demo ends with: `b` against `dc` by the distance that ground was seen from, as a table and a picture."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from offpiste.conventions import DT, FEATURE_SETS
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.grouped import grouped_boxes
from offpiste.evaluation.judge import Errors
from offpiste.evaluation.metrics import MIN_BLOCKS, PairedDifference, relative, summary
from offpiste.evaluation.report import png
from offpiste.evaluation.table import interval, number
from offpiste.evaluation.tabulate import REFERENCE, Sampling
from offpiste.files import write_bytes
from offpiste.viewing.cover_table import TextTable

BASELINE, MODEL = "b", "dc"
MAP = "map, predicted places"

Read = dict[str, dict[str, Errors]]
"""Errors by where the ground is read, and by model."""


def tell_result(evaluation: Evaluation, dataset: Dataset, folder: Path, *, tell: Callable[[object], None]) -> None:
    """Say and draw how far `b` and `dc` are off after 5 s; the picture goes to `folder/distance.png`."""
    read = by_reading(evaluation)
    table, picture = compared(read), folder / "distance.png"
    boxes = {place: {name: errors.distance() for name, errors in models.items()} for place, models in read.items()}
    title = f"Demo: {BASELINE} and {MODEL}, trained on {_seconds(dataset, 'train'):.0f} s"
    write_bytes(picture, png(grouped_boxes(boxes, title=title, axis="ground read from a view at [m]")))
    tell(table.rich())
    tell(table.about)
    tell(conclusion(gain_of(read[MAP]) if MAP in read else gain_of(next(iter(read.values()))), dataset))
    reference = next(errors for case, errors in evaluation.errors.items() if case.label == REFERENCE)
    tell(f"For scale: '{REFERENCE}', a bicycle at constant speed, is off by {reference.distance().mean():.2f} m.")
    tell(
        "More driving: `offpiste reproduce fig4 --size laptop` (two hours); measured results stand in docs/results.md."
    )
    tell(f"picture: {picture}")
    tell(f"report: {folder / 'report.html'}")


def by_reading(evaluation: Evaluation) -> Read:
    """Errors of both models on the same windows, by the view that the ground is read from, and on the map."""
    found: Read = {}
    for place, way in {**{name: ("recorded", name) for name in FEATURE_SETS}, MAP: ("map", None)}.items():
        models = {c.label: e for c, e in evaluation.errors.items() if (c.lookup, c.feature_set) == way}
        if {BASELINE, MODEL} <= models.keys():
            found[place] = {name: models[name] for name in (BASELINE, MODEL)}
    return found


def gain_of(models: dict[str, Errors]) -> PairedDifference:
    """Mean distance error of `dc` relative to `b`'s on the same windows: -0.1 is 10 % below."""
    mine, other = models[MODEL], models[BASELINE]
    return relative(mine.distance(), other.distance(), Sampling().on(mine))


def compared(read: Read) -> TextTable:
    """Mean distance errors after 5 s."""
    lines = []
    for place, models in read.items():
        means = [summary(errors.distance(), Sampling().on(errors)) for errors in models.values()]
        gain = gain_of(models)
        low, high = gain.ci95
        lines.append(
            (
                place if place in (MAP, "hindsight") else f"seen from {place} m",
                *(f"{number(mean.mean)} {interval(mean.ci95)}" for mean in means),
                f"{100 * gain.mean:+.1f} % {interval((100 * low, 100 * high), 1)}",
            )
        )
    windows = len(next(iter(read.values()))[MODEL].row)
    about = (
        f"Intervals: 95 %, over blocks of 10 s; none with fewer than {MIN_BLOCKS} blocks. Both models read the slope as"
        " seen from there.\nAll lines but the last read the ground under the wheels' recorded future places, which"
        " tells a model how far the\nvehicle went. The last one reads the map where predictions go, as a planner does:"
        " it decides."
    )
    title = f"Mean distance error after 5 s \\[m] on {windows} windows of the test drives"
    return TextTable(title, ("ground", *read[next(iter(read))], f"{MODEL} against {BASELINE}"), tuple(lines), about)


def conclusion(gain: PairedDifference, dataset: Dataset) -> str:
    """What may be said of `dc` against `b`, and what may not."""
    driven = (
        f"{_seconds(dataset, 'train'):.0f} s of driving to learn from and {_seconds(dataset, 'test'):.0f} s to judge"
    )
    low, high = gain.ci95
    if not np.isfinite([low, high]).all():
        return f"Nothing can be said of dc against b here: {driven} are too little for an interval."
    if high < 0:
        return f"Here dc is {-100 * gain.mean:.0f} % below b, with {driven}; another seed may say otherwise."
    if low > 0:
        return f"Here dc is {100 * gain.mean:.0f} % above b: {driven} are too little for it."
    return f"No difference between dc and b is shown here: the interval holds zero, with {driven}."


def _seconds(dataset: Dataset, part: str) -> float:
    return DT * sum(int((drive.part == PARTS.index(part)).sum()) for drive in dataset.drives)
