"""Rollouts of the actuators' delay models alone, along a recorded speed, with gradients: what fits them.

The blocks, networks and tape are those of `offpiste.dynamics.kernels.rollout`; here the lags and their residuals learn.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from offpiste.core.conventions import ACTUATORS, STATE
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.coverage import uncovered_actuators, warn_of_eager_steps
from offpiste.dynamics.kernels.elementary import copy, f4
from offpiste.dynamics.kernels.generated import actuate, actuate_adjoint
from offpiste.dynamics.kernels.layout import LANES, ROW
from offpiste.dynamics.kernels.model_arrays import (
    hidden_and_cells,
    recorded_channels,
    residual_networks,
    switches,
)
from offpiste.dynamics.kernels.network import Network, compensate, compensate_adjoint, make_buffers, weights
from offpiste.native.compilation import KERNELS, spread_kernel

ACTUATED = len(ACTUATORS)
MOVED = ACTUATED * LANES
FIRST = ROW[ACTUATORS[0]] * LANES
NEXT = ROW[layout.NEXT[len(STATE)]] * LANES
CONTROL_ROW = ROW[layout.CONTROLS[0]]
SPEED_ROW = ROW["vx"]
CONSTANTS = len(layout.LAG_CONSTANTS)

Residuals = tuple[Network, Network]
"""Networks of the brake and the steering."""


class LagRecord(NamedTuple):
    """What a rollout is given.

    Attributes:
        controls: [B, T, U].
        speed: forward, before each step [B, T].
        recorded: are the actuators, then the controls there? Slots of absent ones are not computed with.
    """

    controls: np.ndarray
    speed: np.ndarray
    recorded: np.ndarray


def supports_actuators(actuators: Actuators, device: torch.device, dtype: torch.dtype) -> bool:
    """Whether `rollout_actuators` can step these: of the types in `coverage`, on the CPU, in float32."""
    if reason := uncovered_actuators(actuators):
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
    lags = actuators.flat_constants()
    matrices = [weights(actuators.networks.get(one.label)) for one in layout.LAGGING if one.lag.residual]
    tensors = (torch.cat((start, *hidden_and_cells(recurrent)), dim=-1), lags, *(m for of in matrices for m in of))
    commanded, vx = (tensor.detach().contiguous().numpy() for tensor in (controls, speed))
    constants = np.zeros(len(layout.CONSTANTS), np.float32)
    constants[len(layout.LEARNED) :] = (*lags.tolist(), *switches(actuators.vehicle))
    given = (
        LagRecord(commanded, vx, recorded_channels(actuators.vehicle)),
        constants,
        residual_networks(actuators, matrices, first_hidden=0),
    )
    differentiate = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
    return _LagRollout.apply(given, differentiate, *tensors)  # type: ignore[no-untyped-call, no-any-return]


class _LagRollout(torch.autograd.Function):
    """The kernels below as one operation of autograd."""

    @staticmethod
    def forward(ctx: Any, given: tuple[LagRecord, np.ndarray, Residuals], differentiate: bool, *tensors: Tensor) -> Any:
        """Actuators [B, T, A]; `tensors`, which `given` was made of, tie them to the graph."""
        start = tensors[0].detach().contiguous().numpy()
        batch, steps, _ = given[0].controls.shape
        blocks = -(-batch // LANES)
        tape = np.empty((blocks, steps + 1 if differentiate else 2, start.shape[1] * LANES), np.float32)
        actuators = torch.empty(batch, steps, ACTUATED, dtype=torch.float32)
        spread_kernel(blocks, lag_forward, start, *given, tape, actuators.numpy())
        ctx.given, ctx.tape, ctx.start_shape, ctx.shapes = given, tape, start.shape, [t.shape for t in tensors[2:]]
        return actuators

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bar: Tensor) -> tuple[Tensor | None, ...]:
        """Adjoints of `tensors`."""
        start, blocks = np.empty(ctx.start_shape, np.float32), len(ctx.tape)
        # By block, so that sums do not depend on the number of threads.
        learned = np.zeros((blocks, CONSTANTS), np.float32)
        matrices = [
            np.zeros((blocks, *shape), np.float32) if wanted else np.zeros((blocks, 0, 0), np.float32)
            for shape, wanted in zip(ctx.shapes, ctx.needs_input_grad[4:], strict=True)
        ]
        seed = bar.contiguous().numpy()
        spread_kernel(blocks, lag_backward, *ctx.given, ctx.tape, seed, start, learned, *matrices)
        adjoints = zip(
            (start, *(each.sum(axis=0) for each in (learned, *matrices))), ctx.needs_input_grad[2:], strict=True
        )
        return None, None, *(torch.from_numpy(adjoint) if wanted else None for adjoint, wanted in adjoints)


@KERNELS.loop
def _advance(
    w: np.ndarray,
    record: LagRecord,
    c: np.ndarray,
    networks: Residuals,
    buffer_sets: tuple,  # type: ignore[type-arg]
    before: np.ndarray,
    after: np.ndarray,
    block: int,
    t: int,
) -> None:
    """Step t of a block, from one packed state to the next; lanes behind the batch repeat its last window."""
    last = len(record.controls) - 1
    for i in range(LANES):
        window = min(block * LANES + i, last)
        for k in range(record.controls.shape[2]):
            if record.recorded[ACTUATED + k]:
                w[(CONTROL_ROW + k) * LANES + i] = record.controls[window, t, k]
        w[SPEED_ROW * LANES + i] = record.speed[window, t]
    units = (len(before) - MOVED) // (2 * LANES)
    copy(before, w[FIRST : FIRST + MOVED])
    for k in range(len(networks)):
        compensate(networks[k], buffer_sets[k], w, before[MOVED:], after[MOVED:], units)
    actuate(w, c)
    copy(w[NEXT : NEXT + MOVED], after[:MOVED])


@KERNELS.entry
def lag_forward(
    first: int,
    last: int,
    start: np.ndarray,
    record: LagRecord,
    c: np.ndarray,
    networks: Residuals,
    tape: np.ndarray,
    actuators: np.ndarray,
) -> None:
    """Roll blocks `first` ... `last - 1` out.

    Args:
        start: actuators, hidden units and cells [B, P].
        record: see `LagRecord`.
        c: the constants (`layout.CONSTANTS`); only the lags' are read.
        networks: of the brake and the steering.
        tape: packed states before each step and after the last [blocks, T + 1, P * LANES]; or [blocks, 2, ...] without
            adjoint.
        actuators: to fill [B, T, A].
    """
    batch, steps, _ = record.controls.shape
    slots = tape.shape[1]
    w = np.zeros(len(layout.ROWS) * LANES, f4)
    buffer_sets = make_buffers(networks[0], f4(1)), make_buffers(networks[1], f4(1))
    for block in range(first, last):
        for i in range(LANES):
            window = min(block * LANES + i, batch - 1)
            for k in range(start.shape[1]):
                absent = k < ACTUATED and not record.recorded[k]
                tape[block, 0, k * LANES + i] = f4(0) if absent else start[window, k]
        for t in range(steps):
            after = tape[block, (t + 1) % slots]
            _advance(w, record, c, networks, buffer_sets, tape[block, t % slots], after, block, t)
            for i in range(min(LANES, batch - block * LANES)):
                window = block * LANES + i
                for k in range(ACTUATED):
                    moved = record.recorded[k]
                    actuators[window, t, k] = after[k * LANES + i] if moved else start[window, k]


@KERNELS.entry
def lag_backward(
    first: int,
    last: int,
    record: LagRecord,
    c: np.ndarray,
    networks: Residuals,
    tape: np.ndarray,
    actuators_bar: np.ndarray,
    start_bar: np.ndarray,
    c_bar: np.ndarray,
    gates_0: np.ndarray,
    inner_0: np.ndarray,
    outer_0: np.ndarray,
    gates_1: np.ndarray,
    inner_1: np.ndarray,
    outer_1: np.ndarray,
) -> None:
    """Back through `lag_forward`.

    Args:
        first, last, record, c, networks, tape: as there.
        actuators_bar: adjoint of the result.
        start_bar: to fill, like `start`.
        c_bar: adjoint of the lags' constants, by block, to fill.
        gates_0, inner_0, outer_0, gates_1, inner_1, outer_1: adjoints of the networks' weights by block, zero, to add
            to; without rows where a matrix is frozen.
    """
    batch, steps, _ = record.controls.shape
    w = np.zeros(len(layout.ROWS) * LANES, f4)
    w_bar = np.zeros_like(w)
    after = np.zeros(tape.shape[2], f4)
    units = (len(after) - MOVED) // (2 * LANES)
    constants_bar = np.zeros(CONSTANTS * LANES, f4)
    buffer_sets = make_buffers(networks[0], f4(1)), make_buffers(networks[1], f4(1))
    bars = make_buffers(networks[0], f4(0)), make_buffers(networks[1], f4(0))
    for block in range(first, last):
        inside = min(LANES, batch - block * LANES)
        constants_bar[:] = f4(0)
        state_bar = np.zeros_like(after)
        for step in range(steps):
            t = steps - 1 - step
            _advance(w, record, c, networks, buffer_sets, tape[block, t], after, block, t)
            w_bar[:] = f4(0)
            copy(state_bar, w_bar[NEXT : NEXT + MOVED])
            for i in range(inside):
                for k in range(ACTUATED):
                    w_bar[NEXT + k * LANES + i] += actuators_bar[block * LANES + i, t, k]
            actuate_adjoint(w, c, w_bar, constants_bar)
            hidden_bar = state_bar[MOVED:]
            compensate_adjoint(
                networks[0], buffer_sets[0], bars[0], w, w_bar, hidden_bar, units,
                gates_0[block], inner_0[block], outer_0[block],
            )  # fmt: skip
            compensate_adjoint(
                networks[1], buffer_sets[1], bars[1], w, w_bar, hidden_bar, units,
                gates_1[block], inner_1[block], outer_1[block],
            )  # fmt: skip
            copy(w_bar[FIRST:], state_bar[:MOVED])
        for i in range(inside):
            for k in range(start_bar.shape[1]):
                start_bar[block * LANES + i, k] = state_bar[k * LANES + i]
        for k in range(CONSTANTS):
            c_bar[block, k] = constants_bar[k * LANES : (k + 1) * LANES].sum()
