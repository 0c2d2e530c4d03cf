"""Rollouts over recorded terrain by kernels, with gradients: what training calls instead of `dynamics.rollout`.

The first call compiles for some 20 seconds; the machine code is kept in the user's cache folder
(`offpiste.native.kernel_cache`).
"""

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from offpiste.core.conventions import ACTUATORS, STATE
from offpiste.core.state import ModelState, Terrain, Trajectory
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.coverage import uncovered, warn_of_eager_steps
from offpiste.dynamics.kernels.lanes import unpack
from offpiste.dynamics.kernels.model_arrays import (
    Given,
    compensator_weights,
    constants,
    learned_constants,
    networks,
    record,
    terms_of_codes,
    to_kernel_state,
)
from offpiste.dynamics.kernels.parity import APART, largest_difference
from offpiste.dynamics.kernels.rollout import backward, forward
from offpiste.dynamics.torch_physics import drive_train
from offpiste.native.compilation import spread_kernel

_agrees: WeakKeyDictionary[Dynamics, bool] = WeakKeyDictionary()
"""Whether the kernels agree with each model that was compared with them in this process."""


def supports(dynamics: Dynamics, device: torch.device, dtype: torch.dtype) -> bool:
    """Whether `rollout_recorded` can roll this model out, here and in this type.

    It can step models that `coverage` knows, on the CPU in float32; where gradients are wanted, only while the
    actuators' models are frozen. Once a process, the kernels are compared with each model on random input.
    """
    if device.type != "cpu" or dtype != torch.float32 or not has_kernels(dynamics):
        return False
    if any(p.device.type != "cpu" or p.dtype != dtype for p in dynamics.parameters()):
        return False
    if dynamics not in _agrees:
        apart = largest_difference(dynamics, _recorded, device, gradients=False, batch=layout.LANES + 1, steps=4)
        _agrees[dynamics] = apart < APART
    if not _agrees[dynamics]:
        warn_of_eager_steps(type(dynamics).__name__, "they compute something else than its `stepper`")
    return _agrees[dynamics]


def has_kernels(dynamics: Dynamics) -> bool:
    """Whether there are kernels for a model, as it is: of its actuators' models they have no gradients."""
    if reason := uncovered(dynamics):
        if dynamics.reads_terrain:  # of baselines that are stepped eagerly by design nobody needs to hear
            warn_of_eager_steps(type(dynamics).__name__, reason)
        return False
    assert dynamics.actuators is not None
    learning = torch.is_grad_enabled() and any(p.requires_grad for p in dynamics.actuators.parameters())
    return not (dynamics.vehicle.actuators and learning)


def rollout_recorded(
    dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T U"], terrain: Terrain
) -> Trajectory:
    """`rollout(dynamics, model_state, controls, RecordedTerrain(terrain))`, several times as fast.

    Gradients reach the bicycle's constants, the compensator, `model_state` and `terrain.latent`; not the actuators'
    models, controls or normals.

    Args:
        dynamics: one that `supports` is true for.
        model_state: from `dynamics.start`.
        controls: as commanded during each step.
        terrain: under the recorded wheels at each step; fields are [B, T, 4, ...].

    Raises:
        ValueError: model, types or shapes that the kernels cannot take.
        DatasetError: there is neither a steering angle nor a steering command.
    """
    if not supports(dynamics, controls.device, controls.dtype):
        raise ValueError(f"no kernels for this model with {controls.dtype} on {controls.device}; see `supports`")
    return _recorded(dynamics, model_state, controls, terrain)


def _recorded(
    dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T U"], terrain: Terrain
) -> Trajectory:
    latent = read_codes(dynamics, terrain)
    check_shapes(dynamics, model_state, controls, terrain, latent)
    start, learned = to_kernel_state(model_state), learned_constants(dynamics)
    terms, matrices = terms_of_codes(dynamics, latent.flatten(-2)), compensator_weights(dynamics, apart=True)
    tensors = (start, learned, terms, *matrices)
    given = Given(
        start=start.detach().contiguous().numpy(),
        record=record(dynamics.vehicle, controls, terrain, terms),
        constants=constants(dynamics, learned),
        networks=networks(dynamics, matrices, apart=True),
        differentiate=torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors),
    )
    return Trajectory(*_Rollout.apply(given, *tensors))  # type: ignore[no-untyped-call]


