"""Pictures of the costs of driving: `python benchmarks/cost_pictures.py [docs]` writes planning-costs.png.

Each term over the quantity that it is of, and a plan past an obstacle to a path with the samples that it was made of.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.core.conventions import CONTROL, GRAVITY
from offpiste.core.state import ModelState
from offpiste.dynamics import Parametric, Vehicle
from offpiste.mapping.terrain_map import TerrainLayers, empty_layers
from offpiste.mapping.terrain_sampler import stack_maps
from offpiste.planning.cost_map import cost_map
from offpiste.planning.costs import terms
from offpiste.planning.costs.layers import Hazards, speed_limit
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.course import Course
from offpiste.planning.driving_cost import Situation
from offpiste.planning.kernel import encode_map, fused_costs, fused_rollout
from offpiste.planning.mppi import PEDALS_AND_WHEEL, Settings, improve, sample

WHEELS = torch.tensor([[1.1, 0.8], [1.1, -0.8], [-1.1, 0.8], [-1.1, -0.8]])
LINE, LABEL = "#2a6f97", 8


def curve(axes: Axes, x: np.ndarray, y: np.ndarray, title: str, across: str, up: str = "cost [1/s]") -> None:
    """One term."""
    axes.plot(x, y, color=LINE, linewidth=1.8)
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(across, fontsize=LABEL)
    axes.set_ylabel(up, fontsize=LABEL)
    axes.tick_params(labelsize=LABEL)
    axes.grid(alpha=0.3)


def obstacle_course(resolution: float = 0.2) -> TerrainLayers:
    """Level ground with two boulders, 60 m wide."""
    cells = round(60 / resolution)
    ground = empty_layers(cells, 0)
    ground.elevation[:], ground.slope[:], ground.roughness[:], ground.obstacle_height[:] = 0, 0, 0, 0
    ground.normal[:], ground.known[:] = (0, 0, 1), True
    x, y = np.meshgrid(*(2 * [resolution * np.arange(cells) - 30]))
    for at in ((2.0, 0.5), (9.0, -3.0)):
        ground.obstacle_height[np.hypot(x - at[0], y - at[1]) < 0.8] = 1.0
    parts = {**vars(ground), "origin": np.array([-30.0, -30.0]), "resolution": resolution}
    return TerrainLayers(**parts)


def draw_plan(axes: Axes, samples: int) -> None:
    """A plan of 5 s by a parametric model, and its samples."""
    torch.manual_seed(0)
    ground, weights = obstacle_course(), CostWeights()
    course = Course(np.array([[-30.0, 0], [30.0, 0]]), np.full(2, 6.0))
    costs = cost_map(ground, course, Hazards(margin=0.8))
    state, nowhere = torch.tensor([-10.0, 3, 0, 5, 0, 0]), torch.zeros(2, dtype=torch.float64)
    at = Situation(stack_maps([ground.terrain_map()]), costs, WHEELS, nowhere, state, torch.zeros(3))
    model = Parametric(Vehicle(1200.0, 2.1, 0.5, CONTROL, ())).requires_grad_(False)
    model_state = ModelState(state[None], torch.full((1, 4), torch.nan), torch.zeros(1, 0), torch.zeros(1, 0))
    codes, draw = encode_map(at.ground, None), torch.Generator().manual_seed(0)
    settings = Settings(PEDALS_AND_WHEEL, (0.3, 0.05, 0.25), samples=samples, iterations=8, temperature=2.0)
    cost_of = fused_costs(model, model_state, at, weights, codes)
    plan = improve(torch.zeros(250, 3), cost_of, settings, draw, previous=at.control).controls
    _, rolled = fused_rollout(model, model_state, sample(plan, settings, draw)[:300].clamp(-1, 1), at, weights, codes)
    axes.imshow(np.log1p(costs.layers[..., 0].numpy()), origin="lower", extent=(-30, 30, -30, 30), cmap="Greys", vmax=9)
    axes.plot(rolled[1:, :, 0].T, rolled[1:, :, 1].T, color="#e09f3e", linewidth=0.3, alpha=0.4)
    axes.axhline(0, color="#5b8e7d", linestyle="--", linewidth=1.2, label="course")
    axes.plot(rolled[0, :, 0], rolled[0, :, 1], color=LINE, linewidth=2.4, label="plan, 5 s")
    axes.set(xlim=(-12, 24), ylim=(-9, 9))
    axes.set_title("a plan: 8 iterations of 1,024 samples; grey: cost of obstacles", fontsize=10, loc="left")
    axes.set_xlabel("x [m]", fontsize=LABEL)
    axes.set_ylabel("y [m]", fontsize=LABEL)
    axes.tick_params(labelsize=LABEL)
    axes.legend(fontsize=LABEL, loc="lower right")


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("docs"))
    parser.add_argument("--smoke", action="store_true", help="few samples, to try it")
    options, w = parser.parse_args(arguments), CostWeights()
    figure = Figure(figsize=(11, 10), layout="constrained")
    grid = figure.add_gridspec(4, 3, height_ratios=(1, 1, 1, 2.2))
    axes = [figure.add_subplot(grid[i // 3, i % 3]) for i in range(9)]
    x = np.linspace(-3, 3, 201)
    curve(axes[0], x, terms.path_term(x, 0.0, w.path), "off the path", "distance [m]")
    v = np.linspace(0, 12, 201)
    along = terms.speed_term(v, 6.0, w.speed)
    curve(axes[1], v, along, "along the course (target 6 m/s)", "speed along [m/s]")
    over = terms.overspeed_term(v, 4.0, w.overspeed, np.maximum)
    curve(axes[2], v, over, "over the ground's limit (4 m/s)", "speed [m/s]")
    h = Hazards()
    rough = np.linspace(0.01, 0.3, 201)
    curve(axes[3], rough, speed_limit(rough, h.bump, h.bump_length), "limit by roughness", "rms [m]", "limit [m/s]")
    rise = np.linspace(0, 1, 201)
    curve(axes[4], rise, h.steep * np.maximum(rise - h.steepest, 0), "steep ground, each wheel / 4", "rise over run")
    a, level = np.linspace(-12, 12, 201), np.linspace(-0.6, 0.6, 5)
    for angle in level[1:4]:
        ratio = terms.lateral_ratio(a, np.sin(angle), np.cos(angle), GRAVITY, w.least_vertical, np.maximum)
        axes[5].plot(a, ratio, linewidth=1.8, label=f"side slope {np.degrees(angle):.0f}°")
    axes[5].axhline(w.lateral_limit, color="black", linewidth=0.8, linestyle=":")
    axes[5].legend(fontsize=7)
    axes[5].set_title("lateral over vertical acceleration", fontsize=10, loc="left")
    axes[5].set_xlabel("lateral acceleration, + left [m/s²]", fontsize=LABEL)
    axes[5].tick_params(labelsize=LABEL)
    axes[5].grid(alpha=0.3)
    r = np.linspace(0, 1.5, 601)
    curve(axes[6], r, terms.rollover_term(r, w.lateral_limit, w.rollover, np.maximum), "rollover", "ratio")
    u = np.linspace(-1, 1, 201)
    curve(axes[7], u, terms.effort_term(u, w.effort[2]), "effort: steering", "command")
    rate = np.linspace(-4, 4, 201)
    curve(axes[8], rate, terms.jerk_term(rate * 0.02, 0.0, 0.02, w.jerk[2]), "jerk: steering", "change [1/s]")
    draw_plan(figure.add_subplot(grid[3, :]), samples=16 if options.smoke else 1024)
    figure.savefig(options.folder / "planning-costs.png", dpi=90)


if __name__ == "__main__":
    main()
