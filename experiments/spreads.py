"""How is it best predicted how far predictions stray? By several seeds, by a fitted spread, and by both.

All centre on positions: the fitted spread on its own run's prediction, the others on the mean of the runs. An ensemble
gives the deviation of its members; as it is, that is a Gaussian's. Calibrated, it is scaled and widened by a share of
the error at that moment, as an errors' Student t, by likelihood on the validation part; both together likewise.
"""

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize

from experiments.command import run
from offpiste.core.conventions import HORIZON_STEPS
from offpiste.core.errors import RunError
from offpiste.core.files import write_text
from offpiste.core.geometry import planar_body_from_world
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_windows import EvaluatedWindows, members
from offpiste.evaluation.intervals import Sampling
from offpiste.training.prediction import in_parts
from offpiste.training.run import Run, load_run, refuse_seen, refuse_unfit
from offpiste.uncertainty.calibration import (
    CalibrationRow,
    ErrorsWithScales,
    calibration_rows,
    calibration_table,
    kept_or_fitted,
)
from offpiste.uncertainty.fit import SpreadSettings, predictions_of
from offpiste.uncertainty.novelty import FILE, load_memory_bank
from offpiste.uncertainty.spread import EVERY, Spread, negative_log_likelihood

logger = logging.getLogger("experiments")

GAUSSIAN: Final = 1e6
"""Degrees of freedom of what is Gaussian."""

NOVEL: Final = 0.1
"""Share of the ground along a window that is novel, from which on it counts as one on novel ground."""

MOMENTS: Final = slice(EVERY - 1, HORIZON_STEPS, EVERY)
"""Steps of a rollout at whose end spreads are known."""


@dataclass(frozen=True)
class Members:
    """Predictions of several runs for the same windows, at the moments of a spread.

    Attributes:
        place: [m]; scale: of each run's own spread, along and across its heading [m].
        heading: [rad].
        target: recorded places [m].
        speed: at the start [m/s].
    """

    place: Float[np.ndarray, "S N K 2"]
    scale: Float[np.ndarray, "S N K 2"]
    heading: Float[np.ndarray, "S N K"]
    target: Float[np.ndarray, "N K 2"]
    speed: Float[np.ndarray, " N"]


@dataclass(frozen=True)
class Widening:
    """How deviations become scales: sqrt((factor deviation)² + (floor error)²).

    Attributes:
        error: root mean square at each moment, on validation [m].
        freedom: degrees of freedom of the errors.
    """

    factor: float
    floor: float
    freedom: float
    error: Float[np.ndarray, " K"]

    def scale(self, deviation: Float[np.ndarray, "N K 2"]) -> Float[np.ndarray, "N K 2"]:
        """Scales of errors [m]."""
        return np.hypot(self.factor * deviation, (self.floor * self.error)[:, None])


@dataclass(frozen=True)
class Spreads:
    """Ensemble, fitted spread or both? Predicts, fits on the validation part and evaluates on the test part."""

    runs: tuple[Path, ...]
    """One model, trained with different seeds."""
    dataset: Path
    """Dataset that they were trained on."""
    held_out: tuple[Path, ...] = ()
    """Datasets of ground that no training drive had; nothing is fitted to them."""
    out: Path = Path("spreads")
    """Folder of the table and the numbers."""
    quick: bool = False
    """Fit spreads in a second, to try the command."""

    def run(self) -> str:
        """Compare, write and show the tables.

        Raises:
            RunError: less than two runs, or they differ in more than their seed.
        """
        runs = [load_run(folder) for folder in self.runs]
        if len(runs) < 2 or len({run.model for run in runs}) > 1:
            raise RunError(f"{len(runs)} runs of the models {', '.join(sorted({r.model for r in runs}))}",
                           how="give two runs or more of one model, trained with different --seed")  # fmt: skip
        dataset = open_dataset(self.dataset)
        quick = SpreadSettings(windows=64, steps=20, batch=32) if self.quick else None
        spreads = [kept_or_fitted(each, dataset, quick) for each in runs]
        ways = validated_ways(runs, spreads, dataset)
        tables, rows = [], dict[str, list[CalibrationRow]]()
        for path in (self.dataset, *self.held_out):
            there = open_dataset(path)
            for each in runs:
                refuse_unfit(each, there)
                refuse_seen(each, there, "test")
            windows = Windows(there, "test")
            index = windows.evaluation_indices(5)
            found = members_of(runs, spreads, windows, index)
            located = EvaluatedWindows(there, windows.drive[index], windows.row_in_drive(index))
            groups = members(located) | novel_windows(runs[0], windows, index)
            drawn = Sampling().on(located)
            rows[path.name] = [
                row
                for name, errors in errors_by_ways(found, ways, float(spreads[0].freedom)).items()
                for row in calibration_rows(name, errors, groups, drawn)
            ]
            tables.append((path.name, calibration_table(rows[path.name])))
        content = {name: msgspec.to_builtins(each) for name, each in rows.items()}
        write_text(self.out / "spreads.json", json.dumps({"schema": 1, "rows": content}, indent=1))
        write_text(self.out / "spreads.md", "\n".join(f"## {name}\n\n{t.markdown()}" for name, t in tables))
        shown = "\n".join(f"{name}\n{t.text(width=150)}" for name, t in tables)
        return f"{shown}\nwritten: {self.out / 'spreads.md'}"


