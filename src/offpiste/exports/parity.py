"""Parity files: inputs and predictions of a model, for checking an export on its target machine."""

import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.channels import control_columns
from offpiste.core.conventions import ACTUATORS, DT, HISTORY_STEPS, HORIZON_STEPS
from offpiste.core.state import History, Terrain
from offpiste.dynamics.base import Dynamics, rollout
from offpiste.dynamics.vehicle import Vehicle
from offpiste.mapping.terrain_sampler import MapStack, MapTerrain, last_cells
from offpiste.training.checkpoint import sha256_of_tensors

CELLS: Final = 80
RESOLUTION: Final = 1.0
"""Cell size of the synthetic map [m]."""

TRACK: Final = 1.5
"""Default track width [m]."""

HEADER: Final = b"opar"
VERSION: Final = 3

DIGEST: Final = 16
"""Length of the digest of a model [characters]."""


@dataclass(frozen=True)
class ParityCase:
    """Drives over synthetic ground with waves, unknown slopes, missing features and a border that some drives cross.

    Attributes:
        ground: stack of one map.
        wheels: positions in the body frame [m].
        past_states: states and actuators before the start.
        past_controls: in the columns of the vehicle.
        start: state and actuators.
        expected: states and actuators after each step (`rollout` in torch).
        model: `digest_of` the model.
    """

    ground: MapStack
    wheels: Float[Tensor, "4 2"]
    past_states: Float[Tensor, "D H 10"]
    past_controls: Float[Tensor, "D H U"]
    start: Float[Tensor, "D 10"]
    controls: Float[Tensor, "D T U"]
    expected: Float[Tensor, "D T 10"]
    model: str


@torch.no_grad()
def parity_case(dynamics: Dynamics, *, drives: int = 16, steps: int = HORIZON_STEPS, seed: int = 0) -> ParityCase:
    """Return the case of a model; deterministic for a seed."""
    draw = torch.Generator().manual_seed(seed)
    vehicle, ground, wheels = dynamics.vehicle, _ground(dynamics, draw), _wheels(dynamics.vehicle)
    past, start = _drives(vehicle, drives, draw)
    commands = _commands(vehicle, drives, HISTORY_STEPS + steps, draw)
    past_controls, controls = commands[:, :HISTORY_STEPS], commands[:, HISTORY_STEPS:]
    history = _history(dynamics, ground, wheels, past, past_controls)
    model_state = dynamics.start(history, start[:, :6], start[:, 6:])
    ahead = _source(dynamics, ground, wheels, drives)
    trajectory = rollout(dynamics, model_state, controls, ahead)
    expected = torch.cat((trajectory.state, trajectory.actuators), dim=-1)
    return ParityCase(ground, wheels, past, past_controls, start, controls, expected, digest_of(dynamics))


def past_of(dynamics: Dynamics, case: ParityCase) -> History:
    """Return the history of the drives before their start."""
    return _history(dynamics, case.ground, case.wheels, case.past_states, case.past_controls)


def _history(dynamics: Dynamics, ground: MapStack, wheels: Tensor, past: Tensor, controls: Tensor) -> History:
    source = _source(dynamics, ground, wheels, past.shape[0] * past.shape[1])
    under = source.at(0, past[..., :6].flatten(0, 1))
    terrain = Terrain(*(part.unflatten(0, past.shape[:2]) for part in (under.normal, under.known, under.latent)))
    return History(past[..., :6], past[..., 6:], controls, terrain)


def digest_of(dynamics: Dynamics) -> str:
    """Return the digest of weights and channels, by which an export recognises its parity file."""
    return sha256_of_tensors(dynamics.state_dict(), {"vehicle": repr(dynamics.vehicle)})[:DIGEST]


def features_of(dynamics: Dynamics) -> int:
    """Return the number of terrain features that a model reads per cell."""
    return 0 if dynamics.encoder is None else len(dynamics.encoder.mean)


def parity_bytes(case: ParityCase) -> bytes:
    """Serialise a case in the format of parity.h."""
    _, rows, columns, features = case.ground.features.shape
    drives, past, controls = case.past_controls.shape
    sizes = (VERSION, rows, columns, features, drives, past, case.controls.shape[1], controls)
    place = torch.cat((case.ground.origin[0].float(), torch.tensor([case.ground.resolution])))
    parts = (
        place, case.wheels, case.ground.slope[0], case.ground.features[0], case.past_states, case.past_controls,
        case.start, case.controls, case.expected,
    )  # fmt: skip
    numbers = [np.nan_to_num(part.numpy(), nan=0.0) if part is case.start else part.numpy() for part in parts]
    head = HEADER + np.array(sizes, "<i4").tobytes() + case.model.encode()
    content = head + b"".join(part.astype("<f4").tobytes() for part in numbers)
    return content + zlib.crc32(content).to_bytes(4, "little")


