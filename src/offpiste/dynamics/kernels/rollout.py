"""The rollout of one block after another and its adjoint: how generated loops and networks follow each other.

Forward keeps the model state of every step (the tape); backward takes each from there, computes the step again
and goes back through it. Blocks are independent: Python spreads them over threads.
"""

from typing import NamedTuple

import numpy as np

from offpiste.core.conventions import STATE
from offpiste.dynamics.kernels.elementary import Lane, copy, f4
from offpiste.dynamics.kernels.generated import advance, advance_adjoint, sense, sense_adjoint
from offpiste.dynamics.kernels.lanes import ACTUATED, COMMANDED, GIVEN
from offpiste.dynamics.kernels.layout import ABSENT, CONTROLS, LANES, LEARNED, NORMAL, ROW, ROWS, STEPPED, UNKNOWN
from offpiste.dynamics.kernels.network import Buffers, Network, compensate, compensate_adjoint, make_buffers
from offpiste.native.compilation import KERNELS

MOVED = len(STEPPED) * LANES
STATES = len(STATE)
NEXT = ROW["next_px"] * LANES
CONTROL_ROW = ROW[CONTROLS[0]]
NORMAL_ROW = ROW[NORMAL[0]]
UNKNOWN_ROW = ROW[UNKNOWN[0]]
CODES = len(ROWS)
CONSTANTS = len(LEARNED)

Networks = tuple[Network, Network, Network]
"""Networks of the forces, the brake and the steering."""

BufferSets = tuple[Buffers, Buffers, Buffers]


class Record(NamedTuple):
    """What a rollout is given.

    Attributes:
        rows: controls, mean normals, share of unknown ones and terms of the first network, in lanes
            [blocks, T, (GIVEN + N) * LANES]: windows lie far apart in memory, and each step reads all of a block.
        recorded: are the actuators, then the controls there? Slots of absent ones are not computed with.
    """

    rows: np.ndarray
    recorded: np.ndarray


@KERNELS.maker
def make_buffer_sets(networks: Networks, one: Lane) -> BufferSets:
    """`make_buffers` of each network."""
    return make_buffers(networks[0], one), make_buffers(networks[1], one), make_buffers(networks[2], one)


@KERNELS.maker
def make_workspace(codes: int, recorded: np.ndarray) -> np.ndarray:
    """An empty workspace, with what stands for absent controls, which nothing overwrites.

    Args:
        codes: numbers that the wheels' codes have together.
        recorded: are the actuators, then the controls there?
    """
    w = np.zeros((CODES + codes) * LANES, f4)
    for k in range(COMMANDED):
        if not recorded[ACTUATED + k]:
            w[(CONTROL_ROW + k) * LANES : (CONTROL_ROW + k + 1) * LANES] = f4(ABSENT[k])
    return w


@KERNELS.loop
def load_controls(w: np.ndarray, controls: np.ndarray, recorded: np.ndarray, block: int, t: int) -> None:
    """Controls of step t into the workspace; lanes behind the batch repeat its last window."""
    for i in range(LANES):
        window = min(block * LANES + i, len(controls) - 1)
        for k in range(COMMANDED):
            if recorded[ACTUATED + k]:
                w[(CONTROL_ROW + k) * LANES + i] = controls[window, t, k]


@KERNELS.loop
def load(w: np.ndarray, terms: np.ndarray, record: Record, block: int, t: int) -> None:
    """Controls, mean normals and unknown ones of step t into the workspace, and what is added to the first network."""
    row = record.rows[block, t]
    copy(row, w[CONTROL_ROW * LANES : (NORMAL_ROW + 3) * LANES])
    copy(row[(GIVEN - 1) * LANES :], w[UNKNOWN_ROW * LANES : (UNKNOWN_ROW + 1) * LANES])
    copy(row[GIVEN * LANES :], terms)


@KERNELS.loop
def advance_block(
    w: np.ndarray, c: np.ndarray, networks: Networks, buffer_sets: BufferSets, before: np.ndarray, after: np.ndarray
) -> None:
    """One step of a block, from one model state to the next; what is given is loaded."""
    units = (len(before) - MOVED) // (2 * LANES)
    copy(before, w[:MOVED])
    sense(w, c)
    compensate(networks[0], buffer_sets[0], w, before[MOVED:], after[MOVED:], units)
    compensate(networks[1], buffer_sets[1], w, before[MOVED:], after[MOVED:], units)
    compensate(networks[2], buffer_sets[2], w, before[MOVED:], after[MOVED:], units)
    advance(w, c)
    copy(w[NEXT : NEXT + MOVED], after[:MOVED])


@KERNELS.loop
def begin(start: np.ndarray, recorded: np.ndarray, before: np.ndarray, block: int) -> None:
    """Model states of a block into lanes; slots of absent actuators are 0."""
    for i in range(LANES):
        window = min(block * LANES + i, len(start) - 1)
        for k in range(start.shape[1]):
            absent = STATES <= k < len(STEPPED) and not recorded[k - STATES]
            before[k * LANES + i] = f4(0) if absent else start[window, k]


