"""A loss in which late steps count more: the weight of a step grows in proportion to its time.

    export PYTHONPATH=examples/extending OFFPISTE_EXTENSIONS=late_loss
    offpiste train dataset.zarr --out run --loss late

Reports of `evaluate` show the squared loss, whichever loss a model was trained with.
"""

import torch
from torch import Tensor

from offpiste.training.losses import LOSSES


@LOSSES.register("late")
def late(squared: Tensor, weights: Tensor) -> Tensor:
    """Loss of each window [B] from squared errors [B, T, 5] and the weights of the components [5]."""
    steps = squared.shape[1]
    growth = torch.arange(1, steps + 1, device=squared.device) * (2 / (steps + 1))  # its mean is 1
    return (growth[:, None] * squared).mean(dim=1) @ weights
