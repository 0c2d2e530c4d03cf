"""Weights of windows by the speed at which they start: errors grow with the distance, so slow ones hardly count."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import min_evaluation_speed
from offpiste.dataset.windows import Batch, Windows

Weigh = Callable[[Batch], Float[Tensor, " B"]]


def speed_weights(windows: Windows, relative: float) -> Weigh:
    """Weights (speed + least)^(-2 relative) of windows, with a mean of 1 over all that train.

    Args:
        windows: that train.
        relative: 0: an error in metres counts as much at any speed, as in the paper; 1: relative to the distance that a
            window goes, but for `least`, the speed from which windows are evaluated (`min_evaluation_speed`).
    """
    least = min_evaluation_speed(windows.dataset.rig.vehicle.wheelbase)

    def weigh(state: Tensor) -> Tensor:
        return (torch.linalg.vector_norm(state[:, 3:5], dim=-1) + least) ** (-2 * relative)

    states = torch.as_tensor(windows.motion()["state_causal"][windows.rows])
    mean = float(weigh(states).double().mean())
    return lambda batch: weigh(batch.state) / mean
