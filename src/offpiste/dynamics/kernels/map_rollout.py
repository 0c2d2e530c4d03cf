"""Rollouts over maps that are read under predicted wheels, without gradients: validation and evaluation.

Each block of lanes finds its cells, encodes their features and steps on, so that nothing but the maps lies in memory.
"""

from ctypes import Structure, c_float, c_int, c_void_p

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import ACTUATORS, STATE
from offpiste.core.state import ModelState, TerrainSource, Trajectory
from offpiste.dynamics.base import Dynamics, rollout
from offpiste.dynamics.kernels.autograd import supports
from offpiste.dynamics.kernels.coverage import uncovered_encoder
from offpiste.dynamics.kernels.encoder import encoder_of
from offpiste.dynamics.kernels.model_state import to_kernel_state
from offpiste.dynamics.kernels.structures import model_of
from offpiste.mapping.terrain_sampler import CellStack, MapTerrain
from offpiste.native.tensors import CHUNK, Arrays, call, new_floats

_Eight = c_float * 8


class _Maps(Structure):
    _fields_ = (
        ("batch", c_int),
        ("steps", c_int),
        *((name, c_void_p) for name in ("start", "controls", "shift", "number", "last", "place")),
        *((name, c_int) for name in ("rows", "columns", "cells", "stride")),
        ("resolution", c_float),
        ("wheels", _Eight),
        ("slope", c_void_p),
        ("features", c_void_p),
    )


def predict_on(
    dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T U"], source: TerrainSource
) -> Trajectory:
    """`rollout` of the same arguments, by the kernel where it can and no gradient is wanted."""
    stepped = not torch.is_grad_enabled() and supports(dynamics, controls.device, controls.dtype)
    if not stepped or not isinstance(source, MapTerrain) or not _supports_maps(dynamics, source):
        return rollout(dynamics, model_state, controls, source)
    return rollout_on_maps(dynamics, model_state, controls, source)


def _supports_maps(dynamics: Dynamics, terrain: MapTerrain) -> bool:
    """Return whether the maps are lists of float16 cells, and their features are read as the model encodes them."""
    maps, encoders = terrain.maps, (None, dynamics.encoder)
    if not isinstance(maps, CellStack) or uncovered_encoder(dynamics.encoder):
        return False
    return maps.slope.dtype == maps.features.dtype == torch.float16 and terrain.encode in encoders


def rollout_on_maps(
    dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T U"], terrain: MapTerrain
) -> Trajectory:
    """Predict T steps, reading maps of float16 cells.

    Raises:
        ValueError: cells have fewer features than the encoder reads.
    """
    maps, arrays, encoder = terrain.maps, Arrays(), encoder_of(dynamics.encoder)
    assert isinstance(maps, CellStack)
    if maps.features.shape[1] < encoder.features:
        raise ValueError(f"cells have {maps.features.shape[1]} features, but the encoder reads {encoder.features}")
    batch, steps = controls.shape[:2]
    given = _Maps(
        batch=batch,
        steps=steps,
        start=arrays.floats(to_kernel_state(model_state)),
        controls=arrays.floats(controls),
        shift=arrays.floats(terrain.offset - maps.origin[terrain.number]),
        number=arrays.whole(terrain.number),
        last=arrays.whole(maps.last),
        place=arrays.whole(maps.place),
        rows=maps.place.shape[1],
        columns=maps.place.shape[2],
        cells=len(maps.slope),
        stride=maps.features.shape[1],
        resolution=maps.resolution,
        wheels=_Eight(*terrain.wheels.flatten().tolist()),
        slope=arrays.bytes(maps.slope),
        features=arrays.bytes(maps.features),
    )
    states = new_floats(batch, steps, len(STATE))
    actuators = new_floats(batch, steps, len(ACTUATORS))
    call("forward_on_maps", -(-batch // CHUNK), model_of(dynamics), given, encoder, states, actuators)
    return Trajectory(states, actuators)
