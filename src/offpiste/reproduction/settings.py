"""How large a reproduction of the paper's figures is, and what it is of.

Which models a figure is of, and which of them are the same.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from offpiste.conventions import FEATURE_SETS
from offpiste.errors import OffpisteError
from offpiste.evaluation.metrics import label
from offpiste.parallel import usable_cores
from offpiste.training.config import TrainConfig

BASELINE = "b"

Figure = Literal["fig3", "fig4"]


@dataclass(frozen=True)
class Size:
    """How much is driven, trained and judged.

    Attributes:
        name: how a person asks for it.
        seconds: of driving to train, validate and test on, over all worlds [s].
        longest, shortest: of one drive [s]; a world whose share is less than `shortest` gets that much.
        images: that the PCA is fitted on.
        pca_drives: of each world that the PCA may look at.
        snapshot_seconds: the map is kept for windows that validate and test, at most once in so long [s].
        seeds: runs of `b`, `cf` and `dc`; other models have one.
        stride: rows between the windows that are judged at recorded places; on the map, those with a snapshot are.
        train: settings of all trainings.
        world_size, world_resolution: [m].
    """

    name: str
    seconds: tuple[float, float, float]
    longest: float = 120.0
    shortest: float = 12.0
    images: int = 175
    pca_drives: int = 1
    snapshot_seconds: float = 0.5
    seeds: int = 1
    stride: int = 5
    train: TrainConfig = field(default_factory=TrainConfig)
    world_size: float = 320.0
    world_resolution: float = 0.25


SIZES = {
    "smoke": Size(
        "smoke",
        (140.0, 40.0, 80.0),
        images=40,
        snapshot_seconds=1.0,
        stride=25,
        train=TrainConfig(epochs=8, bicycle_epochs=8, actuator_epochs=4, batch=64),
        world_size=200.0,
        world_resolution=0.5,
    ),
    "laptop": Size(
        "laptop",
        (2400.0, 300.0, 900.0),
        snapshot_seconds=1.0,
        seeds=3,
        train=TrainConfig(epochs=12, bicycle_epochs=8, batch=128),
    ),
    "paper": Size(
        "paper",
        (42_000.0, 2_600.0, 5_300.0),
        pca_drives=4,
        seeds=3,
        stride=1,
        train=TrainConfig(epochs=30, bicycle_epochs=5, batch=1024, stride=1),
    ),
}
"""`smoke` ends within minutes, `laptop` within two hours, `paper` has some 2M windows to train and 250k to test."""


def sized(name: str, seconds: tuple[float, float, float] | None = None, seeds: int | None = None) -> Size:
    """One of `SIZES`, with other lengths or another number of seeds where they are given.

    Raises:
        OffpisteError: nothing to drive or train.
    """
    size = SIZES[name]
    if seconds is not None:
        if not all(0 < each < math.inf for each in seconds):
            raise OffpisteError(f"--seconds {seconds[0]:g} {seconds[1]:g} {seconds[2]:g}", how="give three above 0")
        size = replace(size, seconds=seconds)
    if seeds is not None:
        if seeds < 1:
            raise OffpisteError(f"--seeds {seeds}", how="give 1 or more")
        size = replace(size, seeds=seeds)
    return size


@dataclass(frozen=True)
class Reproduction:
    """What is reproduced.

    Attributes:
        figure: of the paper; both share drives and runs in one folder.
        size: how large.
        out: folder for everything.
        dataset: with visual features, to take instead of simulating.
        backbone: of the visual features (`offpiste.perception.backbones.open_backbone`).
        split: "drives": tests on drives of their own; "blocks": on stretches of the same logs, as the paper does.
        contrast: of grip in the simulated worlds.
        device: that backbone and models run on.
        processes: drives simulated or extracted, and runs trained or judged, at a time; 0: one a core.
    """

    figure: Figure
    size: Size
    out: Path
    dataset: Path | None = None
    backbone: str = "filterbank"
    split: Literal["drives", "blocks"] = "drives"
    contrast: float = 1.0
    device: str = "cpu"
    processes: int = 0

    @property
    def data(self) -> Path:
        """The dataset."""
        return self.dataset or self.out / "dataset.zarr"

    @property
    def runs(self) -> Path:
        """Folder of the trained models."""
        return self.out / "runs"

    @property
    def times(self) -> Path:
        """What each piece took, a line of JSON each."""
        return self.out / "pieces.jsonl"

    @property
    def at_a_time(self) -> int:
        """Processes; one where an accelerator is shared."""
        return (self.processes or usable_cores()) if self.device == "cpu" else 1

    def described(self) -> dict[str, Any]:
        """What must be the same for pieces in `out` to be used again."""
        if self.dataset is not None:
            return {"size": asdict(self.size), "dataset": str(self.dataset.resolve())}
        return {
            "size": asdict(self.size),
            "dataset": "simulated",
            "backbone": self.backbone,
            "split": self.split,
            "contrast": self.contrast,
        }


CODES, PCA = 4, 40
"""The paper's n and its number of PCA features."""

