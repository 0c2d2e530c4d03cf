"""A vehicle with two tracks: its two controls, and a model that turns their speeds into motion.

Rigs may then have [channels.left_track] and [channels.right_track], and `--model skid-steer` trains the model:

    export PYTHONPATH=examples/extending OFFPISTE_EXTENSIONS=skid_steer
    offpiste extract drive.csv --rig tracked.toml --out tracked.zarr
    offpiste train tracked.zarr --out run --model skid-steer

The wheels of the rig are the ends of the tracks.
"""

import torch
from torch import Tensor, nn

from offpiste.core.channels import Control, register_control
from offpiste.core.conventions import DT
from offpiste.core.errors import RunError
from offpiste.core.state import ModelState, Terrain
from offpiste.dynamics import Dynamics, Vehicle, register_model
from offpiste.dynamics.base import Step
from offpiste.dynamics.torch_physics import mean_normal

TRACKS = ("left_track", "right_track")

for name in TRACKS:
    register_control(Control(name, unit="m/s", low=-5.0, high=5.0, rate=5.0, pattern=name))

RANGES = {
    "forward": (0.5, 1.1, 0.95),  # speed over the mean of the tracks
    "turning": (0.2, 1.1, 0.6),  # yaw rate over that of tracks that do not slip
    "forward_rate": (0.2, 30.0, 5.0),  # how fast speed, yaw rate and sliding settle [1/s]
    "turning_rate": (0.2, 30.0, 5.0),
    "sliding_rate": (0.2, 30.0, 5.0),
    "gravity_x": (0.0, 10.0, 2.0),  # pull of slopes [m/s^2]
    "gravity_y": (0.0, 10.0, 2.0),
}
"""Least, largest and initial value of each learned constant."""


@register_model("skid-steer", colour="#e69f00", fits=lambda vehicle: set(TRACKS) <= set(vehicle.control))
class SkidSteer(Dynamics):
    """Speed and yaw rate follow the tracks', with slip and lag that are learned.

    Raises:
        RunError: the vehicle has no tracks.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        if not set(TRACKS) <= set(vehicle.control):
            raise RunError("skid-steer reads left_track and right_track", how="give both in the rig")
        low, high, initial = (torch.tensor(column) for column in zip(*RANGES.values(), strict=True))
        self.low: Tensor
        self.width: Tensor
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("width", high - low, persistent=False)
        self.raw = nn.Parameter(torch.logit((initial - low) / (high - low)))

    def stepper(self) -> Step:
        """Rates, then forward Euler."""
        c = dict(zip(RANGES, (self.low + self.width * torch.sigmoid(self.raw)).unbind(), strict=True))
        left_column, right_column = (self.vehicle.control_columns.index(name) for name in TRACKS)

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            _, _, yaw, vx, vy, yaw_rate = model_state.state.unbind(-1)
            left, right = control[:, left_column], control[:, right_column]
            normal = mean_normal(terrain, yaw)
            change = (
                torch.cos(yaw) * vx - torch.sin(yaw) * vy,
                torch.sin(yaw) * vx + torch.cos(yaw) * vy,
                yaw_rate,
                c["forward_rate"] * (c["forward"] * (left + right) / 2 - vx) + c["gravity_x"] * normal[:, 0],
                -c["sliding_rate"] * vy + c["gravity_y"] * normal[:, 1],
                c["turning_rate"] * (c["turning"] * (right - left) / self.vehicle.track - yaw_rate),
            )
            state = model_state.state + DT * torch.stack(change, dim=-1)
            return ModelState(state, model_state.actuators, model_state.recurrent)

        return step