def _source(dynamics: Dynamics, ground: MapStack, wheels: Tensor, count: int) -> MapTerrain:
    number, offset = torch.zeros(count, dtype=torch.long), torch.zeros(count, 2, dtype=torch.float64)
    return MapTerrain(ground, number, offset, wheels, dynamics.encoder)


def _wheels(vehicle: Vehicle) -> Float[Tensor, "4 2"]:
    front, half = vehicle.wheelbase - vehicle.rear_axle, (vehicle.track or TRACK) / 2
    rear = -vehicle.rear_axle
    return torch.tensor([[front, half], [front, -half], [rear, half], [rear, -half]], dtype=torch.float32)


def _ground(dynamics: Dynamics, draw: torch.Generator) -> MapStack:
    """Return smooth waves of slopes and features, so that neighbouring cells differ little."""
    half = RESOLUTION * (CELLS - 1) / 2
    y, x = torch.meshgrid(*(torch.linspace(-half, half, CELLS),) * 2, indexing="ij")
    slope = torch.stack((0.1 * torch.sin(x / 6), 0.08 * torch.cos(y / 8)), dim=-1)
    slope[(x > 12) & (x < 14)] = torch.nan
    count = features_of(dynamics)
    waves = torch.randn(4, count, generator=draw) * 0.15
    features = torch.randn(count, generator=draw) + torch.stack(
        [waves[n] * torch.sin((x if n % 2 else y) / (7 + 3 * n))[..., None] for n in range(4)]
    ).sum(dim=0)
    if dynamics.encoder is not None:
        mean = dynamics.encoder.mean
        features = mean + features * getattr(dynamics.encoder, "scale", torch.ones_like(mean))
    features[(y > 6) & (y < 9)] = torch.nan
    origin = torch.tensor([[-half, -half]], dtype=torch.float64)
    return MapStack(
        RESOLUTION, origin, last_cells([(CELLS, CELLS)]), slope[None].contiguous(), features[None].contiguous()
    )


def _drives(vehicle: Vehicle, drives: int, draw: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return past states and actuators along circular arcs, and the start at their end."""
    place = 40 * torch.rand(drives, 2, generator=draw) - 20
    yaw, speed = 6 * torch.rand(drives, generator=draw) - 3, 3 + 5 * torch.rand(drives, generator=draw)
    rate = 0.3 * torch.randn(drives, generator=draw)
    time = DT * torch.arange(-HISTORY_STEPS, 1)
    heading = yaw[:, None] + rate[:, None] * time
    along = speed[:, None] * time
    middle = yaw[:, None] + rate[:, None] * time / 2
    x, y = (place[:, i, None] + along * turn(middle) for i, turn in enumerate((torch.cos, torch.sin)))
    level = torch.rand(drives, 4, generator=draw) * torch.tensor([0.2, 0.2, 0.1, 2.0]) + torch.tensor([0, -0.1, 0, 1.0])
    absent = torch.tensor([name not in vehicle.actuators for name in ACTUATORS])
    actuators = torch.where(absent, torch.nan, level)[:, None].expand(-1, len(time), -1)
    columns = (x, y, heading, speed[:, None].expand_as(x), torch.zeros_like(x), rate[:, None].expand_as(x))
    rows = torch.cat((torch.stack(columns, dim=-1), actuators), dim=-1)
    return rows[:, :-1].contiguous(), rows[:, -1].contiguous()


def _commands(vehicle: Vehicle, drives: int, steps: int, draw: torch.Generator) -> Tensor:
    """Return smooth commands within their limits; NaN for controls that the vehicle lacks."""
    columns = control_columns(vehicle.control)
    knots = torch.rand(drives, len(columns), 12, generator=draw)
    smooth = torch.nn.functional.interpolate(knots, steps, mode="linear").transpose(1, 2)
    low, high = (torch.tensor([getattr(column, end) for column in columns]) for end in ("low", "high"))
    values = 0.6 * (low + (high - low) * smooth)
    for place, column in enumerate(columns):
        if column.discrete:
            values[..., place] = column.absent
        if column.name == "brake":
            values[..., place] = (values[..., place] - 0.4).clamp(min=0)
        if column.name not in vehicle.control:
            values[..., place] = torch.nan
    return values.contiguous()
