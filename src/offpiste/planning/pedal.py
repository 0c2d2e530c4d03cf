"""Planning with one foot: a single pedal, from full brake (-1) over none (0) to full throttle (+1), and the wheel.

With two feet a planner presses both pedals at once where its model, which was never shown that, expects wonders of it.
"""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.planning.mppi import CostOf, Limits

PEDAL_AND_WHEEL: Final = Limits(low=(-1.0, -1.0), high=(1.0, 1.0), rate=(6.0, 4.0))
"""Of pedal and steer [1, 1/s]."""


def controls_of(feet: Float[Tensor, "*P 2"]) -> Float[Tensor, "*P 3"]:
    """Throttle, brake and steer of pedal and steer."""
    pedal, steer = feet.unbind(-1)
    return torch.stack((pedal.clamp(min=0), (-pedal).clamp(min=0), steer), dim=-1)


def pedals_of(controls: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 2"]:
    """Pedal and steer of throttle, brake and steer; of both pedals pressed, the difference."""
    throttle, brake, steer = controls.unbind(-1)
    return torch.stack((throttle - brake, steer), dim=-1)


def with_pedal(cost_of: CostOf) -> CostOf:
    """Costs of pedal and steer [K, T, 2]."""

    def cost(feet: Float[Tensor, "K T 2"]) -> Float[Tensor, " K"]:
        return cost_of(controls_of(feet))

    return cost