def validated_ways(runs: Sequence[Run], spreads: Sequence[Spread], dataset: Dataset) -> dict[str, Widening]:
    """How each way widens, by likelihood on the windows of a dataset's validation that have a map."""
    windows = Windows(dataset, "validation")
    return fitted_ways(members_of(runs, spreads, windows, windows.evaluation_indices(5)))


def members_of(
    runs: Sequence[Run], spreads: Sequence[Spread], windows: Windows, index: Int[np.ndarray, " N"]
) -> Members:
    """Predictions of all runs for windows that have a map."""
    target = np.concatenate([windows.gather(some).target[:, MOMENTS, :2].numpy() for some in _parts(windows, index)])
    place, scale, heading = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for each, spread in zip(runs, spreads, strict=True):
        found = list(predictions_of(each, windows, index, "map"))
        state = torch.cat([trajectory.state[:, MOMENTS] for trajectory, _ in found]).numpy()
        place.append(state[..., :2])
        heading.append(state[..., 2])
        scale.append(torch.cat([spread(residuals.inputs).detach() for _, residuals in found]).numpy())
        speed = torch.cat([residuals.inputs[:, 0, 0] for _, residuals in found]).numpy()
    return Members(np.stack(place), np.stack(scale), np.stack(heading), target, speed)


def _parts(windows: Windows, index: Int[np.ndarray, " N"]) -> list[np.ndarray]:
    return list(in_parts(index, windows, "map"))


def mean_of(found: Members) -> tuple[Float[np.ndarray, "N K 2"], Float[np.ndarray, "N K 2"]]:
    """Error of the members' mean, and their deviation from it, along and across its heading [m]."""
    heading = np.arctan2(np.sin(found.heading).mean(axis=0), np.cos(found.heading).mean(axis=0))
    mean = found.place.mean(axis=0)
    apart = planar_body_from_world(found.place - mean, np.broadcast_to(heading, found.heading.shape))
    return planar_body_from_world(found.target - mean, heading), apart.std(axis=0, ddof=1)


def deviations(found: Members) -> dict[str, Float[np.ndarray, "N K 2"]]:
    """What calibrated ways predict from: the members' deviation, and that with their own spreads [m]."""
    deviation = mean_of(found)[1]
    return {"ensemble": deviation, "both": np.sqrt(np.square(deviation) + np.square(found.scale).mean(axis=0))}


def fitted_ways(validation: Members) -> dict[str, Widening]:
    """How each way widens, by likelihood on the windows of validation."""
    error = mean_of(validation)[0]
    return {name: widened(deviation, error) for name, deviation in deviations(validation).items()}


def widened(deviation: Float[np.ndarray, "N K 2"], error: Float[np.ndarray, "N K 2"]) -> Widening:
    """The widening under which errors are likeliest."""
    size = np.sqrt(np.square(error).mean(axis=(0, 2)))

    def widening(logarithms: np.ndarray) -> Widening:
        factor, floor, beyond = np.exp(np.clip(logarithms, -7, 7))
        return Widening(float(factor), float(floor), 2 + float(beyond), size)

    def loss(logarithms: np.ndarray) -> float:
        way = widening(logarithms)
        error_there, scale = (torch.from_numpy(np.asarray(part, np.float64)) for part in (error, way.scale(deviation)))
        freedom = torch.tensor(way.freedom, dtype=torch.float64)
        return float(negative_log_likelihood(error_there, scale, freedom).mean())

    return widening(minimize(loss, np.log([1.0, 0.3, 3.0]), method="Nelder-Mead").x)


def errors_by_ways(found: Members, ways: dict[str, Widening], freedom: float) -> dict[str, ErrorsWithScales]:
    """What each way predicts for the same windows.

    Args:
        freedom: of the first run's spread.
    """
    error, deviation = mean_of(found)
    own = planar_body_from_world(found.target - found.place[0], found.heading[0])
    errors = {
        "fitted": ErrorsWithScales(own, found.scale[0], freedom, found.speed),
        "ensemble as it is": ErrorsWithScales(error, np.maximum(deviation, 1e-6), GAUSSIAN, found.speed),
    }
    for name, given in deviations(found).items():
        errors[name] = ErrorsWithScales(error, ways[name].scale(given), ways[name].freedom, found.speed)
    return errors


def novel_windows(first: Run, windows: Windows, index: Int[np.ndarray, " N"]) -> dict[str, Bool[np.ndarray, " N"]]:
    """Windows whose recorded ground is novel to a run; none where it reads no features or keeps none of training's."""
    if first.dynamics.encoder is None or not (first.folder / FILE).exists():
        return {}
    bank, share = load_memory_bank(first), list[torch.Tensor]()
    for some in _parts(windows, index):
        ground = windows.gather(some).ground
        assert ground is not None
        novel = ground.valid.clone()
        novel[ground.valid] = bank.novel(ground.features[ground.valid])
        share.append(novel[ground.ahead].float().mean(dim=(1, 2)))
    mine = (torch.cat(share) >= NOVEL).numpy()
    return {"novel ground": mine, "known ground": ~mine} if mine.any() and not mine.all() else {}


if __name__ == "__main__":
    run(Spreads)