CODES_SWEPT = (1, 2, 4, 8, 16)
PCA_SWEPT = (5, 10, 20, 40, 80)
"""Fig. 3b and 3c."""

SEEDED = ("b", "cf", "dc")
"""Models with several seeds."""


@dataclass(frozen=True)
class Member:
    """A model of a figure.

    Attributes:
        model: its name in `offpiste.dynamics.MODELS`.
        codes: length of its code.
        pca: how many of the dataset's features it reads.
        variant: what tells it from the usual one of its name; empty for that one.
    """

    model: str
    codes: int
    pca: int
    variant: str = ""

    @property
    def label(self) -> str:
        """Name and variant."""
        return label(self.model, self.variant)

    def folder(self, seed: int) -> str:
        """Name of a run's folder."""
        return "-".join((self.model, *filter(None, (self.variant.replace(" ", "-").replace("=", ""),)), str(seed)))

    def config(self, size: Size, seed: int, device: str) -> TrainConfig:
        """Settings of its training."""
        return replace(size.train, model=self.model, codes=self.codes, pca=self.pca, seed=seed, device=device)

    def seeds(self, size: Size) -> range:
        """Of its runs."""
        return range(size.seeds if self.model in SEEDED and not self.variant else 1)


def usual(model: str, stored: int) -> Member:
    """A model as in the paper, or with as many features as there are."""
    return Member(model, CODES, min(PCA, stored))


def compression_sizes(stored: int) -> dict[int, Member]:
    """Fig. 3b: `cf` by the length of its code."""
    same = usual("cf", stored)
    return {n: same if n == CODES else replace(same, codes=n, variant=f"n={n}") for n in CODES_SWEPT}


def feature_numbers(stored: int) -> dict[int, Member]:
    """Fig. 3c: `cf` by the number of features that it reads; none beyond what the dataset stores."""
    same = usual("cf", stored)
    numbers = sorted({min(n, stored) for n in PCA_SWEPT})
    return {n: same if n == same.pca else replace(same, pca=n, variant=f"pca={n}") for n in numbers}


def members(figure: Figure, stored: int) -> list[Member]:
    """The models of a figure, `b` first, each once.

    Args:
        stored: how many features the dataset has.
    """
    if figure == "fig4":
        return [usual(name, stored) for name in ("b", "df", "cf", "dc")]
    swept = [*compression_sizes(stored).values(), *feature_numbers(stored).values()]
    return list(dict.fromkeys([usual(name, stored) for name in ("b", "df", "cf")] + swept))


def feature_sets(figure: Figure) -> Sequence[str]:
    """That models read at recorded places."""
    return FEATURE_SETS if figure == "fig4" else FEATURE_SETS[:1]
