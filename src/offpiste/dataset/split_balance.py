"""Whether the parts of a split drive alike: their windows, speeds and turning, and a split whose parts do."""

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

LEAST_WINDOWS: Final = 200
"""Least windows of a part: fewer cover some ten seconds of driving."""
MOST_APART: Final = 0.6
"""Largest Kolmogorov-Smirnov distance between the speeds of training and of another part. The recorded
drives reach 0.6 in their default split; a part that stands still while training drives reaches 0.8 and more."""
MEDIANS: Final = 1.5
"""Least ratio of the median speeds for which that distance counts: small parts scatter."""
MOST_RATIO: Final = 2.5
"""Largest ratio of the median speeds at the starts of windows, and ..."""
MOST_TURNING: Final = 5.0
"""... of the 90 % quantiles of their turn rates."""
_STANDING: Final = 0.3
"""Speeds below this count as standing still [m/s]."""
_PERIODS: Final = (120, 180, 240, 300)
"""Interleaved blocks that are tried [s]."""
_FOLDS: Final = 5
"""Folds that are tried beside blocks."""
_SIZES: Final = (20, 30, 50, 75, 100)
"""Squares that are tried [m]."""
_FOR_SHORT_DRIVES: Final = (
    *("blocks:0.6,0.2,0.2", "blocks:0.5,0.25,0.25", "blocks:0.4,0.3,0.3"),
    *(f"fold:{number}/{folds}" for folds in (5, 4, 3) for number in range(folds)),
)
"""Tried where a drive is too short for its split."""
_LITTLE: Final = 600.0
"""Driving in training below which `parametric` is the model to begin with [s]: a choice, ten minutes."""
_LEAST_TURN: Final = 0.05
"""Turn rates below this count as straight on [rad/s]."""


@dataclass(frozen=True)
class PartFacts:
    """What is driven in one part of a dataset.

    Attributes:
        windows: above `min_speed`.
        min_speed: at which windows start [m/s].
        moving: time above that speed [s].
        speed: of its complete rows, sorted [m/s].
        start_speed: median at the starts of windows [m/s]; NaN without any.
        turning: 90 % quantile of the turn rate there [rad/s]; NaN without any.
    """

    name: str
    windows: int
    min_speed: float
    moving: float
    speed: Float[np.ndarray, " n"]
    start_speed: float
    turning: float

    @property
    def median(self) -> float:
        """Median speed of its rows [m/s]."""
        return float(np.median(self.speed))

    @property
    def words(self) -> str:
        """In a few words."""
        return f"{self.name} {self.windows} windows, median speed {self.median:.1f} m/s, {self.moving:.0f} s moving"


def part_facts(dataset: Dataset) -> tuple[PartFacts, ...]:
    """What is driven in each part that has rows; a drive too short for a split is all training."""
    wanted = [part for part in PARTS if part not in empty_parts(dataset.split)]
    return tuple(facts for part in wanted if len((facts := _facts(dataset, part)).speed))


def _facts(dataset: Dataset, part: str) -> PartFacts:
    speeds, starts, turns = [], [], []
    for drive in dataset.drives:
        mine = drive.part == PARTS.index(part)
        rows = drive.rows
        speed = np.hypot(rows.state[:, 3], rows.state[:, 4])
        first = evaluation_starts(rows, mine, dataset.min_hindsight, dataset.min_speed)
        speeds.append(speed[mine & rows.valid])
        starts.append(speed[first])
        turns.append(np.abs(rows.state[first, 5]))
    speed, start, turn = (np.concatenate(each) for each in (speeds, starts, turns))
    return PartFacts(
        part,
        len(start),
        dataset.min_speed,
        float((speed > dataset.min_speed).sum() * DT),
        np.sort(speed),
        float(np.median(start)) if len(start) else np.nan,
        float(np.quantile(turn, 0.9)) if len(turn) else np.nan,
    )


def apart(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " m"]) -> float:
    """Kolmogorov-Smirnov distance between two sorted samples: 0 alike, 1 nothing in common."""
    if not len(one) or not len(other):
        return 1.0
    at = np.concatenate((one, other))
    shares = (np.searchsorted(each, at, side="right") / len(each) for each in (one, other))
    return float(np.abs(np.subtract(*shares)).max())


def complaints(facts: Sequence[PartFacts]) -> Iterator[str]:
    """What is wrong with parts, in words; they are compared with that which trains, if there is one."""
    for part in facts:
        if part.windows < LEAST_WINDOWS:
            yield f"{part.name} has {part.windows} windows above {part.min_speed:.3g} m/s"
    train, *others = facts if facts[0].name == PARTS[0] else facts[:1]
    for part in others:
        shifted = apart(train.speed, part.speed) > MOST_APART and _ratio(train.median, part.median, _STANDING) > MEDIANS
        if shifted or _ratio(train.start_speed, part.start_speed, train.min_speed) > MOST_RATIO:
            yield f"{part.name} drives at a median of {part.median:.1f} m/s, train at {train.median:.1f} m/s"
        elif _ratio(train.turning, part.turning, _LEAST_TURN) > MOST_TURNING:
            yield f"{part.name} turns at {part.turning:.2f} rad/s (90 %), train at {train.turning:.2f} rad/s"


