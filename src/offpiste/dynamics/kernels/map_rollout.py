"""Rollouts over maps that are read under predicted wheels, by kernels and without gradients: validation and evaluation.

Each block of lanes finds its cells, encodes their features and steps on, so that nothing but the maps lies in memory.
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import ACTUATORS, STATE
from offpiste.core.state import ModelState, TerrainSource, Trajectory
from offpiste.dynamics.base import Dynamics, rollout
from offpiste.dynamics.kernels.autograd import supports
from offpiste.dynamics.kernels.coverage import uncovered_encoder
from offpiste.dynamics.kernels.elementary import f4
from offpiste.dynamics.kernels.encoder import CELLS, Activations, Layers, encode_block, layers_of, make_activations
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.map_samples import WHEELS, Ground, Samples, make_samples, sample_ground
from offpiste.dynamics.kernels.model_arrays import (
    compensator_weights,
    constants,
    learned_constants,
    networks,
    recorded_channels,
    to_kernel_state,
)
from offpiste.dynamics.kernels.rollout import (
    CODES,
    Networks,
    advance_block,
    begin,
    keep,
    load_controls,
    make_buffer_sets,
    make_workspace,
)
from offpiste.mapping.terrain_sampler import CellStack, MapTerrain
from offpiste.native.compilation import KERNELS, spread_kernel


def predict_on(
    dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T U"], source: TerrainSource
) -> Trajectory:
    """`rollout` of the same arguments, by the kernel where it can and no gradient is wanted."""
    stepped = not torch.is_grad_enabled() and supports(dynamics, controls.device, controls.dtype)
    if not stepped or not isinstance(source, MapTerrain) or not _supports_maps(dynamics, source):
        return rollout(dynamics, model_state, controls, source)
    return rollout_on_maps(dynamics, model_state, controls, source)


def _supports_maps(dynamics: Dynamics, terrain: MapTerrain) -> bool:
    """Whether the maps are lists of float16 cells, and their features are read as the model encodes them."""
    maps, encoders = terrain.maps, (None, dynamics.encoder)
    if not isinstance(maps, CellStack) or uncovered_encoder(dynamics.encoder):
        return False
    return maps.slope.dtype == maps.features.dtype == torch.float16 and terrain.encode in encoders


def rollout_on_maps(
    dynamics: Dynamics,
    model_state: ModelState,
    controls: Float[Tensor, "B T U"],
    terrain: MapTerrain,
) -> Trajectory:
    """Predict T steps, reading maps of float16 cells."""
    maps = terrain.maps
    assert isinstance(maps, CellStack)
    shift = (terrain.offset - maps.origin[terrain.number]).float()
    ground = Ground(
        shift=shift.numpy(),
        number=terrain.number.numpy(),
        resolution=np.float32(maps.resolution),
        wheels=terrain.wheels.contiguous().numpy(),
        last=maps.last.numpy(),
        place=maps.place.numpy(),
        slope=maps.slope.numpy().view(np.uint16),
        features=maps.features.numpy().view(np.uint16),
    )

    batch, steps = controls.shape[:2]
    matrices = compensator_weights(dynamics)
    states = torch.empty(batch, steps, len(STATE), dtype=torch.float32)
    actuators = torch.empty(batch, steps, len(ACTUATORS), dtype=torch.float32)
    given = (
        to_kernel_state(model_state).detach().contiguous().numpy(),
        controls.detach().contiguous().numpy(),
        recorded_channels(dynamics.vehicle),
        constants(dynamics, learned_constants(dynamics)),
        networks(dynamics, matrices),
        ground,
        layers_of(dynamics.encoder),
        4 * dynamics.codes,
    )
    spread_kernel(-(-batch // LANES), forward_on_maps, *given, states.numpy(), actuators.numpy())
    return Trajectory(states, actuators)


@KERNELS.loop
def _encode(w: np.ndarray, s: Samples, a: Activations, layers: Layers, size: int) -> None:
    """Codes of the samples into the workspace, `size` under each wheel."""
    channels = len(layers.mean)
    if layers.first.shape[0] == 0:  # the features are the codes, with their flag
        for k in range(WHEELS):
            for i in range(LANES):
                valid = s.valid[k * LANES + i]
                for e in range(channels):
                    w[(CODES + k * size + e) * LANES + i] = s.features[k * LANES + i, e] if valid else layers.mean[e]
                w[(CODES + k * size + channels) * LANES + i] = f4(-1) if valid else f4(1)
        return
    for block in range(-(-WHEELS * LANES // CELLS)):
        encode_block(a, s.features, s.valid, layers, block)
        for row in range(block * CELLS, min((block + 1) * CELLS, WHEELS * LANES)):
            k, i = divmod(row, LANES)
            for e in range(size):
                w[(CODES + k * size + e) * LANES + i] = a.code[e * CELLS + row - block * CELLS]


@KERNELS.entry
def forward_on_maps(
    first: int,
    last: int,
    start: np.ndarray,
    controls: np.ndarray,
    recorded: np.ndarray,
    c: np.ndarray,
    networks: Networks,
    ground: Ground,
    layers: Layers,
    codes: int,
    states: np.ndarray,
    actuators: np.ndarray,
) -> None:
    """Roll blocks `first` ... `last - 1` out, as `rollout.forward`, over maps instead of a record.

    Args:
        codes: numbers that the networks read of all wheels.
    """
    steps = controls.shape[1]
    w = make_workspace(codes, recorded)
    tape = np.zeros((2, start.shape[1] * LANES), f4)
    buffer_sets, samples = make_buffer_sets(networks, f4(1)), make_samples(layers)
    activations = make_activations(layers, f4(1))
    for block in range(first, last):
        begin(start, recorded, tape[0], block)
        for t in range(steps):
            before, after = tape[t % 2], tape[(t + 1) % 2]
            load_controls(w, controls, recorded, block, t)
            sample_ground(w, before, ground, samples, block, codes > 0)
            if codes > 0:
                _encode(w, samples, activations, layers, codes // WHEELS)
            advance_block(w, c, networks, buffer_sets, before, after)
            keep(after, start, recorded, block, t, states, actuators)
