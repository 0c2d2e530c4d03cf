"""Ground that looks different and drives alike: features carry no information, and no gain may remain."""

from dataclasses import dataclass, replace
from pathlib import Path

from experiments.control_experiments.data import driven_dataset, planned
from experiments.control_experiments.models import trained_seeds
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import write_control
from offpiste.dataset.windows import Windows
from offpiste.reproduction.gains import HINDSIGHT, MAP, errors_of, evaluation_index, gain, gain_table

ABOUT = (
    "World `uniform`: looks vary, grip does not. Models trained there, visual features, other worlds to test than to "
    "train; 95 % intervals. The map, read at predicted places, decides; recorded places show how "
    "far the vehicle went."
)


@dataclass(frozen=True)
class UniformDrives:
    """How much is driven.

    Attributes:
        train, validation, test: lengths of the drives [s].
    """

    train: tuple[float, ...] = (100.0, 100.0, 100.0)
    validation: tuple[float, ...] = (60.0,)
    test: tuple[float, ...] = (45.0, 45.0, 45.0, 45.0)


FIRST_SEED = 3000


def uniform_control(of: Reproduced, out: Path, drives: UniformDrives, seeds: int) -> Path:
    """Simulate, train and evaluate b, cf and dc on uniform ground, with the reproduction's PCA and settings."""
    folder = out / "uniform"
    lengths = (drives.train, drives.validation, drives.test)
    dataset = driven_dataset(planned("uniform", lengths, seed=FIRST_SEED, sensors="light"), folder, pca=of.pca)
    windows, gains = Windows(dataset, "test"), []
    member = of.member("b")
    config = replace(member.config(of.size, 0, "cpu"), pca=min(member.pca, len(dataset.features)))
    runs = {
        model: trained_seeds(dataset, replace(config, model=model), folder / "runs", seeds)
        for model in ("b", "cf", "dc")
    }
    scale = runs["b"][0].scale
    for reading in (MAP, HINDSIGHT):
        index = evaluation_index(windows, reading, of.size.stride)
        errors = {
            model: [errors_of(run, windows, index, reading, scale=scale, kept=folder / "evaluated") for run in mine]
            for model, mine in runs.items()
        }
        gains += [gain("uniform", model, errors[model], errors["b"], reading) for model in ("cf", "dc")]
    table = gain_table("Uniform ground", gains, ABOUT)
    return write_control(folder, [table], {"control": "uniform", "drives": drives.__dict__, "gains": gains})
