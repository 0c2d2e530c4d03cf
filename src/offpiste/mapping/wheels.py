"""The ground under many wheels at once: `lookup.look_up` as a loop, for planners that read one map a million times."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.mapping.compiled import map_loop
from offpiste.mapping.lookup import Found, MapStack
from offpiste.threads import spread


def look_up_wheels(
    maps: MapStack,
    number: int,
    place: Float[Tensor, "P 2"],
    offset: Float[Tensor, " 2"],
    *,
    threads: int = 1,
    out: Found | None = None,
) -> Found:
    """The same as `look_up` for places on one map, on the CPU, in float32.

    Args:
        number: of the map that is read.
        place: x, y [m] (float32).
        offset: of the frame of `place` in the world frame (float64) [m].
        out: what an earlier call for as many places returned, written over.

    Raises:
        ValueError: places or a map that are not float32 on the CPU.
    """
    tensors = (place, maps.slope, maps.features)
    if any(tensor.dtype != torch.float32 or tensor.device.type != "cpu" for tensor in tensors):
        raise ValueError("wheels are looked up in float32 on the CPU; use look_up")
    count, channels = len(place), maps.features.shape[-1]
    out = out or Found(
        torch.empty(count, 3),
        torch.empty(count, dtype=torch.bool),
        torch.empty(count, channels),
        torch.empty(count, dtype=torch.bool),
    )
    shift = (offset - maps.origin[number]).numpy().astype(np.float32)
    arrays: list[Any] = [
        tensor.numpy()
        for tensor in (
            place.contiguous(),
            maps.slope[number],
            maps.features[number],
            out.normal,
            out.known,
            out.features,
            out.valid,
        )
    ]
    spread(threads, count, lookup_kernel, shift, np.float32(1 / maps.resolution), *arrays)
    return out


@map_loop
def lookup_kernel(first, last, shift, scale, place, slope, features, normal, known, found, valid):  # type: ignore[no-untyped-def]
    """The ground at places `first` to `last`."""
    ny, nx = slope.shape[0], slope.shape[1]
    last_x, last_y = np.float32(nx - 1), np.float32(ny - 1)
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    for p in range(first, last):
        x, y = (place[p, 0] + shift[0]) * scale, (place[p, 1] + shift[1]) * scale
        # A place belongs to the map while it is nearest to one of its cells; what is not a number does not.
        inside = x > -half and x < last_x + half and y > -half and y < last_y + half
        x, y = (x, y) if inside else (zero, zero)
        x = min(max(x, zero), last_x)
        y = min(max(y, zero), last_y)

        i, j = np.int64(np.rint(x)), np.int64(np.rint(y))
        there = inside
        for k in range(features.shape[2]):
            value = features[j, i, k]
            found[p, k] = value
            there &= value - value == 0
        valid[p] = there

        x0, y0 = min(np.int64(x), max(nx - 2, 0)), min(np.int64(y), max(ny - 2, 0))
        x1, y1 = min(x0 + 1, nx - 1), min(y0 + 1, ny - 1)
        u, v = x - np.float32(x0), y - np.float32(y0)
        rise_x = (slope[y0, x0, 0] * (one - u) + slope[y0, x1, 0] * u) * (one - v)
        rise_x += (slope[y1, x0, 0] * (one - u) + slope[y1, x1, 0] * u) * v
        rise_y = (slope[y0, x0, 1] * (one - u) + slope[y0, x1, 1] * u) * (one - v)
        rise_y += (slope[y1, x0, 1] * (one - u) + slope[y1, x1, 1] * u) * v
        sloped = inside and rise_x - rise_x == 0 and rise_y - rise_y == 0
        rise_x, rise_y = (rise_x, rise_y) if sloped else (zero, zero)
        up = one / np.sqrt(one + rise_x * rise_x + rise_y * rise_y)
        known[p] = sloped
        normal[p, 0], normal[p, 1], normal[p, 2] = -rise_x * up, -rise_y * up, up
