"""Rollouts over recorded terrain by the printed C, with gradients: what training calls where a GPU computes.

The kernels keep the model state of every step (the tape); backwards they compute each step again and write down the
rows that the weights' gradients are products of, so that matrix products and no atomic sums make these. What codes
add is one matrix product before the rollout.
"""

from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from offpiste.core.conventions import STATE
from offpiste.core.state import ModelState, Terrain, Trajectory
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.networks import packed_parameters
from offpiste.dynamics.header.step_text import shipped_text, step_text
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.autograd import check_shapes, read_codes
from offpiste.dynamics.kernels.model_state import to_kernel_state
from offpiste.dynamics.kernels.networks import (
    compensator_inputs,
    learned_constants,
    model_networks,
    terms_of_codes,
)
from offpiste.native.cuda_kernels import Kernels

MOVED = len(layout.STEPPED)
GATES = 4 * layout.HIDDEN


def recorded_text(dynamics: Dynamics) -> str:
    """C++ and CUDA text of the kernels `offpiste_forward` and `offpiste_backward` for models of these sizes."""
    step = step_text(dynamics, adjoint=True, apart=True)
    return "\n".join((step, shipped_text("kernels.h"), shipped_text("recorded.h")))


class _Given(NamedTuple):
    """Inputs of the kernels.

    Attributes:
        params: `packed_parameters`.
        rows: members of `offpiste_given`, window by window.
        inputs: of the first network, without codes.
        differentiate: will there be a backward pass?
    """

    kernels: Kernels
    params: Tensor
    rows: Float[Tensor, "T G B"]
    inputs: int
    differentiate: bool


def rollout_by_kernels(
    kernels: Kernels, dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T U"], terrain: Terrain
) -> Trajectory:
    """`rollout(dynamics, model_state, controls, RecordedTerrain(terrain))`, by the kernels of `recorded_text`.

    Gradients reach the bicycle's constants, the compensator, `model_state` and `terrain.latent`; not the actuators'
    models, controls or normals.

    Raises:
        ValueError: shapes, types or devices that the kernels cannot take.
        DatasetError: there is neither a steering angle nor a steering command.
    """
    latent = read_codes(dynamics, terrain)
    check_shapes(dynamics, model_state, controls, terrain, latent)
    params = packed_parameters(dynamics, apart=True)
    if params.dtype != controls.dtype:
        raise ValueError(f"controls are {controls.dtype}; this model's kernels need {params.dtype}")
    terms = terms_of_codes(dynamics, latent.flatten(-2))
    unknown = (~terrain.known).to(controls).mean(dim=-1, keepdim=True)
    columns = [controls.detach(), terrain.normal.detach().mean(dim=-2), unknown, terms.detach()]
    rows = torch.cat(columns, dim=-1).permute(1, 2, 0).contiguous()
    start = to_kernel_state(model_state)
    matrices = next((of.weights for of in model_networks(dynamics, apart=True) if of.name == "force"), ())
    tensors = (start, learned_constants(dynamics), terms, *matrices)
    differentiate = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
    inputs = len(compensator_inputs(dynamics.vehicle))
    given = _Given(kernels, params, rows, inputs, differentiate)
    return Trajectory(*_Recorded.apply(given, *tensors))  # type: ignore[no-untyped-call]


class _Recorded(torch.autograd.Function):
    """The kernels as one operation of autograd."""

    @staticmethod
    def forward(ctx: Any, given: _Given, start: Tensor, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        """States [B, T, 6] and actuators [B, T, A]; `tensors`, which parameters were made of, tie them to the graph."""
        steps, _, batch = given.rows.shape
        tape = start.new_empty(steps + 1, start.shape[1], batch)
        tape[0] = start.t()
        given.kernels.launch("offpiste_forward", batch, given.params, given.rows, tape, steps)
        moved = tape[1:, :MOVED].permute(2, 0, 1).contiguous()
        if given.differentiate:
            ctx.given, ctx.tape, ctx.shapes = given, tape, [tensor.shape for tensor in tensors]
        return moved[..., : len(STATE)], moved[..., len(STATE) :]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *bars: Tensor) -> tuple[Tensor | None, ...]:
        """Adjoints of `tensors`."""
        given, tape = ctx.given, ctx.tape
        steps, _, batch = given.rows.shape
        seed = torch.cat(bars, dim=-1).permute(1, 2, 0).contiguous()
        learned, terms, *matrices = ctx.shapes
        start, constants = tape.new_empty(tape.shape[1:]), tape.new_empty(learned[0], batch)
        width = matrices[1][1] if matrices else 0
        kinds = (given.inputs, width, GATES + width, matrices[2][1]) if matrices else (0, 0, 0, 0)
        kept = tape.new_empty(steps, sum(kinds), batch)
        given.kernels.launch(
            "offpiste_backward", batch, given.params, given.rows, tape, seed, start, constants, kept, steps
        )
        inputs, layer, terms_bar, outer = kept.split(kinds, dim=1)
        adjoints = [start.t(), constants.sum(dim=1), terms_bar.permute(2, 0, 1) if terms[-1] else None]
        if matrices:
            adjoints += _matrix_adjoints(tape, inputs, layer, terms_bar, outer)
        wanted = ctx.needs_input_grad[1:]
        return None, *(one if want else None for one, want in zip(adjoints, wanted, strict=True))


def _matrix_adjoints(tape: Tensor, inputs: Tensor, layer: Tensor, terms: Tensor, outer: Tensor) -> list[Tensor]:
    """Return the adjoints of the first network's matrices (`kernels.networks.Weights`)."""
    hidden = slice(MOVED, MOVED + layout.HIDDEN)
    one = torch.ones_like(inputs[:, :1])
    pairs = (
        (torch.cat((tape[:-1, hidden], inputs, one), dim=1), terms[:, :GATES]),
        (torch.cat((inputs, one, tape[1:, hidden]), dim=1), terms[:, GATES:]),
        (torch.cat((layer, one), dim=1), outer),
    )
    # A product for each step, then their sum: as one product, all rows would be copied into another order first.
    return [torch.matmul(value, adjoint.transpose(1, 2)).sum(dim=0) for value, adjoint in pairs]
