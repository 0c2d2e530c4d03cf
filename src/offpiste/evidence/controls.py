"""Controls of a comparison with `b`: features of other ground, and what recorded places give away."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch

from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.intervals import MIN_UNITS, PairedDifference
from offpiste.evidence.baselines import baseline_gains
from offpiste.report.text_table import TextTable
from offpiste.reproduction.gains import HINDSIGHT, MAP, Gain, errors_of, evaluation_index, gain
from offpiste.reproduction.results import FigureResults
from offpiste.reproduction.shift import OWN_GROUND, SHIFTED, ShiftControl, shift_gains
from offpiste.reproduction.tables import percent
from offpiste.training.run import Run

logger = logging.getLogger(__name__)

PLACES: Final = {MAP: "on the map", HINDSIGHT: "at recorded places"}
"""Where the ground is read."""

MODELS: Final = ("b", "df", "cf", "dc")
"""Models that controls are made of."""

UNKNOWN: Final = "cannot be said"

LEFT: Final = 0.5
"""Share of `dc`'s gain that an interval must not reach for nothing to be left or gained."""

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
        baselines: of `b` over its own physics, and of these over `kinematic`.
    """

    shift: ShiftControl
    leak: list[Gain]
    baselines: list[Gain]


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
    logger.info(f"control experiments of {sum(map(len, runs.values()))} runs: other ground, recorded places, baselines")
    return Controls(
        shift_gains(dataset, runs, stride=stride, scale=scale, kept=kept),
        leak_gains(dataset, runs, stride=stride, scale=scale, kept=kept),
        baseline_gains(dataset, runs["b"], stride=stride, scale=scale, kept=kept),
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


def checks(results: FigureResults, controls: Controls, *, learned: bool = True) -> TextTable:
    """What has to hold for a gain of `dc` to be one of seeing the ground, and whether it does.

    Args:
        learned: whether `dc` did; otherwise it cannot be said.
    """
    dc = next(model for model in results.models if model.label == "dc")
    lines, allowed = [], np.inf

    def add(what: str, difference: PairedDifference, holds: str, *, of_dc: bool = True) -> None:
        lines.append((what, percent(difference), UNKNOWN if of_dc and not learned else holds))

    for reading in (reading for reading in PLACES if reading in results.readings):
        found = results.compare(dc, reading).relative["distance_error_m"]
        allowed = min(allowed, max(0.0, -found.mean) * LEFT)
        add(f"dc is below b {PLACES[reading]}", found, _below(found))
    for here in (g for g in controls.shift.gains if g.model == "dc"):
        place = next((name for read, name in PLACES.items() if read == (here.lookup, here.feature_set)), None)
        if place is not None and here.case == SHIFTED:
            add(
                f"nothing is left with features of other ground {place}",
                here.distance,
                _no_gain(here.distance, allowed),
            )
        if place is not None and here.case == OWN_GROUND:
            add(f"dc is below itself with features of other ground {place}", here.distance, _below(here.distance))
    for here in (g for g in controls.leak if g.model == "b"):
        add("b gains nothing from recorded places", here.distance, _no_gain(here.distance, allowed), of_dc=False)
    for here in controls.baselines:
        add(f"{here.model} is below {here.baseline}", here.distance, _below(here.distance), of_dc=False)
    about = (
        "Distance errors after 5 s relative to each other, with 95 % intervals; negative: smaller, which is better. "
        "Below: yes where the whole interval is negative, no where none of it is, not certain between. Nothing left "
        "or gained: no where the whole interval is negative; yes where none of it reaches half of what dc gains on b; "
        f"not certain between. {UNKNOWN}: there is no interval (–), since it takes "
        f"{MIN_UNITS} drives, or {MIN_UNITS} blocks of 10 s of a single drive; or dc learned nothing."
    )
    return TextTable("What has to hold", ("check", "here", "holds"), tuple(lines), about)


def _below(difference: PairedDifference) -> str:
    """Whether an interval lies below zero; where it is zero to the bit, it does not."""
    low, high = difference.ci95
    if not (np.isfinite(low) and np.isfinite(high)):
        return UNKNOWN
    return "yes" if high < 0 else "no" if low >= 0 else "not certain"


def _no_gain(difference: PairedDifference, allowed: float) -> str:
    """Whether an interval rules out a gain, but for one below `allowed`: one that is too wide rules out nothing."""
    low, high = difference.ci95
    if not (np.isfinite(low) and np.isfinite(high)):
        return UNKNOWN
    if high < 0:
        return "no"
    return "yes" if low > -allowed or low >= 0 else "not certain"
