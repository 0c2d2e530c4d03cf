"""Train, evaluate and write the models that ship with offpiste, each with its card.

    python -m experiments.pretrained_models --reproduction results/ --controls controls/

finishes `offpiste reproduce fig4 --size evening` in `--reproduction` where it is not, trains what ships on its drives,
for longer than its figures, takes of each model the run with the least validation loss, and replaces `--out`.
`python -m experiments.closed_loop_table --cards` adds how planners drive with them.
"""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from jaxtyping import Bool

from experiments.command import run
from experiments.control_experiments.reproduced import Reproduced, open_reproduction
from experiments.control_experiments.runs import trained_seeds
from experiments.control_experiments.strata import strata
from experiments.gains import errors_of, runs_of, same_windows
from offpiste._version import commit, today
from offpiste.core.conventions import DT
from offpiste.core.errors import RunError
from offpiste.core.shipped import PCA
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.intervals import PairedDifference, Sampling, relative, summary
from offpiste.evaluation.model_card import GroupFigures, ModelCard, write_card
from offpiste.reproduction.reproduce import reproduce
from offpiste.reproduction.results import MAP
from offpiste.reproduction.runs import evaluation_windows
from offpiste.reproduction.settings import ReproductionSettings, sized
from offpiste.reproduction.steps import claim_folder
from offpiste.training.checkpoint import WEIGHTS, load_json, save_json
from offpiste.training.run import Run
from offpiste.uncertainty.calibration import kept_or_fitted
from offpiste.uncertainty.fit import FILE as SPREAD
from offpiste.uncertainty.novelty import FILE as MEMORY_BANK
from offpiste.uncertainty.novelty import keep_memory_bank

FAMILY: Final = "proving-ground"
BASELINE: Final = "b"
FEWEST: Final = 30
"""Groups of fewer windows are left out."""

ABOUT: Final = {
    "parametric": "Actuator lags and a dynamic bicycle with fitted constants; it does not see the ground.",
    "b": "`parametric` with its forces corrected by a recurrent network that does not see the ground: the baseline.",
    "dc": "`b` that reads visual terrain features under each wheel, trained on features from random viewing distances.",
    "oracle": "`df` on the simulator's own friction, stiffness and resistances: what knowing the ground could bring.",
}
LOOKUP: Final = {"oracle": "the whole map of the true ground, which no vehicle has"}
"""Map on which a model's ground is read; without an entry, the vehicle's."""
NOT_FOR: Final = (
    "A real vehicle. All data are simulated: one vehicle of 1150 kg, its poses without drift, its "
    "sensors mounted as said and in time.",
    "Other mountings, image sizes or backbones than those of the rig `proving_ground`, where a model sees the ground.",
    "Speeds above 12 m/s, which training hardly holds.",
    "A safety function of any kind. Rollovers and collisions are not among what it predicts.",
)


@dataclass(frozen=True)
class PretrainedModels:
    """Train, evaluate and write the models that ship; what is finished is used again."""

    reproduction: Path = Path("results")
    """Folder of `offpiste reproduce fig4`, of the size and seeds below."""
    size: Literal["evening", "day"] = "evening"
    """Size, as of `reproduce`: with drives at all speeds and in reverse."""
    seeds: int | None = None
    """Runs of every model, instead of the size's."""
    controls: Path = Path("controls")
    """Folder of the control experiments; what is trained here goes to `shipped` in it."""
    epochs: int = 48
    """Epochs of the models that ship: with the reproduction's 12, `b` still gets better (docs/results.md)."""
    out: Path = Path("src/offpiste/pretrained_models") / FAMILY
    """Folder that is replaced."""

    def run(self) -> str:
        """Train missing models, choose, evaluate, write."""
        reproduce(ReproductionSettings("fig4", sized(self.size, seeds=self.seeds), self.reproduction))
        of = open_reproduction(self.reproduction)
        claim_folder(self.controls, {"reproduction": str(self.reproduction.resolve())})
        models = list(candidates(of, self.controls, self.epochs))
        windows = Windows(of.dataset, "test")
        index = evaluation_windows(windows, MAP, of.size.stride)
        groups = {"all": np.ones(len(index), bool), **strata(windows, index)}
        shutil.rmtree(self.out, ignore_errors=True)
        blind = next(model for model in models if model.name == BASELINE)
        for model in models:
            keep_uncertainty(model.best, of.size.train.min_speed)
            copy_run(model.best.folder, self.out / model.name)
            write_card(self.out / model.name, card_of(model, None if model is blind else blind, groups, of.dataset))
        shutil.copy(of.pca, self.out / PCA)
        return f"written: {self.out}"


@dataclass(frozen=True)
class Candidates:
    """Runs of a model, of which the best ships.

    Attributes:
        name: under which it ships.
        runs, errors: by seed; errors on the map, on the same windows for all models.
    """

    name: str
    runs: Sequence[Run]
    errors: Sequence[Errors]

    @property
    def chosen(self) -> int:
        """Index of the run with the smallest validation loss."""
        return int(np.argmin([validation_loss(each.folder) for each in self.runs]))

    @property
    def best(self) -> Run:
        """The run that ships."""
        return self.runs[self.chosen]


