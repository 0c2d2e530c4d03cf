"""Predictions with their spread: where the vehicle goes, and how sure that is."""

from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.errors import RunError
from offpiste.core.state import Trajectory
from offpiste.dataset.windows import Windows
from offpiste.dynamics.models import seeded
from offpiste.training.checkpoint import load_beside_weights, load_tensors, load_weights
from offpiste.training.prediction import Lookup
from offpiste.training.run import Run, Stretch, refuse_unfit
from offpiste.uncertainty.fit import predictions_of
from offpiste.uncertainty.spread import Spread, inputs_of
from offpiste.uncertainty.student import radius

FILE: Final = "spread.safetensors"
"""In the folder of a run."""


@dataclass(frozen=True)
class SpreadPrediction:
    """What is predicted for windows, and how far it may stray.

    Attributes:
        trajectory: predicted states and actuators, every `conventions.DT`.
        scale: of position errors along and across the predicted heading, every `spread.INTERVAL` [m].
        freedom: degrees of freedom of these errors (`student`).
    """

    trajectory: Trajectory
    scale: Float[Tensor, "B K 2"]
    freedom: float

    def region(self, probability: float) -> Float[Tensor, "B K 2"]:
        """Half axes of the ellipses that hold the vehicle with a probability, along and across the heading [m]."""
        return self.scale * radius(probability, self.freedom)


def predict_with_spread(run: Run, windows: Windows, lookup: Lookup = "map") -> SpreadPrediction:
    """Predicted states of windows, and their spread.

    Args:
        lookup: where the ground is read (`Run.predict`).

    Raises:
        RunError: the run was trained with other features or channels than the dataset has, or its folder has no spread
            (`offpiste calibrate` makes it), or that of other weights.
        DatasetError: the map is asked for and a window does not start with one.
    """
    refuse_unfit(run, windows.dataset)
    spread = load_spread(run)
    parts = list(predictions_of(run, windows, np.arange(len(windows)), lookup))
    trajectory = Trajectory(
        torch.cat([each.state for each, _ in parts]), torch.cat([each.actuators for each, _ in parts])
    )
    scale = torch.cat([spread(residuals.inputs) for _, residuals in parts])
    return SpreadPrediction(trajectory, scale, float(spread.freedom))


def load_spread(run: Run) -> Spread:
    """The spread in a run's folder.

    Raises:
        RunError: there is none, it is damaged, or it belongs to other weights.
    """
    path = run.folder / FILE
    if not path.exists():
        raise RunError("has no spread", where=run.folder, how="make it with `offpiste calibrate`")
    tensors, _ = load_beside_weights(path)
    with seeded(0):  # its weights are replaced
        spread = Spread(inputs_of(run.dynamics.vehicle, run.dynamics.codes))
    load_weights(spread, tensors, path)
    return spread.requires_grad_(False)


def spread_seen(run: Run) -> list[Stretch]:
    """What the spread in a run's folder was fitted to.

    Those that the run was trained and chosen on, where an older offpiste, which did not write it, fitted it.
    """
    _, about = load_tensors(run.folder / FILE)
    return msgspec.convert(about.get("seen", run.seen), list[Stretch])