def _ratio(one: float, other: float, least: float) -> float:
    """The larger over the smaller of two numbers; 1 where one is not known."""
    low, high = sorted(max(value, least) for value in (one, other))
    return high / low if np.isfinite(low * high) else 1.0


def unlikeness(facts: Sequence[PartFacts]) -> float:
    """Largest distance between the speeds of training and of another part, to compare splits."""
    return max((apart(facts[0].speed, part.speed) for part in facts[1:]), default=0.0)


def candidates(split: Split) -> Iterator[Split]:
    """Other splits of the same kind; interleaved blocks and folds for blocks."""
    if split.kind == "blocks":
        shares = ",".join(f"{share:g}" for share in split.fractions)
        texts = [f"blocks:{shares}@{period}" for period in _PERIODS]
        texts += [f"fold:{number}/{_FOLDS}" for number in range(_FOLDS)] if all(split.fractions) else []
    elif split.kind == "fold":
        texts = [f"fold:{number}/{split.fold[1]}" for number in range(split.fold[1])]
    else:
        texts = [f"places:{size}" for size in _SIZES] if split.kind == "places" else []
    for text in texts:
        try:
            other = parse_split(text)
        except DatasetError:  # blocks too short for this share
            continue
        if other != split:
            yield other


def better_split(dataset: Dataset) -> tuple[Split, tuple[PartFacts, ...]] | None:
    """The split of the same kind whose parts are most alike, and its parts; None where all have something wrong."""
    parts = len(PARTS) - len(empty_parts(dataset.split))
    found = [(split, part_facts(dataset.relabelled(split))) for split in candidates(dataset.split)]
    good = [(split, facts) for split, facts in found if len(facts) == parts and not list(complaints(facts))]
    return min(good, key=lambda each: unlikeness(each[1])) if good else None


def fitting_split(drives: Sequence[StoredDrive], min_hindsight: float, min_speed: float) -> Split | None:
    """Larger parts to validate and test on, or a fold, which short drives have enough windows for; None without any.

    The first that leaves `LEAST_WINDOWS` in each part, or else that with the most in its smallest.
    """
    least = {}
    for text in _FOR_SHORT_DRIVES:
        split, counts = parse_split(text), np.zeros(len(PARTS), int)
        for drive in drives:
            rows = drive.rows
            label = split.label(drive.name, rows.state[:, :2] + rows.origin)
            for part in range(len(PARTS)):
                counts[part] += len(evaluation_starts(rows, label == part, min_hindsight, min_speed))
        least[text] = int(counts.min())
    best = max(least, key=lambda text: min(least[text], LEAST_WINDOWS))
    return parse_split(best) if least[best] else None


def trains_nothing(split: Split) -> bool:
    """Whether a split leaves nothing to train on, or to choose epochs by."""
    return bool({"train", "validation"} & set(empty_parts(split)))


def is_for_tests(split: Split) -> bool:
    """Whether all drives are given to the test part, for runs that were trained elsewhere."""
    return split.kind == "drives" and set(empty_parts(split)) == {"train", "validation"}


def lacks_windows(dataset: Dataset) -> bool:
    """Whether a part has no window that the split asks for, or that training takes."""
    facts = part_facts(dataset)
    return (
        trains_nothing(dataset.split)
        or len(facts) < len(PARTS) - len(empty_parts(dataset.split))
        or not all(part.windows for part in facts)
    )


def next_split(dataset: Dataset) -> Split | None:
    """A split to extract a dataset with instead: with parts that are alike, or none that is empty; None for none."""
    empty = lacks_windows(dataset)
    if not empty and not list(complaints(part_facts(dataset))):
        return None
    better = None if trains_nothing(dataset.split) else better_split(dataset)
    if better is not None:
        return better[0]
    if not empty or dataset.split.kind not in ("blocks", "fold"):
        return None
    return fitting_split(dataset.drives, dataset.min_hindsight, dataset.min_speed)


def has_little_driving(dataset: Dataset) -> bool:
    """Whether training holds so little that a model without a network is the one to begin with."""
    return sum(part.moving for part in part_facts(dataset) if part.name == "train") < _LITTLE


def split_warning(dataset: Dataset) -> str | None:
    """What is wrong with a dataset's split and which one is better, in one line; None where nothing is wrong."""
    facts = part_facts(dataset)
    wrong = list(complaints(facts)) if len(facts) > 1 else []
    if dataset.split.kind == "places":  # a drive too short for other splits is all training
        wrong += [f"no square is for {part}" for part in PARTS if part not in {facts.name for facts in facts}]
    if not wrong:
        return None
    line = f"the parts of the split {dataset.split.text} are too short, or unlike each other: {'; '.join(wrong)}"
    better = better_split(dataset)
    if better is None:
        how = "; record more driving"
        if len(dataset.drives) > 1:
            how += ", or give " + (
                "some drives to other parts" if dataset.split.kind == "drives" else "--split drives:FILE"
            )
        return line + how
    split, parts = better
    words = "; ".join(part.words for part in parts[1:])
    return f"{line}; better: extract again, into another --out, with --split {split.text} ({words})"
