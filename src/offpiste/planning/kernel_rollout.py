"""Rollouts on a map with their costs, in one kernel: the generated step, map lookups and the terms of the cost.

Blocks of lanes are rolled out one after another, as in `dynamics.kernels.rollout`. What the wheels stand on after a
step is looked up once (`fused_survey`): the step's cost reads it, and so does the next step.
"""

from typing import NamedTuple

import numpy as np

from offpiste.compilation import PLANNING
from offpiste.dynamics.kernels.elementary import Lane, f4, maximum
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.rollout import (
    CODES,
    CONTROL_ROW,
    MOVED,
    NORMAL_ROW,
    STATES,
    Networks,
    advance_block,
    make_scratches,
)
from offpiste.planning import costs
from offpiste.planning.kernel_terrain import (
    ALONG_X,
    ALONG_Y,
    COS,
    DISTANCE,
    HAZARD,
    LIMIT,
    SIN,
    TARGET,
    Ground,
    Raster,
    make_sight,
    survey,
)

path_term = PLANNING.inlined(costs.path_term)
speed_term = PLANNING.inlined(costs.speed_term)
overspeed_term = PLANNING.inlined(costs.overspeed_term)
lateral_ratio = PLANNING.inlined(costs.lateral_ratio)
rollover_term = PLANNING.inlined(costs.rollover_term)
effort_term = PLANNING.inlined(costs.effort_term)
jerk_term = PLANNING.inlined(costs.jerk_term)


class Prices(NamedTuple):
    """`costs.Weights` in float32, with what else the terms need."""

    path: Lane
    speed: Lane
    overspeed: Lane
    rollover: Lane
    lateral_limit: Lane
    least_vertical: Lane
    gravity: Lane
    dt: Lane
    effort: np.ndarray
    jerk: np.ndarray


@PLANNING.loop
def price(
    w: np.ndarray, before: np.ndarray, after: np.ndarray, seen: np.ndarray, prices: Prices, total: np.ndarray
) -> None:
    """Add what the states after a step cost; `survey` has seen what lies there."""
    for i in range(LANES):
        c, s = seen[COS * LANES + i], seen[SIN * LANES + i]
        vx, vy, yaw_rate = after[3 * LANES + i], after[4 * LANES + i], after[5 * LANES + i]
        direction = seen[ALONG_X * LANES + i], seen[ALONG_Y * LANES + i]
        acceleration = (vy - before[4 * LANES + i]) / prices.dt + vx * yaw_rate
        normal_y = c * w[(NORMAL_ROW + 1) * LANES + i] - s * w[NORMAL_ROW * LANES + i]
        normal_z = w[(NORMAL_ROW + 2) * LANES + i]
        ratio = lateral_ratio(acceleration, normal_y, normal_z, prices.gravity, prices.least_vertical, maximum)
        cost = path_term(seen[DISTANCE * LANES + i], prices.path)
        cost += speed_term((c, s), vx, vy, direction, seen[TARGET * LANES + i], prices.speed)
        cost += overspeed_term(vx, seen[LIMIT * LANES + i], prices.overspeed, maximum)
        cost += seen[HAZARD * LANES + i]
        cost += rollover_term(ratio, prices.lateral_limit, prices.rollover, maximum)
        total[i] += prices.dt * cost


@PLANNING.loop
def command(
    w: np.ndarray, controls: np.ndarray, recorded: np.ndarray, block: int, t: int, before: np.ndarray,
    after: np.ndarray, prices: Prices, total: np.ndarray,
) -> None:  # fmt: skip
    """Controls of step t into `after` and the workspace, and what they cost; `before` has those of the step before.

    Lanes behind the samples repeat the last one.
    """
    for i in range(LANES):
        sample = np.uint64(min(block * LANES + i, len(controls) - 1))
        for k in range(3):
            after[k * LANES + i] = controls[sample, np.uint64(t), k]
    for k in range(3):
        effort, jerk = prices.effort[k], prices.jerk[k]
        for i in range(k * LANES, (k + 1) * LANES):
            cost = effort_term(after[i], effort) + jerk_term(after[i], before[i], prices.dt, jerk)
            total[i - k * LANES] += prices.dt * cost
        if recorded[4 + k]:
            for i in range(k * LANES, (k + 1) * LANES):
                w[CONTROL_ROW * LANES + i] = after[i]


@PLANNING.entry
def roll_out(
    first: int,
    last: int,
    start: np.ndarray,
    controls: np.ndarray,
    control: np.ndarray,
    recorded: np.ndarray,
    c: np.ndarray,
    networks: Networks,
    ground: Ground,
    raster: Raster,
    prices: Prices,
    holds: bool,
    costs: np.ndarray,
    states: np.ndarray,
) -> None:
    """Roll blocks `first` ... `last - 1` out.

    Args:
        start: packed carry [P].
        controls: [K, T, 3].
        control: in the step before the first [3].
        recorded: are actuators (4) and controls (3) there?
        c: the constants (`layout.CONSTANTS`).
        networks: of the forces, the brake and the steering.
        ground, raster, prices: see there.
        holds: the codes of the start stay.
        costs: to fill [K].
        states: to fill with the first numbers of the carry after each step [K, T, 6 ... P], or empty.
    """
    samples, steps, _ = controls.shape
    w = np.zeros((CODES + 4 * len(ground.missing)) * LANES, f4)
    scratches = make_scratches(networks, f4(1))
    carries = np.zeros((2, len(start) * LANES), f4)
    commands = np.zeros((2, 3 * LANES), f4)
    sight, total = make_sight(), np.zeros(LANES, f4)
    for block in range(first, last):
        total[:] = f4(0)
        for k in range(3):
            commands[0, k * LANES : (k + 1) * LANES] = control[k]
        for k in range(len(start)):
            absent = STATES <= k < MOVED // LANES and not recorded[k - STATES]
            carries[0, k * LANES : (k + 1) * LANES] = f4(0) if absent else start[k]
        survey(w, carries[0], sight, ground, raster, True)
        for t in range(steps):
            now, then = t % 2, (t + 1) % 2
            before, after = carries[now], carries[then]
            command(w, controls, recorded, block, t, commands[now], commands[then], prices, total)
            advance_block(w, c, networks, scratches, before, after)
            survey(w, after, sight, ground, raster, not holds)
            price(w, before, after, sight.seen, prices, total)
            if len(states) > 0:
                for i in range(min(LANES, samples - block * LANES)):
                    for k in range(states.shape[2]):
                        states[block * LANES + i, t, k] = after[k * LANES + i]
        for i in range(min(LANES, samples - block * LANES)):
            costs[block * LANES + i] = total[i]
