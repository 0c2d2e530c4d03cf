"""Costs of rollouts on a map, computed by the compiled library; a faster equivalent of `driving_costs`."""

from collections.abc import Callable
from ctypes import CDLL, Structure, c_float, c_int, c_void_p
from dataclasses import replace
from functools import cache
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from offpiste.core.conventions import ACTUATORS, CONTROL, DT
from offpiste.core.state import ModelState
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.autograd import supports
from offpiste.dynamics.kernels.encoder import codes_by_cell
from offpiste.dynamics.kernels.model_state import from_kernel_state, to_kernel_state
from offpiste.dynamics.kernels.structures import model_of
from offpiste.mapping.terrain_sampler import MapStack
from offpiste.native.compiler import planning_library
from offpiste.native.tensors import CHUNK, Arrays, call
from offpiste.planning.caution import Caution, spread_weights
from offpiste.planning.controls import complete
from offpiste.planning.costs.declaration import cost_terms
from offpiste.planning.costs.layers import CostLayer, CostMap
from offpiste.planning.costs.text import terms_text
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation
from offpiste.planning.mppi import CostOf
from offpiste.uncertainty.spread import EVERY, INTERVAL

Codes = tuple[Float[Tensor, "ny nx E"], Float[Tensor, " E"]]
"""Codes of the cells of a map, and of a cell without features."""

READINGS: Final = ("mean of wheels", "least of wheels", "pose point")
"""Readings of layers, in the order of their numbers in `native/cpp/plan.h`."""


_Two, _Three, _Eight = c_float * 2, c_float * 3, c_float * 8  # new types would leave work to garbage collection


class _Grid(Structure):
    _fields_ = (*((name, c_float) for name in ("shift_x", "shift_y", "scale")), ("rows", c_int), ("columns", c_int))


class _Stray(Structure):
    _fields_ = (
        *((name, c_int) for name in ("hidden", "inputs", "every")),
        *((name, c_void_p) for name in ("inner", "bias", "outer")),
        *((name, _Two) for name in ("outer_bias", "start")),
        *((name, c_float) for name in ("reach", "interval", "dt")),
    )


class _Situation(Structure):
    """Situation as the library reads it, with the arrays that its addresses point to."""

    _fields_ = (
        ("ground", _Grid),
        ("costs", _Grid),
        ("wheels", _Eight),
        ("control", _Three),
        *((name, c_void_p) for name in ("start", "slope", "codes", "missing", "layers", "outside", "numbers", "reads")),
        *((name, c_int) for name in ("layer_count", "one_grid")),
        ("stray", _Stray),
    )
    arrays: Arrays


class _Samples(Structure):
    _fields_ = (
        *((name, c_int) for name in ("count", "steps", "columns", "kept")),
        *((name, c_void_p) for name in ("controls", "costs", "states")),
    )


def supports_costs(table: tuple[CostLayer, ...]) -> bool:
    """Return whether there is compiled code of the declared cost terms for maps of these layers."""
    return _planning_library(tuple(cost_terms()), table) is not None


@cache
def _planning_library(terms: tuple[str, ...], table: tuple[CostLayer, ...]) -> CDLL | None:
    return planning_library(terms_text(table))


@torch.no_grad()
def encode_map(maps: MapStack, encoder: FeatureEncoder | None) -> Codes:
    """Encode the cells of the first map of a stack."""
    features = maps.features[0]
    if encoder is None:
        return features[..., :0].float(), torch.zeros(0, device=features.device)
    missing = encoder.missing()
    cells = features.flatten(0, 1).to(missing.dtype)
    seen = cells.sum(dim=-1).isfinite()  # not finite if one feature is not; faster than testing each
    return codes_by_cell(encoder, cells, seen).unflatten(0, features.shape[:2]), missing


@torch.no_grad()
def coded_map(codes: Float[Tensor, "ny nx n"], encoder: FeatureEncoder) -> Codes:
    """Return the codes of a map that already holds codes; non-finite ones are missing.

    Raises:
        ValueError: their length differs from the encoder's.
    """
    missing = encoder.missing()
    if codes.shape[-1] != encoder.size:
        raise ValueError(f"the map has codes of length {codes.shape[-1]}; the encoder's have length {encoder.size}")
    return codes.to(missing.dtype).where(codes.isfinite().all(dim=-1, keepdim=True), missing), missing


def fused_costs(
    dynamics: Dynamics, model_state: ModelState, situation: Situation, weights: CostWeights, codes: Codes
) -> CostOf:
    """Return a function that computes the costs of driving, as `driving_cost.driving_costs` up to rounding.

    Args:
        dynamics: model supported by the kernels (`dynamics.kernels.autograd.supports`).
        model_state: model state at the start, a batch of one.
        codes: from `encode_map`.

    Raises:
        ValueError: unsupported model, types or shapes.
    """
    roll = _bind(dynamics, model_state, situation, weights, codes)
    return lambda controls: roll(controls, None)


def fused_rollout(
    dynamics: Dynamics,
    model_state: ModelState,
    controls: Float[Tensor, "K T U"],
    situation: Situation,
    weights: CostWeights,
    codes: Codes,
) -> tuple[Float[Tensor, " K"], Float[Tensor, "K T 6"]]:
    """Return the same costs, and the states after each step."""
    states = controls.new_empty(*controls.shape[:2], 6)
    return _bind(dynamics, model_state, situation, weights, codes)(controls, states), states


