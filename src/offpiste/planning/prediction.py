"""What a model predicts on the ground that a plan can come to: by the kernel where there is one, else step by step."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.hybrid import Hybrid, Parametric
from offpiste.dynamics.kernels.function import supports
from offpiste.planning.area import Area
from offpiste.planning.costs import Situation, Weights
from offpiste.planning.fused import fused_carry, fused_costs, fused_rollout
from offpiste.planning.mppi import CostOf
from offpiste.planning.rollouts import driving_costs
from offpiste.planning.vehicle_track import TrackRows
from offpiste.trajectory import Carry, History, Terrain


@dataclass(frozen=True)
class Prediction:
    """Where a plan would lead.

    Attributes:
        time: of its start [s].
        state: after each step, in the world frame.
    """

    time: float
    state: Float[np.ndarray, "T 6"]


def carry_of(
    model: Dynamics, rows: TrackRows, area: Area, wheels: Float[Tensor, "4 2"], offset: Float[Tensor, " 2"]
) -> Carry:
    """The vehicle's latest state, in the frame at `offset`, and what the model remembers of the rows before it."""
    shift = np.concatenate((offset.numpy(), np.zeros(4)))
    state = torch.as_tensor(rows.state - shift, dtype=torch.float32)
    actuators = torch.as_tensor(rows.actuators, dtype=torch.float32)
    control = torch.as_tensor(rows.control, dtype=torch.float32)
    past = len(state) - 1
    under = area.terrain(offset, wheels, past).at(0, state[:past])
    terrain = Terrain(under.normal[None], under.latent[None])
    history = History(state[None, :past], actuators[None, :past], control[None, :past], terrain)
    return model.start(history, state[past:], actuators[past:])


def carry_after(model: Dynamics, carry: Carry, controls: Float[Tensor, "L 3"], area: Area, at: Situation) -> Carry:
    """The state after some controls: where a plan begins to act that they are committed until.

    Args:
        at: its state and control are not read.
    """
    if len(controls) and _by_kernel(model, carry):
        return fused_carry(model, carry, controls, at, area.codes)
    for after in _stepped(model, carry, controls, area, at):
        carry = after
    return carry


def costs_from(model: Dynamics, carry: Carry, area: Area, at: Situation, weights: Weights) -> CostOf:
    """Costs of control sequences that begin at a state."""
    if _by_kernel(model, carry):
        return fused_costs(model, carry, at, weights, area.codes)
    return driving_costs(model, carry, at, weights, area.encode)


def predicted(
    model: Dynamics, carry: Carry, controls: Float[Tensor, "T 3"], area: Area, at: Situation, weights: Weights
) -> Float[np.ndarray, "T 6"]:
    """The states that a plan leads through, in the world frame."""
    if _by_kernel(model, carry):
        found = fused_rollout(model, carry, controls[None], at, weights, area.codes)[1][0]
    else:
        found = torch.cat([after.state for after in _stepped(model, carry, controls, area, at)])
    states = found.double().numpy()
    states[:, :2] += at.offset.numpy()
    return states


def _stepped(
    model: Dynamics, carry: Carry, controls: Float[Tensor, "T 3"], area: Area, at: Situation
) -> Iterator[Carry]:
    """After each step, one by one."""
    source, step = area.terrain(at.offset, at.wheels, 1), model.stepper()
    for t, given in enumerate(controls):
        carry = step(carry, given[None], source.at(t, carry.state))
        yield carry


def _by_kernel(model: Dynamics, carry: Carry) -> TypeGuard[Parametric | Hybrid]:
    return supports(model, carry.state.device, carry.state.dtype)
