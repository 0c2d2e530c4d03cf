"""Rollouts over recorded terrain by the compiled library, with gradients: what training calls instead of `rollout`."""

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from offpiste.core.conventions import ACTUATORS, STATE
from offpiste.core.state import ModelState, Terrain, Trajectory
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.kernels.coverage import uncovered, warn_of_eager_steps
from offpiste.dynamics.kernels.model_state import to_kernel_state
from offpiste.dynamics.kernels.networks import learned_constants, model_networks
from offpiste.dynamics.kernels.parity import APART, largest_difference
from offpiste.dynamics.kernels.structures import Learning, Model, Record, model_of
from offpiste.dynamics.torch_physics import drive_train
from offpiste.native.library import MISSING, library
from offpiste.native.tensors import CHUNK, Arrays, address, call, new_floats

_agrees: WeakKeyDictionary[Dynamics, bool] = WeakKeyDictionary()
"""Whether the kernels agree with each model that was compared with them in this process."""


def supports(dynamics: Dynamics, device: torch.device, dtype: torch.dtype) -> bool:
    """Return whether `rollout_recorded` can roll this model out, here and in this type.

    It can step models that `coverage` knows, on the CPU in float32; where gradients are wanted, only while the
    actuators' models are frozen. Once a process, the kernels are compared with each model on random input.
    """
    if device.type != "cpu" or dtype != torch.float32 or not has_kernels(dynamics):
        return False
    if library() is None:
        warn_of_eager_steps(type(dynamics).__name__, MISSING)
        return False
    if any(p.device.type != "cpu" or p.dtype != dtype for p in dynamics.parameters()):
        return False
    if dynamics not in _agrees:
        apart = largest_difference(dynamics, _recorded, device, gradients=False, batch=CHUNK + 1, steps=4)
        _agrees[dynamics] = apart < APART
    if not _agrees[dynamics]:
        warn_of_eager_steps(type(dynamics).__name__, "they compute something else than its `stepper`")
    return _agrees[dynamics]


def has_kernels(dynamics: Dynamics) -> bool:
    """Return whether there are kernels for a model, as it is: of its actuators' models they have no gradients."""
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
    start, networks = to_kernel_state(model_state), model_networks(dynamics)
    force = next((of for of in networks if of.name == "force"), None)
    fields = {"controls": controls, "normals": terrain.normal, "known": terrain.known}
    given = Given(model_of(dynamics, networks), fields, torch.is_grad_enabled())
    matrices = () if force is None else force.weights
    results = Rollout.apply(given, start, learned_constants(dynamics), latent.flatten(-2), *matrices)  # type: ignore[no-untyped-call]
    return Trajectory(*results)


class Given(NamedTuple):
    """Inputs of a rollout without gradients.

    Attributes:
        fields: those of `Record` by name.
        differentiate: whether gradients are recorded, for which the states of every step are kept.
    """

    model: Model
    fields: dict[str, Tensor]
    differentiate: bool


class Rollout(torch.autograd.Function):
    """Entries `forward` and `backward` of the library as one operation of autograd.

    Gradients are those of the start, of the constants that learn, of the codes and of three matrices for each network,
    from the model's first one on.
    """

    @staticmethod
    def forward(
        ctx: Any, given: Given, start: Tensor, learned: Tensor, codes: Tensor, *matrices: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return states [B, T, 6] and actuators [B, T, A]; `learned` and `matrices` only tie the model to the graph."""
        model, controls = given.model, given.fields["controls"]
        batch, steps = controls.shape[:2]
        record, arrays = Record(batch=batch, steps=steps), Arrays()
        for name, values in (given.fields | {"start": start, "codes": codes}).items():
            setattr(record, name, arrays.bytes(values) if values.dtype == torch.bool else arrays.floats(values))
        states = start.new_empty(batch, steps, 0 if model.lags_only else len(STATE))
        actuators = start.new_empty(batch, steps, len(ACTUATORS))
        chunks, size = -(-batch // CHUNK), start.shape[1]
        # Blocks of any width fit into whole chunks.
        kept = given.differentiate and any(ctx.needs_input_grad)
        tape = start.new_empty(chunks * CHUNK * (steps + 1) * size) if kept else None
        call("forward", chunks, model, record, tape, None if model.lags_only else states, actuators)
        ctx.model, ctx.record, ctx.kept = model, record, (arrays, tape)
        ctx.shapes = [tensor.shape for tensor in (start, learned, codes, *matrices)]
        return states, actuators

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, states_bar: Tensor, actuators_bar: Tensor) -> tuple[Tensor | None, ...]:
        """Return the adjoints of the start, the constants, the codes and the matrices."""
        model, record, (_, tape) = ctx.model, ctx.record, ctx.kept
        _, _, codes_wanted, *wanted = ctx.needs_input_grad[1:]
        chunks = -(-record.batch // CHUNK)
        # By chunk, so that sums do not depend on the number of threads.
        start, codes = (new_floats(*shape) for shape in (ctx.shapes[0], ctx.shapes[2]))
        learned = new_floats(chunks, *ctx.shapes[1])
        matrices = [
            new_floats(chunks, *shape) if want else None for shape, want in zip(ctx.shapes[3:], wanted, strict=True)
        ]
        learning = Learning()
        for k, matrix in enumerate(matrices):
            learning.matrices[k // 3][k % 3] = address(matrix)
        seeds = None if model.lags_only else states_bar.contiguous(), actuators_bar.contiguous()
        call("backward", chunks, model, record, tape, *seeds, start, codes if codes_wanted else None, learned, learning)
        sums = (None if matrix is None else matrix.sum(dim=0) for matrix in matrices)
        return None, start, learned.sum(dim=0), codes if codes_wanted else None, *sums


def read_codes(dynamics: Dynamics, terrain: Terrain) -> Float[Tensor, "B T 4 n"]:
    """Return the codes of the terrain that a model reads; none if it has no encoder."""
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
        raise ValueError(
            f"known normals: {list(terrain.known.shape)}, {terrain.known.dtype}; kernels need [B, T, 4], torch.bool"
        )
    for name, (tensor, shape) in expected.items():
        if tuple(tensor.shape) != shape or (tensor.device, tensor.dtype) != (controls.device, controls.dtype):
            result = f"{list(tensor.shape)}, {tensor.dtype} on {tensor.device}"
            raise ValueError(f"{name} is {result}; kernels need {list(shape)}, {controls.dtype} on {controls.device}")
    drive_train(
        dynamics.vehicle, model_state.state, model_state.actuators, controls[:, 0]
    )  # says what the vehicle lacks
