"""Comparison of the parts of a split by windows and speed, and the search for a better split."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.core.errors import DatasetError
from offpiste.dataset.splits import PARTS, Split, empty_parts, parse_split
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.window_starts import evaluation_starts

LEAST_WINDOWS: Final = 200  # smallest number of windows of a part: fewer cover some ten seconds of driving
MOST_APART: Final = 0.6
"""Largest Kolmogorov-Smirnov distance between the speeds of training and of another part. The recorded
drives reach 0.6 in their default split; a part that stands still while training drives reaches 0.8 and more."""
MEDIANS: Final = 1.5  # smallest ratio of the median speeds for which that distance counts: small parts scatter
MOST_RATIO: Final = 2.5  # largest ratio of the median speeds at window starts
_STANDING: Final = 0.3  # speed below which the vehicle counts as standing [m/s]
_LITTLE: Final = 600.0  # driving time in training below which `parametric` is proposed as the first model [s]
_FOR_SHORT_DRIVES: Final = (
    *("blocks:0.6,0.2,0.2", "blocks:0.5,0.25,0.25", "blocks:0.4,0.3,0.3"),
    *(f"fold:{number}/{folds}" for folds in (5, 4, 3) for number in range(folds)),
)
"""Candidate splits for drives that are too short for theirs."""


@dataclass(frozen=True)
class PartFacts:
    """Driving in one part of a dataset."""

    name: str
    windows: int  # number of windows above `min_speed`
    min_speed: float  # [m/s]
    moving: float  # time above `min_speed` [s]
    speed: Float[np.ndarray, " n"]  # of complete rows, sorted [m/s]
    median: float  # of `speed` [m/s]
    start_speed: float  # median at window starts, NaN without windows [m/s]

    def __str__(self) -> str:
        return f"{self.name} {self.windows} windows, median speed {self.median:.1f} m/s, {self.moving:.0f} s moving"


def part_facts(dataset: Dataset) -> tuple[PartFacts, ...]:
    """Summarise each part that has rows; a drive too short for its split is all training."""
    wanted = [part for part in PARTS if part not in empty_parts(dataset.split)]
    return tuple(facts for part in wanted if len((facts := _facts(dataset, part)).speed))


def _facts(dataset: Dataset, part: str) -> PartFacts:
    speeds, starts = [], []
    for drive in dataset.drives:
        mine, rows = drive.part == PARTS.index(part), drive.rows
        speed = np.hypot(rows.state[:, 3], rows.state[:, 4])
        speeds.append(speed[mine & rows.valid])
        starts.append(speed[evaluation_starts(rows, mine, dataset.min_hindsight, dataset.min_speed)])
    speed, start = (np.concatenate(each) for each in (speeds, starts))
    moving = float((speed > dataset.min_speed).sum() * DT)
    medians = (float(np.median(values)) if len(values) else np.nan for values in (speed, start))
    return PartFacts(part, len(start), dataset.min_speed, moving, np.sort(speed), *medians)


def speed_distance(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " m"]) -> float:
    """Return the Kolmogorov-Smirnov distance between two sorted samples."""
    at = np.concatenate((one, other))
    shares = (np.searchsorted(each, at, side="right") / len(each) for each in (one, other))
    return float(np.abs(np.subtract(*shares)).max())


def complaints(facts: Sequence[PartFacts]) -> Iterator[str]:
    """Yield what makes parts unfit; parts are compared with training, if it is among them."""
    for part in facts:
        if part.windows < LEAST_WINDOWS:
            yield f"{part.name} has {part.windows} windows above {part.min_speed:.3g} m/s"
    train, *others = facts if facts[0].name == PARTS[0] else facts[:1]
    for part in others:
        shifted = speed_distance(train.speed, part.speed) > MOST_APART
        shifted = shifted and _ratio(train.median, part.median, _STANDING) > MEDIANS
        if shifted or _ratio(train.start_speed, part.start_speed, train.min_speed) > MOST_RATIO:
            yield f"{part.name} drives at a median of {part.median:.1f} m/s, train at {train.median:.1f} m/s"


def _ratio(one: float, other: float, least: float) -> float:
    """Return the ratio of the larger number to the smaller; 1 if one is NaN."""
    low, high = sorted(max(value, least) for value in (one, other))
    return high / low if np.isfinite(low * high) else 1.0


def _candidates(split: Split) -> Iterator[Split]:
    """Yield other splits of the same kind; for blocks, interleaved blocks and folds."""
    shares = ",".join(f"{share:g}" for share in split.fractions)
    folds = split.fold[1] if split.kind == "fold" else 5
    texts = {
        "blocks": [f"blocks:{shares}@{period}" for period in (120, 180, 240, 300)],
        "fold": [f"fold:{number}/{folds}" for number in range(folds)],
        "places": [f"places:{size}" for size in (20, 30, 50, 75, 100)],
        "drives": [],
    }
    for text in texts[split.kind] + (texts["fold"] if split.kind == "blocks" and all(split.fractions) else []):
        try:
            other = parse_split(text)
        except DatasetError:  # blocks too short for this share
            continue
        if other != split:
            yield other


def better_split(dataset: Dataset) -> tuple[Split, tuple[PartFacts, ...]] | None:
    """Return the split of the same kind with the most similar parts, and its parts; None if all are unfit."""
    count = len(PARTS) - len(empty_parts(dataset.split))
    found = [(split, part_facts(dataset.relabelled(split))) for split in _candidates(dataset.split)]
    good = [(split, facts) for split, facts in found if len(facts) == count and not list(complaints(facts))]

    def difference(candidate: tuple[Split, tuple[PartFacts, ...]]) -> float:
        train, *others = candidate[1]
        return max((speed_distance(train.speed, part.speed) for part in others), default=0.0)

    return min(good, key=difference, default=None)


def fitting_split(drives: Sequence[StoredDrive], min_hindsight: float, min_speed: float) -> Split | None:
    """Return a split of short drives with windows in all parts; None if there is none.

    The first candidate with `LEAST_WINDOWS` in each part, or else the one with the most in its smallest part.
    """
    least = {}
    for text in _FOR_SHORT_DRIVES:
        split, counts = parse_split(text), np.zeros(len(PARTS), int)
        for drive in drives:
            label = split.label(drive.name, drive.rows.world_xy)
            for part in range(len(PARTS)):
                counts[part] += len(evaluation_starts(drive.rows, label == part, min_hindsight, min_speed))
        least[text] = min(int(counts.min()), LEAST_WINDOWS)
    best = max(least, key=least.__getitem__)
    return parse_split(best) if least[best] else None


def _cannot_train(split: Split) -> bool:
    return bool({"train", "validation"} & set(empty_parts(split)))


def is_for_tests(split: Split) -> bool:
    """Return whether all drives belong to the test part, for runs that were trained elsewhere."""
    return split.kind == "drives" and set(empty_parts(split)) == {"train", "validation"}


def lacks_windows(dataset: Dataset) -> bool:
    """Return whether training, or a part of the split, has no window."""
    with_windows = sum(part.windows > 0 for part in part_facts(dataset))
    return _cannot_train(dataset.split) or with_windows < len(PARTS) - len(empty_parts(dataset.split))


def next_split(dataset: Dataset) -> Split | None:
    """Return a split with more similar parts, or without empty ones; None if none is needed or found."""
    empty = lacks_windows(dataset)
    if not empty and not list(complaints(part_facts(dataset))):
        return None
    if not _cannot_train(dataset.split) and (better := better_split(dataset)) is not None:
        return better[0]
    if not empty or dataset.split.kind not in ("blocks", "fold"):
        return None
    return fitting_split(dataset.drives, dataset.min_hindsight, dataset.min_speed)


def has_little_driving(dataset: Dataset) -> bool:
    """Return whether training is so short that a model without a network should come first."""
    return sum(part.moving for part in part_facts(dataset) if part.name == "train") < _LITTLE


def split_warning(dataset: Dataset) -> str | None:
    """Return the faults of a dataset's split and a better split in one line; None without faults."""
    facts = part_facts(dataset)
    wrong = list(complaints(facts)) if len(facts) > 1 else []
    if dataset.split.kind == "places":  # a drive too short for other splits is all training
        wrong += [f"no square is for {part}" for part in PARTS if part not in {facts.name for facts in facts}]
    if not wrong:
        return None
    line = f"the parts of the split {dataset.split.text} are too short, or unlike each other: {'; '.join(wrong)}"
    if (better := better_split(dataset)) is not None:
        split, parts = better
        words = "; ".join(map(str, parts[1:]))
        return f"{line}; better: extract again, into another --out, with --split {split.text} ({words})"
    line += "; record more driving"
    if len(dataset.drives) > 1:
        others = "some drives to other parts" if dataset.split.kind == "drives" else "--split drives:FILE"
        line += f", or give {others}"
    return line
