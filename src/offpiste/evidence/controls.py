"""Controls of a comparison with `b`: features of other ground, and what recorded places give away."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch

from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.intervals import PairedDifference
from offpiste.report.text_table import TextTable
from offpiste.reproduction.gains import HINDSIGHT, MAP, Gain, errors_of, evaluation_index, gain
from offpiste.reproduction.results import FigureResults
from offpiste.reproduction.shift import SHIFTED, ShiftControl, shift_gains
from offpiste.reproduction.tables import percent, verdict
from offpiste.training.run import Run

PLACES: Final = {MAP: "on the map", HINDSIGHT: "at recorded places"}
"""Where the ground is read."""

MODELS: Final = ("b", "df", "cf", "dc")
"""Models that controls are made of."""

ABOUT_LEAK: Final = (
    "The same run on the same windows, the ground read at recorded places instead of on the map at predicted ones; its "
    "baseline is itself on the map. Recorded places give away how far the vehicle went. b sees the slope only: what it "
    "gains there no eye has seen, and other models gain it, too. So the map decides."
)


@dataclass(frozen=True)
class Controls:
    """Gains of control experiments.

    Attributes:
        shift: over `b`, with features as recorded and of other ground.
        leak: at recorded places, over the same model on the map; none where there is no map.
    """

    shift: ShiftControl
    leak: list[Gain]


def run_controls(
    dataset: Dataset, runs: Mapping[str, Sequence[Run]], *, stride: int, scale: torch.Tensor, kept: Path
) -> Controls:
    """Evaluate trained runs on the test part with features from elsewhere, and at recorded places.

    Args:
        runs: of `MODELS`.
        stride: of the windows at recorded places [rows].
        scale: of the loss.
        kept: folder of the errors.
    """
    return Controls(
        shift_gains(dataset, runs, stride=stride, scale=scale, kept=kept),
        leak_gains(dataset, runs, stride=stride, scale=scale, kept=kept),
    )


def leak_gains(
    dataset: Dataset, runs: Mapping[str, Sequence[Run]], *, stride: int, scale: torch.Tensor, kept: Path
) -> list[Gain]:
    """Gains of each model at recorded places over itself on the map, on the windows with a map; see `run_controls`."""
    windows, gains = Windows(dataset, "test"), []
    index = evaluation_index(windows, MAP, stride)
    if not len(index) or not windows.maps.any:
        return []
    for model, mine in runs.items():
        there, on_map = (
            [errors_of(run, windows, index, reading, scale=scale, kept=folder) for run in mine]
            for reading, folder in ((HINDSIGHT, kept / "windows with a map"), (MAP, kept))
        )
        gains.append(gain("recorded places", model, there, on_map, HINDSIGHT, baseline=f"{model} on the map"))
    return gains


def checks(results: FigureResults, controls: Controls) -> TextTable:
    """What has to hold for a gain of `dc` to be one of seeing the ground, and whether it does."""
    dc = next(model for model in results.models if model.label == "dc")
    lines = []
    for reading in (reading for reading in PLACES if reading in results.readings):
        found = results.compare(dc, reading).relative["distance_error_m"]
        lines.append((f"dc is below b {PLACES[reading]}", percent(found), verdict(found)))
    for here in (g for g in controls.shift.gains if (g.model, g.case) == ("dc", SHIFTED)):
        place = next((name for read, name in PLACES.items() if read == (here.lookup, here.feature_set)), None)
        if place is not None:
            what = f"nothing is left with features of other ground {place}"
            lines.append((what, percent(here.distance), _no_gain(here.distance)))
    for here in (g for g in controls.leak if g.model == "b"):
        lines.append(("b gains nothing from recorded places", percent(here.distance), _no_gain(here.distance)))
    about = "Distance error after 5 s with 95 % intervals. Where there is no interval, nothing is certain: drive more."
    return TextTable("What has to hold", ("check", "here", "holds"), tuple(lines), about)


def _no_gain(difference: PairedDifference) -> str:
    """Whether an interval is not below zero."""
    low, high = difference.ci95
    if not (np.isfinite(low) and np.isfinite(high)):
        return "–" if not np.isfinite(difference.mean) else "not certain"
    return "no" if high < 0 else "yes"
