"""Predictions with slow context (`dynamics.slow_context`) along recorded drives, as a vehicle would have made them."""

import numpy as np
import torch
from jaxtyping import Float, Int

from offpiste.dataset.windows import Windows
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.slow_context import ContextSettings, shifted
from offpiste.evaluation.errors import Errors, Progress, no_progress, prediction_errors, trajectories
from offpiste.training.prediction import Lookup
from offpiste.training.short_errors import shifts_of, short_errors


def errors_with_context(
    dynamics: Dynamics,
    windows: Windows,
    index: Int[np.ndarray, " n"],
    noise: Float[np.ndarray, " 3"],
    *,
    lookup: Lookup | None,
    scale: torch.Tensor,
    weights: Float[torch.Tensor, " 5"],
    settings: ContextSettings | None = None,
    track: Progress = no_progress,
    description: str = "predicting with context",
) -> tuple[Errors, Float[np.ndarray, "n F"]]:
    """Errors of windows, each predicted with the constants shifted by what its drive had shown until then.

    Returns:
        the errors, and the shifts.
    """
    shifts = _shifts(dynamics, windows, index, noise, settings)
    found = [
        prediction_errors(shifted(dynamics, shift), windows, one, weights=weights, lookup=lookup, scale=scale)
        for one, shift in track(list(zip(index[:, None], shifts, strict=True)), description)
    ]
    values, losses = (np.concatenate([getattr(each, name) for each in found]) for name in ("values", "loss"))
    return Errors(windows.drive[index], windows.row_in_drive(index), values, losses), shifts


def trajectories_with_context(
    dynamics: Dynamics,
    windows: Windows,
    index: Int[np.ndarray, " n"],
    noise: Float[np.ndarray, " 3"],
    *,
    lookup: Lookup | None,
) -> Float[np.ndarray, "n T 6"]:
    """Predicted states whose errors `errors_with_context` gives, positions relative to each window's start."""
    states = np.empty((len(index), windows.horizon, 6))
    for number, shift in enumerate(_shifts(dynamics, windows, index, noise)):
        states[number] = trajectories(shifted(dynamics, shift), windows, index[number : number + 1], lookup=lookup)[0]
    return states


def _shifts(
    dynamics: Dynamics,
    windows: Windows,
    index: Int[np.ndarray, " n"],
    noise: Float[np.ndarray, " 3"],
    settings: ContextSettings | None = None,
) -> Float[np.ndarray, "n F"]:
    settings = settings or ContextSettings()
    return shifts_of(short_errors(dynamics, windows, settings), windows, index, noise, settings)
