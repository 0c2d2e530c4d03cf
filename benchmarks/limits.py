"""What limits the 5 s error on a dataset's test part: the record's own consistency, and perfect knowledge of the speed.

`python benchmarks/limits.py dataset.zarr`: mean and median position error after 5 s of
- integrating the *recorded* velocities and yaw: what the positions' own jumps leave to any model;
- the kinematic bicycle, as the reports have it;
- the kinematic bicycle given the recorded speed of the future: what is due to the steering alone.
"""

import sys
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import DT, EVALUATION_STRIDE
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Kinematic
from offpiste.state import RecordedTerrain
from offpiste.training.build import vehicle_of
from offpiste.training.train import predict


def integrated(states: Float[Tensor, "B T 6"]) -> Float[Tensor, "B 2"]:
    """Where recorded velocities and yaw lead from the first state [m]."""
    yaw, vx, vy = states[..., 2], states[..., 3], states[..., 4]
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    velocity = torch.stack((cos * vx - sin * vy, sin * vx + cos * vy), dim=-1)
    return states[:, 0, :2] + DT * velocity[:, :-1].sum(dim=1)


def informed(kinematic: Kinematic, batch: Batch) -> Float[Tensor, "B 2"]:
    """The kinematic bicycle with the recorded speed put in at every step [m]."""
    step, states = kinematic.stepper(), torch.cat((batch.state[:, None], batch.target), dim=1)
    model_state = kinematic.start(batch.history, batch.state, batch.actuators)
    for t in range(batch.control.shape[1]):
        state = torch.cat((model_state.state[:, :3], states[:, t, 3:4], model_state.state[:, 4:]), dim=1)
        terrain = RecordedTerrain(batch.terrain).at(t, batch.state)
        model_state = step(replace(model_state, state=state), batch.control[:, t], terrain)
    return model_state.state[:, :2]


def main(path: str) -> None:
    """Print a line a limit."""
    dataset = open_dataset(path)
    windows = Windows(dataset, "test")
    batch = windows.gather(windows.every(EVALUATION_STRIDE))
    kinematic = Kinematic(vehicle_of(dataset))
    with torch.no_grad():
        places = {
            "recorded velocities, integrated": integrated(torch.cat((batch.state[:, None], batch.target), dim=1)),
            "kinematic": predict(kinematic, batch).state[:, -1, :2],
            "kinematic with the recorded speed": informed(kinematic, batch),
        }
    for name, place in places.items():
        error = (place - batch.target[:, -1, :2]).norm(dim=-1)
        print(f"{name:36} mean {error.mean():.2f} m  median {error.median():.2f} m  ({len(error)} windows)")


if __name__ == "__main__":
    main(sys.argv[1])
