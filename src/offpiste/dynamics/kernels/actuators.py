"""Rollouts of the actuators' delay models alone, along a recorded speed, with gradients: what fits them."""

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.kernels.autograd import Given, Rollout
from offpiste.dynamics.kernels.coverage import uncovered_actuators, warn_of_eager_steps
from offpiste.dynamics.kernels.model_state import hidden_and_cells
from offpiste.dynamics.kernels.networks import residual_networks
from offpiste.dynamics.kernels.structures import lags_of
from offpiste.native.library import MISSING, library


def supports_actuators(actuators: Actuators, device: torch.device, dtype: torch.dtype) -> bool:
    """Return whether `rollout_actuators` can step these: types of `coverage`, on the CPU, in float32."""
    if reason := uncovered_actuators(actuators) or ("" if library() else MISSING):
        warn_of_eager_steps(type(actuators).__name__, reason)
        return False
    alike = all(p.device.type == "cpu" and p.dtype == torch.float32 for p in actuators.parameters())
    return device.type == "cpu" and dtype == torch.float32 and alike


def rollout_actuators(
    actuators: Actuators,
    controls: Float[Tensor, "B T U"],
    speed: Float[Tensor, "B T"],
    start: Float[Tensor, "B A"],
    recurrent: Float[Tensor, "B R"],
) -> Float[Tensor, "B T A"]:
    """`actuators.rollout(...)` of the same arguments, many times as fast.

    Gradients reach the lags' constants, the residuals, `start` and `recurrent`; not controls and speed.

    Raises:
        ValueError: what `supports_actuators` is false for.
    """
    if not supports_actuators(actuators, controls.device, controls.dtype):
        raise ValueError("no kernels for these actuators; see `supports_actuators`")
    lags, networks = actuators.flat_constants(), residual_networks(actuators)
    given = Given(
        lags_of(actuators.vehicle, lags, networks), {"controls": controls, "speed": speed}, torch.is_grad_enabled()
    )
    nothing = start.new_zeros(len(start), 6)
    state = torch.cat((nothing, start, *hidden_and_cells(recurrent)), dim=-1)
    matrices = (matrix for of in networks for matrix in of.weights)
    _, moved = Rollout.apply(given, state, lags, start[:, :0], *matrices)  # type: ignore[no-untyped-call]
    return moved
