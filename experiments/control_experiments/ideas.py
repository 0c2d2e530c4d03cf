"""Ideas for codes that serve better than `dc`'s: one at a time, compared on the drives that validate."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from experiments.control_experiments.distilled import distilled
from experiments.control_experiments.models import trained
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import write_control
from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.known_cells import CellList
from offpiste.dataset.map_snapshots import Snapshots
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_models import Reading
from offpiste.reproduction.gains import MAP, Gain, errors_of, evaluation_index, gain, gain_table
from offpiste.training.config import TrainConfig
from offpiste.training.run import Run

logger = logging.getLogger("experiments")

ABOUT: Final = (
    "On the windows of the validation part; the test part is not looked at. Relative to the reproduction's `dc`, or "
    "`b` for ideas of it (below 0: better), with 95 % intervals over drives, blocks of 10 s and seeds. Each differs in "
    "what its line says. Epochs were chosen on the same windows."
)
READINGS: Final[tuple[Reading, ...]] = (MAP, *(("recorded", name) for name in ("10", "20", "30")))

NETWORK_ALONE: Final = ("model", "codes", "pca", "epochs")
"""Settings that the bicycle's constants do not depend on: where others differ, they are fitted anew."""

BESIDE_HINDSIGHT: Final = FEATURE_SETS.index("10")
"""Feature set that is read beside hindsight's own, which has no distance."""

BLIND_SPOT: Final = 4.0
"""Nearer to the vehicle no ground is seen [m]."""


@dataclass(frozen=True)
class Idea:
    """Something that may make better codes.

    Attributes:
        what: it is, in a few words.
        model: that is trained.
        baseline: of the reproduction, that it is compared with and takes its settings from.
        config: its settings, from those of the baseline.
        changed: the dataset that it is trained and evaluated on; the reproduction's own by default.
        mapped: whether the maps of that dataset hold what the model reads.
        made: makes a run otherwise than by training, from the reproduction, a folder and a seed.
    """

    what: str
    model: str = "dc"
    baseline: str = "dc"
    config: Callable[[TrainConfig], TrainConfig] = lambda config: config
    changed: Callable[[Dataset], Dataset] | None = None
    mapped: bool = True
    made: Callable[[Reproduced, Path, int], Run] | None = None


def ideas_control(of: Reproduced, out: Path, chosen: list[str], seeds: int) -> Path:
    """Train each idea as the reproduction trained its baseline, and compare both on validation.

    Args:
        chosen: of `IDEAS`; all where empty.
        seeds: runs of each.
    """
    gains: list[Gain] = []
    for name in chosen or list(IDEAS):
        idea, folder = IDEAS[name], out / "ideas" / name.replace(" ", "-")
        base = of.runs(idea.baseline)[:seeds]
        dataset = of.dataset if idea.changed is None else idea.changed(of.dataset)
        runs = [_run(of, idea, dataset, folder / "runs", seed) for seed in range(len(base))]
        mine, usual = Windows(dataset, "validation"), Windows(of.dataset, "validation")
        for reading in READINGS if idea.mapped else READINGS[1:]:
            index = evaluation_index(usual, reading, of.size.stride)
            scale = of.scale
            changed = [errors_of(run, mine, index, reading, scale=scale, kept=folder / "evaluated") for run in runs]
            kept = out / "ideas" / idea.baseline / "evaluated"
            before = [errors_of(run, usual, index, reading, scale=scale, kept=kept) for run in base]
            gains.append(gain(idea.what, name, changed, before, reading, baseline=idea.baseline))
        logger.info(f"{name}: {100 * gains[-1].distance.mean:+.1f} % ({' '.join(map(str, READINGS[-1]))})")
    table = gain_table("Ideas for better codes", gains, ABOUT)
    return write_control(out / "ideas", [table], {"control": "ideas", "part": "validation", "gains": gains})


def _run(of: Reproduced, idea: Idea, dataset: Dataset, runs: Path, seed: int) -> Run:
    if idea.made is not None:
        return idea.made(of, runs, seed)
    usual = of.member(idea.baseline).config(of.size, seed, "cpu")
    config = idea.config(replace(usual, model=idea.model))
    same_bicycle = replace(config, **{name: getattr(usual, name) for name in NETWORK_ALONE}) == usual
    return trained(dataset, config, runs, stages=of.folder / "runs" if same_bicycle else None)


