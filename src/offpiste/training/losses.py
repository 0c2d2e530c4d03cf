"""The multi-step loss: errors along the whole horizon, each in units of what a kinematic bicycle gets wrong."""

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.geometry import wrap_angle

COMPONENTS = ("position", "yaw", "vx", "vy", "yaw_rate")
"""[m, rad, m/s, m/s, rad/s]"""


def squared_errors(predicted: Float[Tensor, "B T 6"], target: Float[Tensor, "B T 6"]) -> Float[Tensor, "B T 5"]:
    """Squared errors by component: of position as a vector, of yaw wrapped."""
    difference = predicted - target
    position = difference[..., :2].square().sum(dim=-1)
    yaw = wrap_angle(difference[..., 2]).square()
    return torch.stack((position, yaw, *difference[..., 3:].square().unbind(-1)), dim=-1)


def summed_loss(
    predicted: Float[Tensor, "B T 6"],
    target: Float[Tensor, "B T 6"],
    scale: Float[Tensor, " 5"],
    weights: Float[Tensor, " 5"],
) -> Float[Tensor, " B"]:
    """The loss of each window: mean over its steps, summed over the components.

    Args:
        scale: mean square error of `kinematic` on the training windows by component, in the components' units squared.
        weights: of the components (`offpiste.training.config.Weights.in_order`).
    """
    return (squared_errors(predicted, target).mean(dim=1) * (weights / scale)).sum(dim=-1)
