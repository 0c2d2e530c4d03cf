"""Plan with a trained model on the map of a log: MPPI to a goal ahead, around hazards.

    python examples/plan_on_map.py pretrained:proving-ground/dc drive.mcap proving_ground --seconds 5 --ahead 10

The vehicle starts as it was recorded that many seconds after the start of the log.
"""

import argparse
import sys

from matplotlib import pyplot as plt

import offpiste


def draw(scene: offpiste.Scene, goal: offpiste.Goal, plan: offpiste.DrivingPlan, out: str) -> None:
    """Draw the plan from above on the slope of the map, and its controls."""
    figure, (above, below) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    layers = scene.layers
    (x, y), (ny, nx) = layers.origin, layers.known.shape
    extent = (x, x + nx * layers.resolution, y, y + ny * layers.resolution)
    picture = above.imshow(layers.slope, origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=0.6)
    figure.colorbar(picture, ax=above, label="slope (rise over run)")
    above.plot(*plan.states[:, :2].T, color="tab:orange", linewidth=2, label="plan")
    above.plot(*goal.place, "r*", markersize=12, label="goal")
    x, y = scene.state[:2]
    above.set(xlabel="x [m]", ylabel="y [m]", xlim=(x - 20, x + 20), ylim=(y - 20, y + 20))
    above.legend()
    below.plot([0.02 * step for step in range(len(plan.controls))], plan.controls, label=["throttle", "brake", "steer"])
    below.set(xlabel="time [s]", ylabel="control")
    below.legend()
    figure.savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", help="a folder that `offpiste train` wrote, or pretrained:NAME")
    parser.add_argument("log", help="a recorded drive")
    parser.add_argument("rig", help="its rig: a file or the name of a preset")
    parser.add_argument("--pca", help="file of the PCA that the run was trained with; shipped models have theirs")
    parser.add_argument("--seconds", type=float, default=5.0, help="start of the plan in the log [s]")
    parser.add_argument("--ahead", type=float, default=10.0, help="place of the goal [m]")
    parser.add_argument("--left", type=float, default=4.0, help="place of the goal [m]")
    parser.add_argument("--out", default="plan.png")
    given = parser.parse_args()
    try:
        planner = offpiste.load_planner(given.run, given.pca)
        scene = offpiste.read_scene(offpiste.open_log(given.log), offpiste.load_rig(given.rig), planner, given.seconds)
        goal = offpiste.Goal(scene.ahead(given.ahead, given.left), speed=4.0)
        plan = offpiste.plan(planner, scene, goal)
    except offpiste.OffpisteError as error:
        sys.exit(f"plan_on_map.py: {error}")
    draw(scene, goal, plan, given.out)
    x, y = plan.states[-1, :2] - goal.place
    print(f"{given.out}: after {0.02 * len(plan.states):.1f} s {(x * x + y * y) ** 0.5:.1f} m from the goal")
