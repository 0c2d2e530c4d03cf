"""Plan on the map of a recorded place with a learned model: MPPI to a goal ahead, around steep ground.

    python examples/plan_on_map.py runs/dc dataset.zarr --ahead 10 --left 4

The vehicle starts as it was recorded at the first window of the test part; the dataset needs maps (`extract --pca`).
"""

import argparse
import sys

import numpy as np
import torch
from matplotlib import pyplot as plt
from torch import Tensor

import offpiste
from offpiste.mapping.terrain_sampler import MapStack
from offpiste.planning.mppi import PEDALS_AND_WHEEL, Settings, improve
from offpiste.planning.rollouts import model_costs, spread_model_state
from offpiste.training.prediction import map_terrain

torch.set_num_threads(1)  # the tensors are small: threads cost more than they bring

STEPS, SAMPLES, ROUNDS = 100, 256, 8
"""2 s ahead; control sequences tried at a time; and how often."""

STEEP = 0.3
"""Slope that costs nothing (rise over run)."""


class Scene:
    """A recorded start, the map around it and a goal; places are relative to the start, along the world's axes.

    Args:
        goal: ahead and left of the vehicle [m].
    """

    def __init__(self, run_folder: str, dataset_folder: str, goal: tuple[float, float]) -> None:
        self.model = offpiste.load_run(run_folder).dynamics.requires_grad_(False)
        windows, first = offpiste.Windows(offpiste.open_dataset(dataset_folder), "test"), np.zeros(1, int)
        batch = offpiste.encoded(self.model, windows.gather(first))
        self.start = self.model.start(batch.history, batch.state, batch.actuators)
        self.terrain = map_terrain(self.model, windows, np.repeat(first, SAMPLES))
        yaw = float(batch.state[0, 2])
        turn = torch.tensor([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]).float()
        self.goal = batch.state[0, :2] + turn @ torch.tensor(goal)

    def predict(self, controls: Tensor) -> Tensor:
        """States under control sequences [K, T, 3] -> [K, T, 6]."""
        start = spread_model_state(self.start, len(controls))
        return offpiste.rollout(self.model, start, controls, self.terrain).state

    def cost(self, trajectory: offpiste.Trajectory, controls: Tensor) -> Tensor:
        """Mean distance to the goal [m], and steep ground under the wheels, of K trajectories."""
        away = torch.linalg.vector_norm(trajectory.state[..., :2] - self.goal, dim=-1).mean(dim=1)
        normals = torch.stack([self.terrain.at(0, state).normal for state in trajectory.state[:, ::25].unbind(dim=1)])
        slope = torch.linalg.vector_norm(normals[..., :2], dim=-1) / normals[..., 2]
        return away + 100 * (slope - STEEP).clamp(min=0).mean(dim=(0, 2))


def plan(scene: Scene, *, seed: int = 0) -> Tensor:
    """Controls to the goal [T, 3]: throttle, brake, steer."""
    settings = Settings(PEDALS_AND_WHEEL, deviation=(0.3, 0.1, 0.3), samples=SAMPLES, temperature=0.1)
    cost_of = model_costs(scene.model, scene.start, scene.terrain, scene.cost)
    controls, generator = torch.zeros(STEPS, 3), torch.Generator().manual_seed(seed)
    for _ in range(ROUNDS):
        controls = improve(controls, cost_of, settings, generator).controls
    return controls


def draw(scene: Scene, controls: Tensor, out: str) -> None:
    """The plan from above on the slope of the map, and its controls."""
    figure, (above, below) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    maps, number = scene.terrain.maps, int(scene.terrain.number[0])
    assert isinstance(maps, MapStack)
    ny, nx = maps.shape
    rise = maps.slope_at(torch.tensor(number), torch.arange(ny)[:, None], torch.arange(nx))
    slope = torch.linalg.vector_norm(rise.float(), dim=-1)
    x, y = (maps.origin[number] - scene.terrain.offset[0]).tolist()
    box = (x, x + nx * maps.resolution, y, y + ny * maps.resolution)
    picture = above.imshow(slope, origin="lower", extent=box, cmap="Greys", vmin=0, vmax=0.6)
    figure.colorbar(picture, ax=above, label="slope (rise over run)")
    path = scene.predict(controls.expand(SAMPLES, -1, -1))[0]
    above.plot(*path[:, :2].T, color="tab:orange", linewidth=2, label="plan")
    above.plot(*scene.goal, "r*", markersize=12, label="goal")
    above.set(xlabel="x [m]", ylabel="y [m]", xlim=(-20, 20), ylim=(-20, 20))
    above.legend()
    below.plot(0.02 * torch.arange(STEPS), controls, label=["throttle", "brake", "steer"])
    below.set(xlabel="time [s]", ylabel="control")
    below.legend()
    figure.savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", help="a folder that `offpiste train` wrote")
    parser.add_argument("dataset", help="what `offpiste extract --pca` wrote")
    parser.add_argument("--ahead", type=float, default=10.0, help="place of the goal [m]")
    parser.add_argument("--left", type=float, default=4.0, help="place of the goal [m]")
    parser.add_argument("--out", default="plan.png")
    given = parser.parse_args()
    try:
        scene = Scene(given.run, given.dataset, (given.ahead, given.left))
    except offpiste.OffpisteError as error:
        sys.exit(f"plan_on_map.py: {error}")
    controls = plan(scene)
    draw(scene, controls, given.out)
    end = scene.predict(controls.expand(SAMPLES, -1, -1))[0, -1, :2]
    print(f"{given.out}: after {0.02 * STEPS:.1f} s {torch.linalg.vector_norm(end - scene.goal):.1f} m from the goal")