def with_distance(dataset: Dataset) -> Dataset:
    """Each cell's first feature is the logarithm of the distance from which its features were seen [m]."""

    def changed(drive: StoredDrive) -> StoredDrive:
        rows = drive.rows
        assert rows.cells is not None
        seen = np.log(np.maximum(rows.cells.distance, 1.0))[..., None].astype(np.float16)
        cells = replace(rows.cells, features=np.concatenate((seen, rows.cells.features), axis=-1))
        snapshots = drive.snapshots
        if snapshots is not None:
            start = rows.state_causal[snapshots.row, :2].astype(np.float64) + rows.origin
            snapshots = SnapshotsWithDistance(**vars(snapshots), start=start)
        return replace(drive, rows=replace(rows, cells=cells), snapshots=snapshots)

    names = ("distance", *dataset.features)
    return replace(dataset, drives=tuple(map(changed, dataset.drives)), features=names)


@dataclass(frozen=True)
class SnapshotsWithDistance(Snapshots):
    """Snapshots whose cells have as first feature how far they lie from the vehicle now, as maps keep no distance.

    Attributes:
        start: px, py of the vehicle at each, in the world frame [m].
    """

    start: np.ndarray

    def known_cells(self, number: int) -> CellList:
        """The known cells of snapshot `number`."""
        cells = super().known_cells(number)
        row, column = np.divmod(cells.place, cells.shape[1])
        place = cells.origin + self.resolution * np.stack((column, row), axis=-1)
        away = np.log(np.maximum(np.linalg.norm(place - self.start[number], axis=-1), BLIND_SPOT))
        there = np.isfinite(cells.features[:, 0])
        first = np.where(there, away, np.nan).astype(np.float16)
        return replace(cells, features=np.concatenate((first[:, None], cells.features), axis=1))


def with_farther_views(count: int, dataset: Dataset) -> Dataset:
    """Each cell has `count` features of its own view and as many of the next one from farther away.

    Where that one is missing, or there is none, it is the own view once more. Maps keep one view: there are none.
    """

    def two_views(cells: Cells) -> Cells:
        farther = np.arange(len(cells.features)) + 1
        farther[[0, -1]] = [BESIDE_HINDSIGHT, len(farther) - 1]
        own, other = cells.features[..., :count], cells.features[farther][..., :count]
        other = np.where(cells.valid[farther][..., None], other, own)
        return replace(cells, features=np.concatenate((own, other), axis=-1))

    def changed(drive: StoredDrive) -> StoredDrive:
        assert drive.rows.cells is not None
        return replace(drive, rows=replace(drive.rows, cells=two_views(drive.rows.cells)), snapshots=None)

    names = tuple(f"{view} view {i}" for view in ("own", "farther") for i in range(count))
    return replace(dataset, drives=tuple(map(changed, dataset.drives)), features=names)


def longer(config: TrainConfig) -> TrainConfig:
    """Twice as many epochs."""
    return replace(config, epochs=2 * config.epochs)


def robust(config: TrainConfig) -> TrainConfig:
    """The root of the loss, where that is well above a quarter."""
    return replace(config, robust=0.5)


def mirrored(config: TrainConfig) -> TrainConfig:
    """Half of the windows that train are mirrored."""
    return replace(config, mirror=True)


IDEAS: Final[Mapping[str, Idea]] = {
    "as seen": Idea("ground ahead as it looks from the start, not one distance a trajectory", model="dc-view"),
    "distance": Idea(
        "the encoder knows from how far a cell was seen",
        config=lambda config: replace(config, pca=config.pca + 1),
        changed=with_distance,
    ),
    "two views": Idea(
        "the encoder reads the view from 10 m farther away, too",
        config=lambda config: replace(config, pca=80),
        changed=partial(with_farther_views, 40),
        mapped=False,
    ),
    "distilled": Idea("codes of far views learn what cf's are in hindsight; the rest is cf's", made=distilled),
    "eight codes": Idea("codes twice as long", config=lambda config: replace(config, codes=8)),
    "longer": Idea("twice as many epochs", config=longer),
    "b longer": Idea("twice as many epochs", model="b", baseline="b", config=longer),
    "mirrored": Idea("half of the windows that train are mirror images", config=mirrored),
    "b mirrored": Idea("half of the windows that train are mirror images", model="b", baseline="b", config=mirrored),
    "mirrored longer": Idea("mirror images, twice as many epochs", config=lambda config: longer(mirrored(config))),
    "b mirrored longer": Idea(
        "mirror images, twice as many epochs",
        model="b",
        baseline="b",
        config=lambda config: longer(mirrored(config)),
    ),
    "robust": Idea("the root of the loss, where it is large", config=robust),
    "b robust": Idea("the root of the loss, where it is large", model="b", baseline="b", config=robust),
    "few features": Idea("the first 12 of 40 features", config=lambda config: replace(config, pca=12)),
    "slow windows": Idea(
        "errors count relative to the driven distance", config=lambda config: replace(config, relative=1.0)
    ),
}
"""What is tried, by name."""
