"""Planning with a single pedal, throttle minus brake, from full brake (-1) to full throttle (+1), and the steering.

With two independent pedals a planner presses both at once: no training data show that, so the model's predictions of
it are wrong, and may be too good.
"""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.planning.mppi import CostOf, Limits

PEDAL_AND_WHEEL: Final = Limits(low=(-1.0, -1.0), high=(1.0, 1.0), rate=(6.0, 4.0))
"""Bounds [1] and rates [1/s] of pedal and steer."""


def controls_of(pedal_and_steer: Float[Tensor, "*P 2"]) -> Float[Tensor, "*P 3"]:
    """Throttle, brake and steer from pedal and steer."""
    pedal, steer = pedal_and_steer.unbind(-1)
    return torch.stack((pedal.clamp(min=0), (-pedal).clamp(min=0), steer), dim=-1)


def pedals_of(controls: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 2"]:
    """Pedal (throttle minus brake) and steer from throttle, brake and steer."""
    throttle, brake, steer = controls.unbind(-1)
    return torch.stack((throttle - brake, steer), dim=-1)


def with_pedal(cost_of: CostOf) -> CostOf:
    """Costs of sequences of pedal and steer [K, T, 2], from costs of throttle, brake and steer."""

    def cost(pedal_and_steer: Tensor) -> Tensor:
        return cost_of(controls_of(pedal_and_steer))

    return cost
