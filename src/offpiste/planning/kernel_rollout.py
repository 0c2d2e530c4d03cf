"""Rollouts on a map with their costs, in one kernel: the generated step, the terrain and the cost terms.

Blocks of lanes are rolled out one after another, as in `dynamics.kernels.rollout`. Terrain under the wheels after a
step is read once (`kernel_terrain`): the step's cost reads it, and so does the next step.
"""

import numpy as np

from offpiste.core.conventions import CONTROL
from offpiste.dynamics.kernels.elementary import copy, f4
from offpiste.dynamics.kernels.lanes import ACTUATED
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.rollout import (
    CONTROL_ROW,
    MOVED,
    STATES,
    Networks,
    advance_block,
    make_buffer_sets,
    make_workspace,
)
from offpiste.dynamics.kernels.vectors import read_fours
from offpiste.native.compilation import PLANNING
from offpiste.planning.kernel_stray import EVERY, StrayWeights, begin_stray, make_stray, move_stray, sense_stray
from offpiste.planning.kernel_terrain import CostCells, GroundCells, make_samples, sample_terrain


def control_cost(numbers: np.ndarray, command_before: np.ndarray, command: np.ndarray, total: np.ndarray) -> None:
    """Add the cost of the controls of a step; `kernel_costs` puts the compiled terms in its place."""
    raise NotImplementedError


def motion_cost(
    numbers: np.ndarray, w: np.ndarray, before: np.ndarray, after: np.ndarray, command: np.ndarray, values: np.ndarray,
    total: np.ndarray,
) -> None:  # fmt: skip
    """Add the cost of the states after a step; `kernel_costs` puts the compiled terms in its place."""
    raise NotImplementedError


@PLANNING.inlined
def find_controls(controls: np.ndarray, block: int, index: np.ndarray) -> None:
    """Find where the controls of a block's samples begin; lanes behind the samples repeat the last one."""
    samples, steps, columns = controls.shape
    for i in range(LANES):
        index[i] = np.int32(min(block * LANES + i, samples - 1) * steps * columns)


@PLANNING.inlined
def load_controls(
    w: np.ndarray,
    controls: np.ndarray,
    recorded: np.ndarray,
    t: int,
    index: np.ndarray,
    read: np.ndarray,
    command: np.ndarray,
) -> None:
    """Controls of step t, into `command` and the workspace.

    Args:
        index: from `find_controls`.
        read: for what is read [4 * LANES].
    """
    _, steps, columns = controls.shape
    numbers = controls.reshape(-1)
    first = max(min(t * columns, steps * columns - 4), 0)  # four numbers lie within a sample
    if steps * columns >= 4:
        read_fours(numbers, index, first, numbers, read)
    else:
        for k in range(columns):
            for i in range(LANES):
                read[k * LANES + i] = numbers[index[i] + k]
    row = t * columns - first
    copy(read[row * LANES :], command)
    for k in range(columns):  # optional ones behind the command cost nothing
        if recorded[ACTUATED + k]:
            copy(read[(row + k) * LANES :], w[(CONTROL_ROW + k) * LANES : (CONTROL_ROW + k + 1) * LANES])


def roll_out(
    first: int,
    last: int,
    start: np.ndarray,
    controls: np.ndarray,
    control: np.ndarray,
    recorded: np.ndarray,
    c: np.ndarray,
    networks: Networks,
    ground: GroundCells,
    cost_cells: CostCells,
    unsure: StrayWeights,
    numbers: np.ndarray,
    costs: np.ndarray,
    states: np.ndarray,
) -> None:
    """Roll blocks `first` ... `last - 1` out.

    Args:
        start: packed model state [P].
        controls: throttle, brake, steer, then optional ones [K, T, U].
        control: in the step before the first [3].
        recorded: are the actuators, then the controls (`layout.COMMANDS`) there?
        c: the constants (`layout.CONSTANTS`).
        networks: of the forces, the brake and the steering.
        ground, cost_cells: the maps.
        unsure: the spread of the predictions.
        numbers: weights and parameters of the terms (`KernelCosts.numbers`).
        costs: to fill [K].
        states: to fill with the first numbers of the model state after each step [K, T, 6 ... P], or empty.
    """
    samples, steps, _ = controls.shape
    w = make_workspace(4 * len(ground.missing), recorded)
    buffer_sets = make_buffer_sets(networks, f4(1))
    model_states = np.zeros((2, len(start) * LANES), f4)
    commands = np.zeros((2, len(CONTROL) * LANES), f4)
    terrain, total = make_samples(len(cost_cells.outside)), np.zeros(LANES, f4)
    stray, cautious = make_stray(unsure), len(unsure.bias) > 0
    index, read = np.zeros(LANES, np.int32), np.zeros(4 * LANES, f4)
    for block in range(first, last):
        total[:] = f4(0)
        find_controls(controls, block, index)
        for k in range(len(CONTROL)):
            commands[0, k * LANES : (k + 1) * LANES] = control[k]
        for k in range(len(start)):
            absent = STATES <= k < MOVED // LANES and not recorded[k - STATES]
            model_states[0, k * LANES : (k + 1) * LANES] = f4(0) if absent else start[k]
        sample_terrain(w, model_states[0], terrain, ground, cost_cells)
        begin_stray(unsure, stray, terrain.values)
        for t in range(steps):
            now, then = t % 2, (t + 1) % 2
            before, after = model_states[now], model_states[then]
            load_controls(w, controls, recorded, t, index, read, commands[then])
            if cautious and t % EVERY == 0:
                sense_stray(unsure, stray, w, before, terrain.values, len(ground.missing))
            advance_block(w, c, networks, buffer_sets, before, after)
            sample_terrain(w, after, terrain, ground, cost_cells)
            move_stray(stray, terrain.values)
            control_cost(numbers, commands[now], commands[then], total)
            motion_cost(numbers, w, before, after, commands[then], terrain.values, total)
            if len(states) > 0:
                for i in range(min(LANES, samples - block * LANES)):
                    for k in range(states.shape[2]):
                        states[block * LANES + i, t, k] = after[k * LANES + i]
        for i in range(min(LANES, samples - block * LANES)):
            costs[block * LANES + i] = total[i]