def kernel_model_state(
    dynamics: Dynamics,
    model_state: ModelState,
    controls: Float[Tensor, "T U"],
    situation: Situation,
    codes: Codes,
) -> ModelState:
    """Return the model state after at least one step of controls."""
    after = controls.new_empty(1, len(controls), model_state.pack().shape[1])
    _bind(dynamics, model_state, situation, CostWeights(), codes)(controls[None], after)
    result = from_kernel_state(after[:, -1])
    recorded = torch.tensor([name in dynamics.vehicle.actuators for name in ACTUATORS])
    return replace(result, actuators=result.actuators.where(recorded, model_state.actuators))


@torch.no_grad()
def _bind(
    dynamics: Dynamics, model_state: ModelState, situation: Situation, weights: CostWeights, codes: Codes
) -> Callable[[Tensor, Tensor | None], Tensor]:
    _check(dynamics, model_state, codes)
    vehicle, model, arrays = dynamics.vehicle, model_of(dynamics), Arrays()
    given = _situation(dynamics, model_state, situation, weights, codes, arrays)
    given.arrays = arrays
    library = _planning_library(tuple(cost_terms()), situation.costs.table)
    if library is None:
        raise ValueError("no kernel for these cost terms; see `supports_costs`")

    def roll(controls: Tensor, states: Tensor | None) -> Tensor:
        widths, wanted = {len(CONTROL), len(vehicle.control_columns)}, (torch.float32, torch.device("cpu"))
        if controls.ndim != 3 or controls.shape[2] not in widths or (controls.dtype, controls.device) != wanted:
            result = f"{list(controls.shape)}, {controls.dtype} on {controls.device}"
            raise ValueError(f"controls are {result}, but the kernel needs [K, T, {min(widths)}], float32 on the CPU")
        own, costs = Arrays(), controls.new_empty(len(controls))
        completed = complete(vehicle, controls, situation.gear)
        samples = _Samples(
            *completed.shape,
            0 if states is None else states.shape[2],
            own.floats(completed),
            own.bytes(costs),
            None if states is None else own.bytes(states),
        )
        call("plan", -(-len(controls) // CHUNK), model, given, samples, of=library)
        return costs

    return roll


def _situation(
    dynamics: Dynamics,
    model_state: ModelState,
    situation: Situation,
    weights: CostWeights,
    codes: Codes,
    arrays: Arrays,
) -> _Situation:
    maps, costs, slope = situation.ground, situation.costs, situation.ground.slope[0]
    cells, missing = codes
    if slope.shape[1] == 1:
        slope = slope.expand(-1, 2, -1)
    if max(array.numel() for array in (slope, cells, costs.layers)) >= 2**31:
        raise ValueError("a map of 2^31 numbers or more is not supported")
    ground, of_costs = (_Grid(*grid_numbers(situation, of)) for of in (maps, costs))
    return _Situation(
        ground=ground,
        costs=of_costs,
        wheels=_Eight(*situation.wheels.flatten().tolist()),
        control=_Three(*situation.control.tolist()),
        start=arrays.floats(to_kernel_state(model_state)),
        slope=arrays.floats(slope),
        codes=arrays.floats(cells),
        missing=arrays.floats(missing),
        layers=arrays.floats(costs.layers),
        outside=arrays.floats(torch.tensor(costs.outside)),
        numbers=arrays.floats(weights.vector()),
        reads=arrays.whole([READINGS.index(layer.read) for layer in costs.table]),
        layer_count=len(costs.table),
        one_grid=bytes(ground) == bytes(of_costs),
        stray=_stray(situation.caution, dynamics, arrays),
    )


def grid_numbers(situation: Situation, cells: MapStack | CostMap) -> tuple[float | int, ...]:
    """Return the offset of the first cell from the situation [m], cells per metre, rows and columns."""
    origin = cells.origin[0] if isinstance(cells, MapStack) else cells.origin
    rows, columns = cells.shape if isinstance(cells, MapStack) else cells.layers.shape[:2]
    return *(situation.offset.cpu() - origin.cpu()).tolist(), 1 / cells.resolution, rows, columns


def _stray(caution: Caution | None, dynamics: Dynamics, arrays: Arrays) -> _Stray:
    """Return the network of a spread; none without caution."""
    if caution is None:
        return _Stray(every=1)
    of = spread_weights(caution, dynamics.vehicle, dynamics.codes)
    more = -len(of.bias) % 4
    return _Stray(
        hidden=len(of.bias) + more,
        inputs=len(of.inner),
        every=EVERY,
        inner=arrays.floats(pad(of.inner, (0, more))),
        bias=arrays.floats(pad(of.bias, (0, more))),
        outer=arrays.floats(pad(of.outer, (0, 2, 0, more))),
        outer_bias=_Two(*of.outer_bias.tolist()),
        start=_Two(*of.start.tolist()),
        reach=of.reach,
        interval=INTERVAL,
        dt=DT,
    )


def _check(dynamics: Dynamics, model_state: ModelState, codes: Codes) -> None:
    """Raise for inputs that the kernel would read wrongly or out of bounds."""
    if not supports(dynamics, model_state.state.device, model_state.state.dtype):
        raise ValueError("no kernel for this model; see `supports`")
    result, needed = list(model_state.pack().shape), [1, len(layout.STEPPED) + dynamics.recurrent_size]
    if result != needed:
        raise ValueError(f"the start is {result}, but the kernel needs {needed}")
    if codes[0].shape[-1] != dynamics.codes or len(codes[1]) != dynamics.codes:
        raise ValueError(f"codes have length {codes[0].shape[-1]}, but the model reads {dynamics.codes}")
