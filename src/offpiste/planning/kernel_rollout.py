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
    ACTUATED,
    CODES,
    CONTROL_ROW,
    MOVED,
    NORMAL_ROW,
    STATES,
    Networks,
    advance_block,
    make_buffer_sets,
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
    CostLayers,
    Ground,
    make_sight,
    sample_terrain,
)

path_term = PLANNING.inlined(costs.path_term)
speed_term = PLANNING.inlined(costs.speed_term)
overspeed_term = PLANNING.inlined(costs.overspeed_term)
lateral_ratio = PLANNING.inlined(costs.lateral_ratio)
rollover_term = PLANNING.inlined(costs.rollover_term)
effort_term = PLANNING.inlined(costs.effort_term)
jerk_term = PLANNING.inlined(costs.jerk_term)


class KernelWeights(NamedTuple):
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
    w: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    seen: np.ndarray,
    kernel_weights: KernelWeights,
    total: np.ndarray,
) -> None:
    """Add what the states after a step cost; `sample_terrain` has seen what lies there."""
    for i in range(LANES):
        c, s = seen[COS * LANES + i], seen[SIN * LANES + i]
        vx, vy, yaw_rate = after[3 * LANES + i], after[4 * LANES + i], after[5 * LANES + i]
        direction = seen[ALONG_X * LANES + i], seen[ALONG_Y * LANES + i]
        acceleration = (vy - before[4 * LANES + i]) / kernel_weights.dt + vx * yaw_rate
        normal_y = c * w[(NORMAL_ROW + 1) * LANES + i] - s * w[NORMAL_ROW * LANES + i]
        normal_z = w[(NORMAL_ROW + 2) * LANES + i]
        ratio = lateral_ratio(
            acceleration, normal_y, normal_z, kernel_weights.gravity, kernel_weights.least_vertical, maximum
        )
        cost = path_term(seen[DISTANCE * LANES + i], kernel_weights.path)
        cost += speed_term((c, s), vx, vy, direction, seen[TARGET * LANES + i], kernel_weights.speed)
        cost += overspeed_term(vx, seen[LIMIT * LANES + i], kernel_weights.overspeed, maximum)
        cost += seen[HAZARD * LANES + i]
        cost += rollover_term(ratio, kernel_weights.lateral_limit, kernel_weights.rollover, maximum)
        total[i] += kernel_weights.dt * cost


@PLANNING.loop
def command(
    w: np.ndarray, controls: np.ndarray, recorded: np.ndarray, block: int, t: int, before: np.ndarray,
    after: np.ndarray, kernel_weights: KernelWeights, total: np.ndarray,
) -> None:  # fmt: skip
    """Controls of step t into `after` and the workspace, and what they cost; `before` has those of the step before.

    Lanes behind the samples repeat the last one.
    """
    for i in range(LANES):
        sample = np.uint64(min(block * LANES + i, len(controls) - 1))
        for k in range(3):
            after[k * LANES + i] = controls[sample, np.uint64(t), k]
    for k in range(3):
        effort, jerk = kernel_weights.effort[k], kernel_weights.jerk[k]
        for i in range(k * LANES, (k + 1) * LANES):
            cost = effort_term(after[i], effort) + jerk_term(after[i], before[i], kernel_weights.dt, jerk)
            total[i - k * LANES] += kernel_weights.dt * cost
        if recorded[ACTUATED + k]:
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
    cost_layers: CostLayers,
    kernel_weights: KernelWeights,
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
    buffer_sets = make_buffer_sets(networks, f4(1))
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
        sample_terrain(w, carries[0], sight, ground, cost_layers, True)
        for t in range(steps):
            now, then = t % 2, (t + 1) % 2
            before, after = carries[now], carries[then]
            command(w, controls, recorded, block, t, commands[now], commands[then], kernel_weights, total)
            advance_block(w, c, networks, buffer_sets, before, after)
            sample_terrain(w, after, sight, ground, cost_layers, not holds)
            price(w, before, after, sight.seen, kernel_weights, total)
            if len(states) > 0:
                for i in range(min(LANES, samples - block * LANES)):
                    for k in range(states.shape[2]):
                        states[block * LANES + i, t, k] = after[k * LANES + i]
        for i in range(min(LANES, samples - block * LANES)):
            costs[block * LANES + i] = total[i]
