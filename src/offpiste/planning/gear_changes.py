"""Plans that change gear once: some samples hold the gear, others are spread over moments at which it changes.

Gears cannot be averaged, so each schedule has samples and a mean of its own, and the plan that costs least is taken.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from offpiste.errors import PlanningError
from offpiste.planning.mppi import CostOf, Plan, Settings, improve
from offpiste.planning.pedal import controls_of

CostWithGear = Callable[[Float[Tensor, "K T U"], Float[Tensor, " T"]], Float[Tensor, " K"]]
"""Costs of control sequences that are driven with one schedule of gears."""


@dataclass(frozen=True)
class GearSettings:
    """Which changes of gear are sampled.

    Attributes:
        share: of the samples that change gear, evenly over the moments.
        moments: steps before a change.

    Raises:
        PlanningError: the share leaves no samples to one kind, or a moment is negative.
    """

    share: float = 0.3
    moments: tuple[int, ...] = (0, 50, 100)

    def __post_init__(self) -> None:
        if not 0 < self.share < 1 or not self.moments or min(self.moments) < 0:
            what = f"a share of {self.share:g} of samples that change gear after {self.moments} steps"
            raise PlanningError(what, how="give a share between 0 and 1, and steps of 0 or more")


class GearedPlan(NamedTuple):
    """A plan and the gear of each of its steps."""

    plan: Plan
    gear: Float[Tensor, " T"]


def schedules(gear: float, steps: int, settings: GearSettings) -> Float[Tensor, "G T"]:
    """Gears of each step: held throughout, then forward to reverse or back after each of the moments.

    Args:
        gear: engaged now, 1 or -1; neutral changes to forward.
    """
    held = torch.full((1 + len(settings.moments), steps), gear)
    for row, moment in zip(held[1:], settings.moments, strict=True):
        row[moment:] = -1.0 if gear > 0 else 1.0
    return held


def improve_with_gears(
    controls: Float[Tensor, "T U"],
    gear: float,
    cost_of: CostWithGear,
    settings: Settings,
    generator: Generator,
    *,
    gears: GearSettings | None = None,
    previous: Float[Tensor, " U"] | None = None,
) -> GearedPlan:
    """Improve a plan for each schedule of gears, and take the one that costs least; as many samples as without.

    A plan that holds the gear continues `controls`; one that changes it begins at `settings.rest` from then on.

    Args:
        gear: engaged now.
        previous: as of `mppi.improve`.

    Raises:
        PlanningError: no sample of any schedule has a finite cost.
    """
    gears, found, failed = gears or GearSettings(), list[tuple[float, GearedPlan]](), list[PlanningError]()
    rest = torch.zeros_like(controls[0]) if settings.rest is None else controls.new_tensor(settings.rest)
    for number, schedule in enumerate(schedules(gear, len(controls), gears)):
        share = gears.share / len(gears.moments) if number else 1 - gears.share
        mine = replace(settings, samples=max(round(share * settings.samples), 1))
        begun = torch.where((schedule == gear)[:, None], controls, rest)

        def cost(sampled: Tensor, schedule: Tensor = schedule) -> Tensor:
            return cost_of(sampled, schedule)

        try:
            plan = improve(begun, cost, mine, generator, previous=previous)
        except PlanningError as error:
            failed.append(error)
            continue
        total = float(cost_of(plan.controls[None], schedule)[0])
        if not math.isnan(total):
            found.append((total, GearedPlan(plan, schedule)))
    if not found:
        raise failed[0] if failed else PlanningError("no plan has a finite cost", how="stop")
    return min(found, key=lambda one: one[0])[1]


def with_pedal_and_gear(cost_of: CostOf) -> CostWithGear:
    """Costs of pedal and steer with a schedule of gears, from costs of throttle, brake, steer and gear."""

    def cost(pedal_and_steer: Float[Tensor, "K T 2"], gear: Float[Tensor, " T"]) -> Float[Tensor, " K"]:
        given = controls_of(pedal_and_steer)
        column = gear.to(given.dtype)[None, :, None].expand(len(given), -1, 1)
        return cost_of(torch.cat((given, column), dim=-1))

    return cost
