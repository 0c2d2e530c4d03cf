"""Fitting a spread to a trained model: by likelihood on training windows, then one factor on validation's maps."""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.progress import track
from offpiste.core.state import RecordedTerrain, TerrainSource, Trajectory
from offpiste.dataset.feature_sets import FeatureSetChoice, drawn
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import MODELS, Dynamics
from offpiste.dynamics.kernels.map_rollout import predict_on
from offpiste.dynamics.models import seeded
from offpiste.training.prediction import Lookup, batch_for, encoded, in_parts, on_map, predict
from offpiste.training.run import Run
from offpiste.uncertainty.spread import Spread, errors_in_heading, inputs_along, inputs_of
from offpiste.uncertainty.student import negative_log_likelihood

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SpreadSettings:
    """How a spread is fitted.

    Attributes:
        windows: of training that it is fitted to, evenly spread.
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
    """Predicted windows: what a spread reads, and the errors that it is to predict.

    Attributes:
        inputs: `spread_inputs`.
        error: along and across the predicted heading, `INTERVAL` after each of them [m].
    """

    inputs: Float[Tensor, "N K I"]
    error: Float[Tensor, "N K 2"]

    def take(self, index: np.ndarray) -> "Residuals":
        """Some of the windows."""
        chosen = torch.from_numpy(index)
        return Residuals(self.inputs[chosen], self.error[chosen])


def fit_spread(run: Run, train: Windows, validation: Windows, settings: SpreadSettings | None = None) -> Spread:
    """The spread of a run's predictions.

    The network learns on training windows at recorded places, from feature sets as the model drew them. Errors where
    the model is used are larger: a factor for all scales is fitted on the map windows of validation.
    """
    settings = settings or SpreadSettings()
    rng = np.random.default_rng(settings.seed)
    with seeded(settings.seed):
        spread = Spread(inputs_of(run.dynamics.vehicle, run.dynamics.codes))
    every = np.linspace(0, len(train) - 1, min(settings.windows, len(train))).astype(int)
    learned = residuals_at_recorded(run, train, np.unique(every), rng)
    fit_network(spread, learned, rng, settings.steps, settings.batch, settings.learning_rate)
    fit_factor(spread, residuals_on_maps(run, validation, validation.evaluation_indices(5)))
    logger.info(
        f"spread of {run.folder.name}: {float(spread.freedom):.1f} degrees of freedom, x {float(spread.factor):.2f}"
    )
    return spread


def fit_network(
    spread: Spread, residuals: Residuals, rng: np.random.Generator, steps: int, batch: int, learning_rate: float
) -> None:
    """Fit a spread to errors by likelihood: batches of windows, Adam, a cosine down to zero.

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
    """Set the factor of all scales to the one under which these errors are likeliest."""
    candidates = torch.logspace(-1, 1, 201)
    losses = []
    for factor in candidates:
        spread.factor.copy_(factor)
        losses.append(_loss(spread, residuals).detach())
    spread.factor.copy_(candidates[int(torch.stack(losses).argmin())])


def _loss(spread: Spread, residuals: Residuals) -> Float[Tensor, ""]:
    return negative_log_likelihood(residuals.error, spread(residuals.inputs), spread.freedom).mean()


def residuals_at_recorded(run: Run, windows: Windows, index: np.ndarray, rng: np.random.Generator) -> Residuals:
    """Predictions along the recorded path, whose ground is seen as the model's training drew it."""
    draw = MODELS[run.model].draw

    def choose(some: np.ndarray) -> FeatureSetChoice:
        return drawn(draw, rng, len(some), windows.sets)

    return _joined([residuals for _, residuals in predictions_of(run, windows, index, "recorded", choose)])


def residuals_on_maps(run: Run, windows: Windows, index: np.ndarray) -> Residuals:
    """Predictions on the map as it was when each window started, read at predicted places."""
    return _joined([residuals for _, residuals in predictions_of(run, windows, index, "map")])


def predictions_of(
    run: Run,
    windows: Windows,
    index: np.ndarray,
    lookup: Lookup,
    choose: Callable[[np.ndarray], FeatureSetChoice] | None = None,
) -> Iterator[tuple[Trajectory, Residuals]]:
    """Some windows after the other: what is predicted, and what a spread reads of it.

    Args:
        choose: feature sets of some windows, read at recorded places; by default the windows' own.
    """
    for some in track(in_parts(index, windows, lookup), f"predicting with {run.folder.name}"):
        yield _predictions_of(run.dynamics, windows, some, lookup, choose(some) if choose is not None else None)


@torch.no_grad()
def _predictions_of(
    dynamics: Dynamics, windows: Windows, index: np.ndarray, lookup: Lookup, choice: FeatureSetChoice | None
) -> tuple[Trajectory, Residuals]:
    batch = encoded(dynamics, batch_for(dynamics, windows, windows.gather(index, choice)))
    source: TerrainSource = RecordedTerrain(batch.terrain)
    if lookup == "map":
        batch, source = on_map(dynamics, windows, index, batch)
        start = dynamics.start(batch.history, batch.state, batch.actuators)
        trajectory = predict_on(dynamics, start, batch.control, source)
    else:
        trajectory = predict(dynamics, batch)
    return trajectory, _residuals(dynamics, batch, trajectory, source)


def _residuals(dynamics: Dynamics, batch: Batch, trajectory: Trajectory, source: TerrainSource) -> Residuals:
    inputs = inputs_along(dynamics.vehicle, batch.state, trajectory, batch.control, source)
    return Residuals(inputs, errors_in_heading(trajectory.state, batch.target))


def _joined(parts: list[Residuals]) -> Residuals:
    return Residuals(torch.cat([part.inputs for part in parts]), torch.cat([part.error for part in parts]))
