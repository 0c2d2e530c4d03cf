"""Spread of a trained run: fitted by likelihood, stored in the run's folder, and used in predictions."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.errors import RunError
from offpiste.core.progress import track
from offpiste.core.state import Trajectory
from offpiste.dataset.feature_sets import FeatureSetChoice, drawn
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.dynamics.models import seeded
from offpiste.training.checkpoint import load_beside_weights, load_weights
from offpiste.training.prediction import Lookup, in_parts, joined, roll_out
from offpiste.training.run import Run, refuse_unfit
from offpiste.uncertainty.spread import (
    Spread,
    errors_in_heading,
    inputs_along,
    inputs_of,
    negative_log_likelihood,
    radius,
)

logger = logging.getLogger(__name__)

FILE: Final = "spread.safetensors"
"""File with the spread, in the folder of a run."""


@dataclass(frozen=True)
class SpreadSettings:
    """Settings of the fit of a spread.

    Attributes:
        windows: number of training windows, evenly spread.
        steps, batch, learning_rate: of Adam.
        seed: of initial weights, feature sets and order.
    """

    windows: int = 20_000
    steps: int = 3000
    batch: int = 512
    learning_rate: float = 3e-3
    seed: int = 0


@dataclass(frozen=True)
class Residuals:
    """Inputs of a spread for predicted windows, and the errors of the prediction.

    Attributes:
        inputs: at each moment (`spread_inputs`).
        error: along and across the predicted heading, `INTERVAL` after each moment [m].
    """

    inputs: Float[Tensor, "N K I"]
    error: Float[Tensor, "N K 2"]

    def take(self, index: np.ndarray) -> "Residuals":
        """Return the residuals of some windows."""
        chosen = torch.from_numpy(index)
        return Residuals(self.inputs[chosen], self.error[chosen])


def fit_spread(run: Run, train: Windows, validation: Windows, settings: SpreadSettings | None = None) -> Spread:
    """Fit the spread of a run's predictions.

    The network is fitted to training windows at recorded places, with feature sets drawn as in the model's training.
    Errors on maps are larger, so that a factor for all scales is fitted to validation windows with a map.
    """
    settings = settings or SpreadSettings()
    rng = np.random.default_rng(settings.seed)
    with seeded(settings.seed):
        spread = Spread(inputs_of(run.dynamics.vehicle, run.dynamics.codes))
    every = np.linspace(0, len(train) - 1, min(settings.windows, len(train))).astype(int)
    draw = MODELS[run.model].draw

    def choose(some: np.ndarray) -> FeatureSetChoice:
        return drawn(draw, rng, len(some), train.sets)

    learned = predictions_of(run, train, np.unique(every), "recorded", choose)[1]
    fit_network(spread, learned, rng, settings.steps, settings.batch, settings.learning_rate)
    fit_factor(spread, residuals_on_maps(run, validation, validation.evaluation_indices(5)))
    logger.info(
        f"spread of {run.folder.name}: {float(spread.freedom):.1f} degrees of freedom, x {float(spread.factor):.2f}"
    )
    return spread


def fit_network(
    spread: Spread, residuals: Residuals, rng: np.random.Generator, steps: int, batch: int, learning_rate: float
) -> None:
    """Fit a spread to errors by likelihood, with Adam and a cosine schedule.

    Args:
        rng: draws the batches.
    """
    spread.standardise_on(residuals.inputs)
    optimiser = torch.optim.Adam(spread.parameters(), lr=learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in track(range(steps), "fitting the spread"):
        part = residuals.take(rng.integers(0, len(residuals.error), batch))
        optimiser.zero_grad()
        _loss(spread, part).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    spread.requires_grad_(False)


def fit_factor(spread: Spread, residuals: Residuals) -> None:
    """Set the factor of all scales to its maximum likelihood."""
    candidates, losses = torch.logspace(-1, 1, 201), []
    for factor in candidates:
        spread.factor.copy_(factor)
        losses.append(float(_loss(spread, residuals)))
    spread.factor.copy_(candidates[int(np.argmin(losses))])


def _loss(spread: Spread, residuals: Residuals) -> Float[Tensor, ""]:
    return negative_log_likelihood(residuals.error, spread(residuals.inputs), spread.freedom).mean()


def residuals_on_maps(run: Run, windows: Windows, index: np.ndarray) -> Residuals:
    """Return residuals on the map at each window's start, read at predicted places."""
    return predictions_of(run, windows, index, "map")[1]


@torch.no_grad()
def predictions_of(
    run: Run,
    windows: Windows,
    index: np.ndarray,
    lookup: Lookup,
    choose: Callable[[np.ndarray], FeatureSetChoice] | None = None,
) -> tuple[Trajectory, Residuals]:
    """Return the predictions of windows and their residuals.

    Args:
        choose: chooses feature sets at recorded places; None: the windows' own.
    """
    dynamics, trajectories, residuals = run.dynamics, [], []
    for some in track(in_parts(index, windows, lookup), f"predicting with {run.folder.name}"):
        gathered = windows.gather(some, None if choose is None else choose(some))
        batch, trajectory, source = roll_out(dynamics, windows, some, lookup, gathered)
        inputs = inputs_along(dynamics.vehicle, batch.state, trajectory, batch.control, source)
        trajectories.append(trajectory)
        residuals.append(Residuals(inputs, errors_in_heading(trajectory.state, batch.target)))
        del source  # frees its maps before the next ones are read
    return joined(trajectories), joined(residuals)


@dataclass(frozen=True)
class SpreadPrediction:
    """Prediction of windows with its spread.

    Attributes:
        trajectory: predicted states and actuators, every `conventions.DT`.
        scale: of position errors along and across the predicted heading, every `spread.INTERVAL` [m].
        freedom: degrees of freedom of these errors.
    """

    trajectory: Trajectory
    scale: Float[Tensor, "B K 2"]
    freedom: float

    def region(self, probability: float) -> Float[Tensor, "B K 2"]:
        """Return the half axes, along and across the heading, of regions that contain a probability [m]."""
        return self.scale * radius(probability, self.freedom)


def predict_with_spread(run: Run, windows: Windows, lookup: Lookup = "map") -> SpreadPrediction:
    """Predict states of windows with their spread.

    Args:
        lookup: where the ground is read (`training.run.predict`).

    Raises:
        RunError: the run was trained with other features or channels than the dataset has; or its folder has no spread
            (`offpiste calibrate` makes it), or one of other weights.
        DatasetError: the map is asked for and a window does not start with one.
    """
    refuse_unfit(run, windows.dataset)
    spread = load_spread(run)
    trajectory, residuals = predictions_of(run, windows, np.arange(len(windows)), lookup)
    return SpreadPrediction(trajectory, spread(residuals.inputs), float(spread.freedom))


def load_spread(run: Run) -> Spread:
    """Read the spread in a run's folder.

    Raises:
        RunError: there is none, it is damaged, or it belongs to other weights.
    """
    path = run.folder / FILE
    if not path.exists():
        raise RunError("has no spread", where=run.folder, how="make it with `offpiste calibrate`")
    tensors, _ = load_beside_weights(path)
    with seeded(0):  # the weights are replaced
        spread = Spread(inputs_of(run.dynamics.vehicle, run.dynamics.codes))
    load_weights(spread, tensors, path)
    return spread.requires_grad_(False)