def candidates(of: Reproduced, controls: Path, epochs: int) -> Iterator[Candidates]:
    """Yield all models that ship, trained and evaluated on the reproduction's test windows.

    Args:
        epochs: of each.
    """
    windows, size, folder = Windows(of.dataset, "test"), of.size, controls / "shipped"
    index = evaluation_windows(windows, MAP, size.stride)
    truth = of.true_ground(controls / "oracle")
    true_windows = Windows(truth, "test")
    there = same_windows(windows, index, true_windows)
    for name in ABOUT:
        knowing = name == "oracle"
        config = replace(of.member("df" if knowing else name).config(size, 0, "cpu"), epochs=epochs)
        config = replace(config, pca=0) if knowing else config  # all that the truth has, which is no PCA's
        dataset, runs = (truth, folder / "oracle") if knowing else (of.dataset, folder / "runs")
        stages = controls / "oracle" / "runs" if knowing else of.folder / "runs"
        trained = trained_seeds(dataset, config, runs, size.seeds, stages=stages)
        mine, places = (true_windows, there) if knowing else (windows, index)
        kept = folder / "evaluated" / ("oracle" if knowing else "")
        yield Candidates(
            name, trained, [errors_of(each, mine, places, MAP, scale=of.scale, kept=kept) for each in trained]
        )


def validation_loss(folder: Path) -> float:
    """Return the smallest validation loss of a run's last stage.

    Raises:
        RunError: the run has no record of it.
    """
    path = folder / "metrics.jsonl"
    try:
        lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
        return min(float(line["validation_loss"]) for line in lines if line["stage"] == lines[-1]["stage"])
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise RunError(f"has no validation loss ({error!r})", where=path, how="train again") from error


def card_of(
    model: Candidates,
    blind: Candidates | None,
    groups: Mapping[str, Bool[np.ndarray, " n"]],
    dataset: Dataset,
) -> ModelCard:
    """Return the card of the run that ships.

    Args:
        blind: baseline of the comparison.
        groups: masks of the evaluated windows by name: all, by speed, by kind of world.
    """
    base = None if blind is None else [blind.errors[blind.chosen]]
    mine = [model.errors[model.chosen]]
    figures = [figures_of(name, mine, base, chosen) for name, chosen in groups.items() if chosen.sum() >= FEWEST]
    seconds = [DT * sum(int((drive.part == part).sum()) for drive in dataset.drives) for part in range(len(PARTS))]
    counts = [sum(bool((drive.part == part).any()) for drive in dataset.drives) for part in range(len(PARTS))]
    kind = "simulated driving, every drive in a world of its own"
    return ModelCard(
        name=f"{FAMILY}/{model.name}",
        about=ABOUT[model.name],
        trained_on=f"{seconds[0] / 60:.0f} minutes of {kind} ({counts[0]} worlds); epochs were chosen on"
        f" {seconds[1] / 60:.0f} minutes in {counts[1]} other worlds",
        evaluated_on=f"{seconds[2] / 60:.0f} minutes of {kind} ({counts[2]} worlds), none of them trained or chosen on",
        lookup=LOOKUP.get(model.name, "the map as the vehicle had it"),
        seed=model.best.seed,
        seeds=tuple(each.seed for each in model.runs),
        commit=commit(),
        date=today(),
        figures=tuple(figures),
        over_seeds=figures_of("all", model.errors, None if blind is None else blind.errors, groups["all"]),
        not_for=NOT_FOR,
        warnings=tuple(dataset.findings),
    )


def figures_of(
    name: str, mine: Sequence[Errors], base: Sequence[Errors] | None, chosen: Bool[np.ndarray, " n"]
) -> GroupFigures:
    """Return the figures of some of the windows, over all given runs.

    Args:
        base: of the baseline, with as many seeds.
    """
    index = np.flatnonzero(chosen)
    errors = runs_of([each.take(index) for each in mine])
    drawn = Sampling().on(errors)
    error = summary(errors.distance(), drawn)
    gain = None
    if base is not None:
        gain = relative(errors.distance(), runs_of([each.take(index) for each in base]).distance(), drawn)
    levels = drawn.levels(len(errors.seeds))
    return GroupFigures(name, len(index), levels, PairedDifference(error.mean, error.ci95), gain)


def keep_uncertainty(run: Run, min_speed: float | None) -> None:
    """Keep a run's spread with it and, if it sees the ground, features of training's (`offpiste calibrate`)."""
    dataset = open_dataset(load_json(run.folder / "model.json")["dataset"]).starting_above(min_speed)
    kept_or_fitted(run, dataset)
    if run.pca is not None and run.dynamics.encoder is not None:
        keep_memory_bank(run, dataset)


def copy_run(run_folder: Path, to: Path) -> None:
    """Copy weights, uncertainty and description, without paths of the machine that trained them."""
    to.mkdir(parents=True)
    for name in (WEIGHTS, SPREAD, MEMORY_BANK):
        if (run_folder / name).exists():
            shutil.copy(run_folder / name, to / name)
    about = load_json(run_folder / "model.json")
    features = list(open_dataset(about["dataset"]).features)
    save_json(to / "model.json", {**about, "dataset": "", "split": "drives:parts.txt", "features": features})


if __name__ == "__main__":
    run(PretrainedModels)
