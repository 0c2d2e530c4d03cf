"""Predictions on the part of the map within reach, by the kernel or, for other models, step by step in torch."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT, HORIZON_STEPS
from offpiste.core.state import History, ModelState, Terrain, TerrainSource
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.dynamics.kernels.autograd import supports
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.mapping.terrain_sampler import Encode, MapStack, MapTerrain, as_codes, stack_maps
from offpiste.planning.controls import complete
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation, driving_costs
from offpiste.planning.kernel import Codes, coded_map, fused_costs, fused_rollout, kernel_model_state, supports_costs
from offpiste.planning.mppi import CostOf
from offpiste.runtime.estimator import TrackRows

KnownGround = Callable[[Float[np.ndarray, "M 2"]], Float[np.ndarray, "M F"]]
"""Function that returns ground-truth features at places x, y [m] in a simulator."""


@dataclass(frozen=True)
class Area:
    """Map layers within reach of a plan, as arrays and as tensors."""

    layers: TerrainLayers
    stack: MapStack  # of one map, with codes as features
    codes: Codes  # for `fused_costs`

    @property
    def encode(self) -> Encode | None:
        """Encoder for reading the codes of the stack; None without codes."""
        missing = self.codes[1]
        return as_codes(missing) if len(missing) else None

    def terrain(self, offset: Float[Tensor, " 2"], wheels: Float[Tensor, "4 2"], count: int) -> MapTerrain:
        """Return the terrain under the wheels of `count` states in the frame at `offset` [m]."""
        number = torch.zeros(count, dtype=torch.long)
        return MapTerrain(self.stack, number, offset.expand(count, 2), wheels, self.encode)


def reachable(
    layers: TerrainLayers, state: Float[np.ndarray, " 6"], target: float, gear: float, margin: float
) -> TerrainLayers:
    """Crop the map to the part that a plan can reach from a state at a target speed [m/s], with a margin [m]."""
    half = 0.5 * max(float(np.hypot(*state[3:5])), target) * DT * HORIZON_STEPS
    heading = gear * np.array((np.cos(state[2]), np.sin(state[2])))
    centre, half = state[:2] + half * heading, half + margin
    return layers.cropped(centre - half, centre + half)


def coded_area(layers: TerrainLayers, encoder: FeatureEncoder | None, ground: KnownGround | None = None) -> Area:
    """Return the area of a map of codes, or of ground-truth features that the encoder encodes instead."""
    if encoder is None:
        bare = replace(layers, features=layers.features[..., :0])
        stack = stack_maps([bare.terrain_map()])
        return Area(bare, stack, (stack.features[0], torch.zeros(0)))
    features = layers.features if ground is None else ground(layers.centres.reshape(-1, 2))
    held = torch.from_numpy(np.ascontiguousarray(features, np.float32))
    if ground is not None:
        every = torch.ones(len(held), dtype=torch.bool)
        held = encoder(held, every).detach().unflatten(0, layers.known.shape)
    codes, missing = coded_map(held, encoder)
    coded = replace(layers, features=codes.numpy())
    return Area(coded, stack_maps([coded.terrain_map()]), (codes, missing))


@dataclass(frozen=True)
class Prediction:
    """Predicted trajectory of a plan."""

    time: float  # start of the plan [s]
    state: Float[np.ndarray, "T 6"]  # after each step, in the world frame

    def at(self, time: float) -> Float[np.ndarray, " 6"]:
        """Return the state at the step nearest to a time [s], clamped to the plan."""
        step = round((time - self.time) / DT) - 1
        return self.state[min(max(step, 0), len(self.state) - 1)]


def model_state_of(
    model: Dynamics,
    rows: TrackRows,
    area: Area,
    wheels: Float[Tensor, "4 2"],
    offset: Float[Tensor, " 2"],
    gear: float = 1.0,
) -> ModelState:
    """Return the model state at the latest row in the frame at `offset`, warmed up on the rows before.

    `gear` is that of rows before the first command.
    """
    shift = np.concatenate((offset.numpy(), np.zeros(4)))
    state = torch.as_tensor(rows.state - shift, dtype=torch.float32)
    actuators = torch.as_tensor(rows.actuators, dtype=torch.float32)
    engaged = torch.as_tensor(np.where(np.isnan(rows.gear), gear, rows.gear)[:, None], dtype=torch.float32)
    control = complete(model.vehicle, torch.as_tensor(rows.control, dtype=torch.float32), engaged)
    past = len(state) - 1
    under = area.terrain(offset, wheels, past).at(0, state[:past])
    terrain = Terrain(under.normal[None], under.known[None], under.latent[None])
    extra = {name: torch.as_tensor(values[None, :past], dtype=torch.float32) for name, values in rows.extra.items()}
    history = History(state[None, :past], actuators[None, :past], control[None, :past], terrain, extra)
    return model.start(history, state[past:], actuators[past:])


def model_state_after(
    model: Dynamics, model_state: ModelState, controls: Float[Tensor, "L 3"], area: Area, at: Situation
) -> ModelState:
    """Return the model state after the committed controls; `at.gear` is their gear."""
    if len(controls) and _by_kernel(model, model_state, at):
        return kernel_model_state(model, model_state, controls, at, area.codes)
    ground = area.terrain(at.offset, at.wheels, 1)
    for after in _stepped(model, model_state, controls, ground, at):
        model_state = after
    return model_state


def costs_from(model: Dynamics, model_state: ModelState, area: Area, at: Situation, weights: CostWeights) -> CostOf:
    """Return a function that computes the costs of control sequences from a model state."""
    if _by_kernel(model, model_state, at):
        return fused_costs(model, model_state, at, weights, area.codes)
    return driving_costs(model, model_state, at, weights, area.encode)


def predicted(
    model: Dynamics,
    model_state: ModelState,
    controls: Float[Tensor, "T 3"],
    area: Area,
    at: Situation,
    weights: CostWeights,
) -> Float[np.ndarray, "T 6"]:
    """Predict the states of a plan in the world frame."""
    if _by_kernel(model, model_state, at):
        rolled = fused_rollout(model, model_state, controls[None], at, weights, area.codes)[1][0]
    else:
        ground = area.terrain(at.offset, at.wheels, 1)
        rolled = torch.cat([after.state for after in _stepped(model, model_state, controls, ground, at)])
    states = rolled.double().numpy()
    states[:, :2] += at.offset.numpy()
    return states


def _stepped(
    model: Dynamics, model_state: ModelState, controls: Float[Tensor, "T 3"], ground: TerrainSource, at: Situation
) -> Iterator[ModelState]:
    """Yield the model state after each step."""
    step = model.stepper()
    for t, given in enumerate(complete(model.vehicle, controls, at.gear)):
        model_state = step(model_state, given[None], ground.at(t, model_state.state))
        yield model_state


def _by_kernel(model: Dynamics, model_state: ModelState, at: Situation) -> bool:
    state = model_state.state
    return supports(model, state.device, state.dtype) and supports_costs(at.costs.table)
