"""Settings of a reproduction: size, data and models of each figure."""

import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import msgspec

from offpiste.core.checksums import sha256_of_folders
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import OffpisteError
from offpiste.core.parallel import at_a_time
from offpiste.dynamics.models import display_name
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.metrics import label
from offpiste.training.config import TrainConfig

BASELINE = "b"
"""Model that the others are compared with."""

Figure = Literal["fig3", "fig4"]


@dataclass(frozen=True)
class Size:
    """Amount of driving, training and evaluation.

    Attributes:
        name: value of --size.
        seconds: driving for training, validation and test, over all worlds [s].
        longest, shortest: limits of the length of a drive [s]; each world gets at least `shortest`.
        images, pca_drives: number of images for the PCA, and of drives of each world that they are from.
        snapshot_seconds: smallest time between validation and test windows with a snapshot of the map [s].
        seeds: number of runs per model.
        stride: rows between windows evaluated at recorded places; on the map, windows with a snapshot are evaluated.
        train: settings of all trainings.
        world_size, world_resolution: extent and cell size of the worlds [m].
        first_seed: seed of the first world.
        manoeuvres: whether drivers also stop, crawl, reverse and drive fast, with a gear as a control.
        portion: number of drives simulated and extracted together before their logs are removed; 0: keep logs.
        sensors: of the vehicle (`simulation.sensors.suite.sensor_suite`).
    """

    name: str
    seconds: tuple[float, float, float]
    longest: float = 120.0
    shortest: float = 12.0
    images: int = 175
    pca_drives: int = 1
    snapshot_seconds: float = 1.0
    seeds: int = 1
    stride: int = 5
    train: TrainConfig = field(default_factory=TrainConfig)
    world_size: float = 320.0
    world_resolution: float = 0.25
    first_seed: int = 1000
    manoeuvres: bool = False
    portion: int = 0
    sensors: str = "light"


SIZES = msgspec.toml.decode(Path(__file__).with_name("sizes.toml").read_text("utf-8"), type=dict[str, Size])
"""Sizes by name."""


def sized(name: str, seconds: tuple[float, float, float] | None = None, seeds: int | None = None) -> Size:
    """Return one of `SIZES`, with other lengths or number of seeds if given.

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
class ReproductionSettings:
    """Settings of `offpiste reproduce`.

    Attributes:
        figure: of the paper; both share drives and runs in one folder.
        size: amount of driving, training and evaluation.
        out: folder for everything.
        dataset: existing dataset with visual features; None: simulate drives.
        backbone: of the visual features (`offpiste.perception.backbones.open_backbone`).
        split: "drives": test on separate drives; "blocks": test on stretches of the same logs, as in the paper.
        contrast: grip contrast of the simulated worlds.
        device: of backbone and models.
        processes: number of drives or runs processed in parallel; 0: one per core.
        cluster: address of a Ray cluster for simulation and extraction; "": none.
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
    cluster: str = ""

    @property
    def data(self) -> Path:
        """Path of the dataset."""
        return self.dataset or self.out / "dataset.zarr"

    @property
    def truth(self) -> Path:
        """Path of the dataset with the true ground of the same drives, for sizes without logs."""
        return self.out / "truth.zarr"

    @property
    def runs(self) -> Path:
        """Folder of the trained runs."""
        return self.out / "runs"

    @property
    def at_a_time(self) -> int:
        """Number of processes (`parallel.at_a_time`)."""
        return at_a_time(self.processes, self.device)

    def described(self) -> dict[str, Any]:
        """Return the settings that must stay the same for results in `out` to be reused; seeds may be added."""
        size = {key: value for key, value in asdict(self.size).items() if key != "seeds"}
        if self.dataset is not None:
            return {"size": size, "dataset": sha256_of_folders(self.dataset)}
        return {
            "size": size,
            "dataset": "simulated",
            "backbone": self.backbone,
            "split": self.split,
            "contrast": self.contrast,
        }


CODES, PCA = 4, 40
"""The paper's length n of a code and its number of PCA features."""

CODES_SWEPT = (1, 2, 4, 8, 16)
PCA_SWEPT = (5, 10, 20, 40, 80)
"""Code lengths of Fig. 3b and numbers of features of Fig. 3c."""


@dataclass(frozen=True)
class FigureModel:
    """Model of a figure.

    Attributes:
        model: name in `offpiste.dynamics.MODELS`.
        codes: length n of its code.
        pca: number of the dataset's features that it reads.
        variant: difference from the standard model of this name; "" for the standard model.
    """

    model: str
    codes: int
    pca: int
    variant: str = ""

    @property
    def label(self) -> str:
        """Name of the model, and its variant if any."""
        return label(self.model, self.variant)

    def folder(self, seed: int) -> str:
        """Return the name of a run's folder."""
        return "-".join(filter(None, (self.model, self.variant.replace("=", ""), str(seed))))

    def config(self, size: Size, seed: int, device: str) -> TrainConfig:
        """Return the settings of its training."""
        return replace(size.train, model=self.model, codes=self.codes, pca=self.pca, seed=seed, device=device)


def paper_name(label: str) -> str:
    """Return a model's display name with the paper's letters: "blind (B)", "CF (n=1)" for "b", "cf (n=1)"."""
    model, space, variant = label.partition(" ")
    letters, dash, rest = model.partition("-")
    letters = letters.upper() + dash + rest
    shown = display_name(model)
    return (letters if shown == model else f"{shown} ({letters})") + space + variant


def standard_model(model: str, stored: int) -> FigureModel:
    """Return a model as in the paper, with all features if the dataset has fewer."""
    return FigureModel(model, CODES, min(PCA, stored))


def compression_sizes(stored: int) -> dict[int, FigureModel]:
    """Return the models of Fig. 3b: `cf` by the length of its code."""
    same = standard_model("cf", stored)
    return {n: same if n == CODES else replace(same, codes=n, variant=f"n={n}") for n in CODES_SWEPT}


def feature_numbers(stored: int) -> dict[int, FigureModel]:
    """Return the models of Fig. 3c: `cf` by the number of features it reads, up to those stored."""
    same = standard_model("cf", stored)
    numbers = sorted({min(n, stored) for n in PCA_SWEPT})
    return {n: same if n == same.pca else replace(same, pca=n, variant=f"pca={n}") for n in numbers}


def figure_models(figure: Figure, stored: int) -> list[FigureModel]:
    """Return the models of a figure, each once, `b` first, for a number of stored features."""
    models = [standard_model(name, stored) for name in (BASELINE, "b-hindsight", "df", "cf")]
    if figure == "fig4":
        return [*models, standard_model("dc", stored)]
    return list(dict.fromkeys([*models, *compression_sizes(stored).values(), *feature_numbers(stored).values()]))


def figure_readings(figure: Figure) -> list[Reading]:
    """Return the terrain lookups of a figure: on the map, and at recorded places by feature set."""
    sets = FEATURE_SETS if figure == "fig4" else FEATURE_SETS[:1]
    return [("map", None), *(("recorded", name) for name in sets)]
