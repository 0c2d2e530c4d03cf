"""How far errors of position reach, grown along a block's rollout: `caution.position_margins`, lane by lane.

The spread's network runs every `spread.EVERY` steps; in between the reach grows by the velocity's.
"""

from typing import Final, NamedTuple

import numpy as np
import torch
from torch import nn

from offpiste.core.conventions import DT
from offpiste.dynamics.kernels.elementary import Lane, add_product, f4, tanh
from offpiste.dynamics.kernels.lanes import COMMANDED
from offpiste.dynamics.kernels.layout import COMMANDS, LANES
from offpiste.dynamics.kernels.rollout import CODES, CONTROL_ROW, NORMAL_ROW, UNKNOWN_ROW
from offpiste.dynamics.vehicle import Vehicle
from offpiste.native.compilation import PLANNING
from offpiste.planning.caution import Caution
from offpiste.planning.kernel_terrain import ACROSS, ALONG, COS, SIN
from offpiste.uncertainty.spread import EVERY, INTERVAL, MOTION

MOVING: Final = len(MOTION)
GIVEN: Final = MOVING + COMMANDED
"""Rows of the inputs before the mean code."""


class StrayWeights(NamedTuple):
    """A spread as the kernel takes it, its standardisation folded into the first layer; no rows for none.

    Attributes:
        inner: [H, N], N a multiple of four.
        bias: [H].
        outer: [4, H], of which the first two count.
        outer_bias: [2].
        start: variance of the velocity at the start [2].
        reach: scales that count, times the spread's factor.
    """

    inner: np.ndarray
    bias: np.ndarray
    outer: np.ndarray
    outer_bias: np.ndarray
    start: np.ndarray
    reach: Lane


class Stray(NamedTuple):
    """Buffers of a block: inputs, hidden units, outputs; variance and reach of the velocity along and across."""

    inputs: np.ndarray
    hidden: np.ndarray
    out: np.ndarray
    variance: np.ndarray
    velocity: np.ndarray


@torch.no_grad()
def stray_weights(caution: Caution | None, vehicle: Vehicle, codes: int) -> StrayWeights:
    """Weights of a spread; without caution those of nothing.

    Args:
        codes: length of the model's code.
    """
    count = -(-(GIVEN + codes) // 4) * 4
    if caution is None:
        nothing = np.zeros(0, f4)
        return StrayWeights(np.zeros((0, count), f4), nothing, np.zeros((0, 0), f4), nothing, nothing, f4(0))
    spread = caution.spread
    first, last = (layer for layer in spread.layers.children() if isinstance(layer, nn.Linear))
    scaled = first.weight / spread.deviation
    rows = [*range(MOVING), *(MOVING + COMMANDS.index(name) for name in vehicle.control)]
    inner = torch.zeros(len(scaled), count)
    inner[:, [*rows, *range(GIVEN, GIVEN + codes)]] = scaled
    outer = nn.functional.pad(last.weight, (0, 0, 0, 2))
    start = nn.functional.softplus(spread.start).square()
    parts = inner, first.bias - scaled @ spread.mean, outer, last.bias, start
    matrix, bias, out, out_bias, variance = (part.float().contiguous().numpy() for part in parts)
    return StrayWeights(matrix, bias, out, out_bias, variance, f4(caution.reach * float(spread.factor)))


@PLANNING.maker
def make_stray(weights: StrayWeights) -> Stray:
    """Buffers for a spread."""
    hidden, count = weights.inner.shape
    two = 2 * LANES
    return Stray(
        np.zeros(count * LANES, f4), np.zeros(hidden * LANES, f4), np.zeros(4 * LANES, f4), np.zeros(two, f4),
        np.zeros(two, f4),
    )  # fmt: skip


@PLANNING.loop
def begin_stray(weights: StrayWeights, stray: Stray, values: np.ndarray) -> None:
    """At the start the place is certain."""
    for i in range(LANES):
        values[ALONG * LANES + i] = values[ACROSS * LANES + i] = f4(0)
    for k in range(len(weights.start)):
        for i in range(k * LANES, (k + 1) * LANES):
            stray.variance[i] = weights.start[k]


@PLANNING.inlined
def _read_motion(stray: Stray, w: np.ndarray, before: np.ndarray, values: np.ndarray) -> None:
    """`spread.MOTION` of the states before a step."""
    x, zero, one, four = stray.inputs, f4(0), f4(1), f4(4)
    for i in range(LANES):
        vx, vy, yaw_rate = before[3 * LANES + i], before[4 * LANES + i], before[5 * LANES + i]
        c, s, unknown = values[COS * LANES + i], values[SIN * LANES + i], w[UNKNOWN_ROW * LANES + i]
        # The workspace has means over all wheels, and straight up where the ground is unknown.
        known = four * (one - unknown)
        to_known = four / (known if known > one else one)
        nx, ny = to_known * w[NORMAL_ROW * LANES + i], to_known * w[(NORMAL_ROW + 1) * LANES + i]
        across, lateral = s * nx - c * ny, vx * yaw_rate
        x[i] = np.sqrt(vx * vx + vy * vy)
        x[LANES + i] = yaw_rate if yaw_rate > zero else -yaw_rate
        x[2 * LANES + i] = lateral if lateral > zero else -lateral
        x[3 * LANES + i] = -(c * nx + s * ny)
        x[4 * LANES + i] = across if across > zero else -across
        x[5 * LANES + i] = unknown


@PLANNING.loop
def sense_stray(
    weights: StrayWeights, stray: Stray, w: np.ndarray, before: np.ndarray, values: np.ndarray, codes: int
) -> None:
    """Variance and reach of the velocity for the next `EVERY` steps; controls and terrain are in the workspace.

    Args:
        codes: length of the model's code.
    """
    _read_motion(stray, w, before, values)
    for i in range(COMMANDED * LANES):
        stray.inputs[MOVING * LANES + i] = w[CONTROL_ROW * LANES + i]
    quarter = f4(0.25)
    for e in range(codes):
        for i in range(LANES):
            at, step = (CODES + e) * LANES + i, codes * LANES
            mean = quarter * (w[at] + w[at + step] + w[at + 2 * step] + w[at + 3 * step])
            stray.inputs[(GIVEN + e) * LANES + i] = mean
    for h in range(len(weights.bias)):
        for i in range(h * LANES, (h + 1) * LANES):
            stray.hidden[i] = weights.bias[h]
    add_product(weights.inner, stray.inputs, stray.hidden)
    for i in range(len(stray.hidden)):
        stray.hidden[i] = tanh(stray.hidden[i])
    for i in range(4 * LANES):
        stray.out[i] = f4(0)
    add_product(weights.outer, stray.hidden, stray.out)
    for k in range(2):
        for i in range(k * LANES, (k + 1) * LANES):
            out = stray.out[i] + weights.outer_bias[k]
            size = out if out < f4(0) else -out
            rate = (out if out > f4(0) else f4(0)) + np.log1p(np.exp(size))  # softplus
            stray.variance[i] += rate * rate * f4(INTERVAL)
            stray.velocity[i] = weights.reach * np.sqrt(stray.variance[i])


@PLANNING.loop
def move_stray(stray: Stray, values: np.ndarray) -> None:
    """The reach after one more step."""
    for i in range(2 * LANES):
        values[ALONG * LANES + i] += stray.velocity[i] * f4(DT)


__all__ = ["EVERY", "StrayWeights", "begin_stray", "make_stray", "move_stray", "sense_stray", "stray_weights"]
