"""MPPI with a control cost, and with wide and fresh samples, where the best plan is known.

Plans of one control over 50 steps, coloured noise of deviation 0.5, cost 2 (mean squared distance to 1), float64.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Generator, Tensor

from offpiste.planning.mppi import Limits, Settings, improve
from offpiste.planning.noise import coloured, covariance

STEPS, DEVIATION, GOAL = 50, 0.5, 1.0
SETTINGS = Settings(
    Limits((-math.inf,), (math.inf,)),
    (DEVIATION,),
    samples=50_000,
    temperature=1.0,
    wide=0.0,
    fresh=0.0,
    fresh_width=5.0,
    rest=(0.4,),
    control_cost=1.0,
    noise=coloured,
    iterations=1,
)


def cost_of(samples: Tensor) -> Tensor:
    """Cost of each sequence of controls."""
    return 2 * (samples[..., 0] - GOAL).square().mean(dim=1)


def closed_form() -> float:
    """Mean over the steps of the plan under exp(-cost) N(0, Sigma), which does not depend on the plan so far."""
    curvature = 4 / STEPS * torch.eye(STEPS, dtype=torch.float64)
    prior = torch.linalg.inv(DEVIATION**2 * covariance(coloured, STEPS))
    goal = torch.full((STEPS,), GOAL, dtype=torch.float64)
    return float(torch.linalg.solve(curvature + prior, curvature @ goal).mean())


def plans(settings: Settings, *, skipped: int, kept: int) -> Iterator[Tensor]:
    """Plans that follow one another, without the first `skipped`."""
    generator, plan = Generator().manual_seed(0), torch.zeros(STEPS, 1, dtype=torch.float64)
    for number in range(skipped + kept):
        plan = improve(plan, cost_of, settings, generator).controls
        if number >= skipped:
            yield plan[:, 0]


def main() -> None:
    """Print both comparisons."""
    torch.set_num_threads(1)
    print(f"with a control cost: mean of the plan, in closed form {closed_form():.3f}")
    for around in (0.0, 0.35, 0.7):
        start = torch.full((STEPS, 1), around, dtype=torch.float64)
        found = [improve(start, cost_of, SETTINGS, Generator().manual_seed(seed)) for seed in range(4)]
        means = ", ".join(f"{float(plan.controls.mean()):.3f}" for plan in found)
        effective = sum(plan.effective_samples for plan in found) / len(found)
        print(f"  around {around:.2f}: {means} (seeds 0 to 3; {effective:.0f} effective samples)")
    print(f"costs alone, 512 samples: mean of 40 plans, and root mean square distance of their steps to {GOAL:g}")
    for temperature in (1.0, 0.1):
        for wide, fresh in ((0.0, 0.0), (0.3, 0.0), (0.0, 0.1), (0.3, 0.1)):
            settings = replace(SETTINGS, control_cost=0.0, samples=512, temperature=temperature, wide=wide, fresh=fresh)
            last = torch.stack(list(plans(settings, skipped=20, kept=40)))
            off = float((last - GOAL).square().mean().sqrt())
            print(f"  temperature {temperature:g}, wide {wide:g}, fresh {fresh:g}: {float(last.mean()):.3f}, {off:.3f}")


if __name__ == "__main__":
    main()