class _Rollout(torch.autograd.Function):
    """The kernels as one operation of autograd."""

    @staticmethod
    def forward(ctx: Any, given: Given, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        """States [B, T, 6] and actuators [B, T, A]; `tensors`, which `given` was made of, tie them to the graph."""
        batch, (blocks, steps, _) = len(given.start), given.record.rows.shape
        slots = steps + 1 if given.differentiate else 2
        tape = np.empty((blocks, slots, given.start.shape[1] * layout.LANES), np.float32)
        states, actuators = (torch.empty(batch, steps, n, dtype=torch.float32) for n in (len(STATE), len(ACTUATORS)))
        spread_kernel(blocks, forward, *given[:4], tape, states.numpy(), actuators.numpy())
        ctx.given, ctx.tape = given, tape
        return states, actuators

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *bars: Tensor) -> tuple[Tensor | None, ...]:
        """Adjoints of `tensors`."""
        given, tape = ctx.given, ctx.tape
        *_, terms_wanted, gates_wanted, inner_wanted, outer_wanted = ctx.needs_input_grad
        matrices_wanted = gates_wanted, inner_wanted, outer_wanted
        start, count = np.empty_like(given.start), given.networks[0].terms
        in_lanes = np.empty((*given.record.rows.shape[:2], count * layout.LANES), np.float32)
        # By block, so that sums do not depend on the number of threads.
        main = given.networks[0]
        shapes = [
            m.shape if w else (0, 0) for m, w in zip((main.gates, main.inner, main.outer), matrices_wanted, strict=True)
        ]
        by_block = [np.zeros((len(tape), *shape), np.float32) for shape in ((len(layout.LEARNED),), *shapes)]
        seeds = (bar.contiguous().numpy() for bar in bars)
        spread_kernel(len(tape), backward, *given[1:4], tape, *seeds, start, in_lanes, *by_block)
        terms = np.empty((len(start), in_lanes.shape[1], count), np.float32)
        if terms_wanted:
            spread_kernel(len(tape), unpack, in_lanes, terms)
        learned, *matrices = (blocks.sum(axis=0) for blocks in by_block)
        adjoints = zip((start, learned, terms, *matrices), ctx.needs_input_grad[1:], strict=True)
        return None, *(torch.from_numpy(adjoint) if wanted else None for adjoint, wanted in adjoints)


def read_codes(dynamics: Dynamics, terrain: Terrain) -> Float[Tensor, "B T 4 n"]:
    """Codes of the terrain that a model reads: none, where it has no encoder."""
    return terrain.latent if dynamics.codes else terrain.latent[..., :0]


def check_shapes(
    dynamics: Dynamics, model_state: ModelState, controls: Tensor, terrain: Terrain, latent: Tensor
) -> None:
    """Refuse what kernels would read out of bounds, or wrongly.

    Args:
        latent: see `read_codes`.

    Raises:
        ValueError: a shape, a type or a device.
        DatasetError: there is neither a steering angle nor a steering command.
    """
    batch, steps = controls.shape[:2]
    expected = {
        "controls": (controls, (batch, steps, len(dynamics.vehicle.control_columns))),
        "normals": (terrain.normal, (batch, steps, 4, 3)),
        "latent": (latent, (batch, steps, 4, dynamics.codes)),
        "state": (model_state.state, (batch, len(STATE))),
        "actuators": (model_state.actuators, (batch, len(ACTUATORS))),
        "recurrent state": (model_state.recurrent, (batch, dynamics.recurrent_size)),
    }
    if terrain.known.shape != (batch, steps, 4) or terrain.known.dtype != torch.bool:
        raise ValueError(f"known normals are {list(terrain.known.shape)}, {terrain.known.dtype}")
    for name, (tensor, shape) in expected.items():
        if tuple(tensor.shape) != shape or (tensor.device, tensor.dtype) != (controls.device, controls.dtype):
            result = f"{list(tensor.shape)}, {tensor.dtype} on {tensor.device}"
            raise ValueError(f"{name} is {result}; kernels want {list(shape)}, {controls.dtype} on {controls.device}")
    drive_train(
        dynamics.vehicle, model_state.state, model_state.actuators, controls[:, 0]
    )  # says what the vehicle lacks