@KERNELS.loop
def keep(
    after: np.ndarray,
    start: np.ndarray,
    recorded: np.ndarray,
    block: int,
    t: int,
    states: np.ndarray,
    actuators: np.ndarray,
) -> None:
    """States and actuators after step t out of their lanes; absent actuators stay as they started."""
    inside = min(LANES, len(start) - block * LANES)
    for k in range(STATES):
        for i in range(inside):
            states[block * LANES + i, t, k] = after[k * LANES + i]
    for k in range(ACTUATED):
        for i in range(inside):
            window, moved = block * LANES + i, recorded[k]
            actuators[window, t, k] = after[(STATES + k) * LANES + i] if moved else start[window, STATES + k]


@KERNELS.entry
def forward(
    first: int,
    last: int,
    start: np.ndarray,
    record: Record,
    c: np.ndarray,
    networks: Networks,
    tape: np.ndarray,
    states: np.ndarray,
    actuators: np.ndarray,
) -> None:
    """Roll blocks `first` ... `last - 1` out.

    Args:
        start: packed model states [B, P].
        record: see `Record`.
        c: the constants (`layout.CONSTANTS`).
        networks: of the forces, the brake and the steering.
        tape: model states before each step and after the last [blocks, T + 1, P * LANES]; or [blocks, 2, ...] without
            adjoint.
        states, actuators: to fill [B, T, 6], [B, T, A].
    """
    steps, slots = record.rows.shape[1], tape.shape[1]
    w = np.zeros(CODES * LANES, f4)
    buffer_sets = make_buffer_sets(networks, f4(1))
    for block in range(first, last):
        begin(start, record.recorded, tape[block, 0], block)
        for t in range(steps):
            after = tape[block, (t + 1) % slots]
            load(w, buffer_sets[0].terms, record, block, t)
            advance_block(w, c, networks, buffer_sets, tape[block, t % slots], after)
            keep(after, start, record.recorded, block, t, states, actuators)


@KERNELS.entry
def backward(
    first: int,
    last: int,
    record: Record,
    c: np.ndarray,
    networks: Networks,
    tape: np.ndarray,
    states_bar: np.ndarray,
    actuators_bar: np.ndarray,
    start_bar: np.ndarray,
    terms_bar: np.ndarray,
    c_bar: np.ndarray,
    gates_bar: np.ndarray,
    inner_bar: np.ndarray,
    outer_bar: np.ndarray,
) -> None:
    """Back through `forward`.

    Args:
        first, last, record, c, networks, tape: as in `forward`.
        states_bar, actuators_bar: adjoints of the results.
        start_bar: to fill, like `start`.
        terms_bar: adjoints of the terms, to fill [blocks, T, N * LANES].
        c_bar: adjoint of the learned constants, by block, to fill.
        gates_bar, inner_bar, outer_bar: adjoints of the first network's weights by block, zero, to add to; without rows
            where a matrix is frozen.
    """
    batch, steps, _ = states_bar.shape
    w = np.zeros(CODES * LANES, f4)
    w_bar = np.zeros_like(w)
    after = np.zeros(tape.shape[2], f4)
    units = (len(after) - MOVED) // (2 * LANES)
    constants_bar = np.zeros(CONSTANTS * LANES, f4)
    buffer_sets = make_buffer_sets(networks, f4(1))
    bars = make_buffer_sets(networks, f4(0))
    frozen = np.zeros((0, 0), f4)
    for block in range(first, last):
        inside = min(LANES, batch - block * LANES)
        constants_bar[:] = f4(0)
        model_state_bar = np.zeros_like(after)
        for step in range(steps):
            t = steps - 1 - step
            before = tape[block, t]
            load(w, buffer_sets[0].terms, record, block, t)
            advance_block(w, c, networks, buffer_sets, before, after)

            w_bar[:] = f4(0)
            w_bar[NEXT : NEXT + MOVED] = model_state_bar[:MOVED]
            for k in range(STATES):
                for i in range(inside):
                    w_bar[NEXT + k * LANES + i] += states_bar[block * LANES + i, t, k]
            for k in range(ACTUATED):
                for i in range(inside):
                    w_bar[NEXT + (STATES + k) * LANES + i] += actuators_bar[block * LANES + i, t, k]
            advance_adjoint(w, c, w_bar, constants_bar)
            compensate_adjoint(
                networks[0], buffer_sets[0], bars[0], w, w_bar, model_state_bar[MOVED:], units,
                gates_bar[block], inner_bar[block], outer_bar[block],
            )  # fmt: skip
            for k in range(1, len(networks)):
                compensate_adjoint(
                    networks[k], buffer_sets[k], bars[k], w, w_bar, model_state_bar[MOVED:], units,
                    frozen, frozen, frozen,
                )  # fmt: skip
            sense_adjoint(w, c, w_bar, constants_bar)
            model_state_bar[:MOVED] = w_bar[:MOVED]
            copy(bars[0].terms, terms_bar[block, t])
        for i in range(inside):
            for k in range(start_bar.shape[1]):
                start_bar[block * LANES + i, k] = model_state_bar[k * LANES + i]
        for k in range(CONSTANTS):
            c_bar[block, k] = constants_bar[k * LANES : (k + 1) * LANES].sum()
