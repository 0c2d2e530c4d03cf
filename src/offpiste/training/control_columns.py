"""Columns of controls by name, for models that do not know an optional control of a dataset, or know one more."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.channels import absent_value
from offpiste.dataset.windows import Batch
from offpiste.dynamics.vehicle import Vehicle


def in_columns_of(vehicle: Vehicle, batch: Batch, columns: Sequence[str]) -> Batch:
    """A batch whose controls have the columns that models of a vehicle read; `Control.absent` where it lacks one.

    Args:
        columns: that the batch has.
    """
    wanted = vehicle.control_columns
    if wanted == tuple(columns):
        return batch

    def chosen(values: Float[Tensor, "B T V"]) -> Float[Tensor, "B T U"]:
        there = dict(zip(columns, values.unbind(-1), strict=True))
        absent = {name: torch.full_like(values[..., 0], absent_value(name)) for name in wanted if name not in there}
        return torch.stack([(there | absent)[name] for name in wanted], dim=-1)

    past = replace(batch.history, control=chosen(batch.history.control))
    return replace(batch, history=past, control=chosen(batch.control))
