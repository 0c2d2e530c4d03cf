"""Shading of the ground, many places together: all but reading tables runs in vectors of single precision.

The plain reference, one place after the other, is in the tests (`tests/simulation/rendering/test_ground_shading.py`).
"""

from typing import NamedTuple

import numpy as np
from numpy import float32 as f32

from offpiste.compilation import RAYS
from offpiste.simulation.rendering.own_shadow import sunlit
from offpiste.simulation.rendering.texture_noise import octaves, pebbles, value_noise

LOW, HIGH = 0, 3
FINE, COARSE, BUMPS, STONES, BLADES, RIPPLES, GLOSS, TRAIL, SUN, OPEN, CHANNELS = range(6, 17)
"""Channels of `GroundTexture.nodes`; LOW and HIGH are the first of three."""

MOST_RELIEF = 0.5
"""Relief and tone at which their channels are full."""

TRAIL_REACH = 4.0
"""Distance to a trail's centre line at which its channel is full [m]."""

TRACK_OFFSET, TRACK_WIDTH = 0.66, 0.17
"""Offset of tyre tracks from a trail's centre line (half the vehicle's track), and their width [m]."""

STONE_SIZE, BLADE_WIDTH, BLADE_LENGTH, RIPPLE_LENGTH = 0.05, 0.012, 0.09, 0.13
"""Sizes of texture that is not noise [m]."""


class GroundTexture(NamedTuple):
    """The ground's appearance, mixed at the nodes of the world.

    Attributes:
        nodes: [ny, nx, CHANNELS], 0..255: square roots of the colours that large noise moves between (3 each), shares
            of brightness of fine and coarse noise, relief, stones, blades and ripples, gloss of water, distance to the
            trail's centre, direct sun on the ground, sun on plants.
        x0, y0, resolution: of the nodes [m].
        elevation: [ny, nx] [m].
        lattice, turn: tables of the noise (`texture_noise`).
        sun: horizontal direction to the sun in each octave's lattice [O, 2].
        soil: colour between blades [3].
        ragged: how far borders between kinds wander [m].
        plants: colour of trunks, crowns and bushes; share of the ground's colour that blades have [4, 3].
    """

    nodes: np.ndarray
    x0: float
    y0: float
    resolution: float
    elevation: np.ndarray
    lattice: np.ndarray
    turn: np.ndarray
    sun: np.ndarray
    soil: np.ndarray
    ragged: float
    plants: np.ndarray


@RAYS.inlined
def read_nodes(ground, x, y, c):  # type: ignore[no-untyped-def]
    """All channels at (x, y), bilinear, 0..1, into `c`; clamped at the border."""
    ny, nx = ground.nodes.shape[:2]
    px = min(max((x - ground.x0) / ground.resolution, 0.0), nx - 1.001)
    py = min(max((y - ground.y0) / ground.resolution, 0.0), ny - 1.001)
    i, j = np.uint32(px), np.uint32(py)
    u, v = np.float32(px - i), np.float32(py - j)
    right, far = i + np.uint32(1), j + np.uint32(1)
    for k in range(CHANNELS):
        n00, n10 = np.float32(ground.nodes[j, i, k]), np.float32(ground.nodes[j, right, k])
        n01, n11 = np.float32(ground.nodes[far, i, k]), np.float32(ground.nodes[far, right, k])
        low, high = n00 + u * (n10 - n00), n01 + u * (n11 - n01)
        c[k] = (low + v * (high - low)) * np.float32(1 / 255)


HUE, TONE, RELIEF, BARE = range(4)
"""Rows of `work` between the steps."""

FACING, PHASE, FOOTPRINT, FINEST, SHADOW, DISTANCE = range(6)
"""Rows of `seen`, how places are seen: cosine between the surface's normal and the ray; cosine between the ray back and
the sun; size of the pixel on the ground [m]; highest frequency that it shows [1/m]; 0 where the vehicle itself keeps
the sun off, else 1; distance [m]."""

TOGETHER = 128
"""Places on the ground that are shaded together: few enough that their noise stays in the cache."""


def ground_buffers(octave_count: int) -> tuple[np.ndarray, ...]:
    """Buffers of `shade_ground`, which a thread uses alone."""
    n = TOGETHER
    numbers = [np.zeros(shape, np.float32) for shape in ((6, n), (2, octave_count, n), (n, CHANNELS), (8, n), (3, n))]
    return (np.zeros((4, n)), np.zeros((2, n), np.int32), *numbers)


@RAYS.loop
def shade_ground(ground, light, vehicle, pixel, origin, rays, distance, normal, index, buffers, out):  # type: ignore[no-untyped-def]
    """Colour of the ground where some rays end, seen through the air.

    Args:
        vehicle, pixel, origin, rays, distance, normal: as in `shade_rays`.
        index: numbers of these rays, at most `TOGETHER`.
        buffers: `ground_buffers`.
        out: colours of all rays [n, 3]; those of the index are overwritten.
    """
    places, cells, seen, noise, channels, work, colours = buffers
    count, x, y = len(index), places[0, : len(index)], places[1, : len(index)]
    _see_places(light, vehicle, pixel, origin, rays, distance, normal, index, x, y, seen)
    octaves(ground.lattice, ground.turn, ground.sun, x, y, seen[FINEST, :count], cells, work, noise[0], noise[1])
    _read_channels(ground, x, y, noise[0], places, channels)
    _mix_octaves(count, noise[0], noise[1], channels, work)
    for n in range(count):
        work[BARE, n] = _add_details(ground, x[n], y[n], seen, noise[0], channels[n], n, work[TONE], work[RELIEF])
    _add_tracks(count, noise[0], seen, channels, work)
    _light_ground(ground, light, count, seen, channels, work, colours)
    for n in range(count):
        for channel in range(3):
            out[index[n], channel] = colours[channel, n]


# Loops over more arrays than those below are not compiled to vectors: one result after the other.


@RAYS.inlined
def _see_places(light, vehicle, pixel, origin, rays, distance, normal, index, x, y, seen):  # type: ignore[no-untyped-def]
    sun_x, sun_y, sun_z, size = f32(light.sun[0]), f32(light.sun[1]), f32(light.sun[2]), f32(pixel)
    for n in range(len(index)):
        r = index[n]
        dx, dy, dz, t = rays[r, 0], rays[r, 1], rays[r, 2], distance[r]
        x[n], y[n] = origin[0] + t * dx, origin[1] + t * dy
        seen[DISTANCE, n], seen[PHASE, n] = t, -(dx * sun_x + dy * sun_y + dz * sun_z)
        seen[FACING, n] = -(dx * normal[r, 0] + dy * normal[r, 1] + dz * normal[r, 2])
        seen[SHADOW, n] = sunlit(vehicle, x[n], y[n], origin[2] + t * dz)
    for n in range(len(index)):
        seen[FACING, n] = max(seen[FACING, n], f32(0.02))
        # Geometric mean of length and width.
        seen[FOOTPRINT, n] = max(seen[DISTANCE, n] * size / np.sqrt(seen[FACING, n]), f32(1e-4))
        seen[FINEST, n] = f32(0.5) / seen[FOOTPRINT, n]


@RAYS.inlined
def _read_channels(ground, x, y, value, places, channels):  # type: ignore[no-untyped-def]
    # Borders between kinds wander.
    along, across = places[2], places[3]
    for n in range(len(x)):
        along[n] = x[n] + ground.ragged * (value[6, n] + f32(0.5) * value[4, n])
    for n in range(len(x)):
        across[n] = y[n] + ground.ragged * (value[5, n] - f32(0.5) * value[3, n])
    for n in range(len(x)):
        read_nodes(ground, along[n], across[n], channels[n])


@RAYS.inlined
def _add_tracks(count, value, seen, channels, work):  # type: ignore[no-untyped-def]
    # Tracks of tyres along trails.
    tone, relief, track = work[TONE], work[RELIEF], work[4]
    for n in range(count):
        wander = value[6, n] + f32(0.5) * value[4, n]
        off = channels[n, TRAIL] * f32(TRAIL_REACH) - f32(TRACK_OFFSET) + f32(0.05) * wander
        bowl = max(f32(1) - f32(0.3 / TRACK_WIDTH**2) * off * off, f32(0))
        track[n] = bowl * bowl * min(f32(TRACK_WIDTH) / seen[FOOTPRINT, n], f32(1))
    for n in range(count):
        tone[n] = tone[n] * (f32(1) - f32(0.5) * track[n]) - f32(0.10) * track[n]
        relief[n] = relief[n] * (f32(1) - f32(0.6) * track[n])


@RAYS.inlined
def _mix_octaves(count, value, slope, channels, work):  # type: ignore[no-untyped-def]
    # Hue, tone and relief, without details.
    hue, tone, relief, fine, middle = work[HUE], work[TONE], work[RELIEF], work[4], work[5]
    for n in range(count):
        share = f32(0.5) + f32(0.35) * (value[9, n] - value[8, n] + value[7, n] - value[6, n] + value[5, n])
        hue[n] = min(max(share, f32(0)), f32(1))
    for n in range(count):
        middle[n] = f32(0.5) * (value[3, n] + value[4, n] + value[5, n])
    for n in range(count):
        fine[n] = value[0, n] + value[1, n] + value[2, n] + middle[n]
    for n in range(count):
        middle[n] += value[6, n] + value[7, n] + value[8, n] + value[9, n]  # coarse from now on
    for n in range(count):
        tone[n] = f32(MOST_RELIEF) * (channels[n, FINE] * fine[n] + channels[n, COARSE] * middle[n])
    for n in range(count):
        relief[n] = slope[0, n] + slope[1, n] + slope[2, n]
    for n in range(count):
        relief[n] += slope[3, n] + slope[4, n] + slope[5, n]
    for n in range(count):
        relief[n] *= f32(MOST_RELIEF) * channels[n, BUMPS]


@RAYS.inlined
def _add_details(ground, x, y, seen, value, c, n, tone, relief):  # type: ignore[no-untyped-def]
    # What only some grounds have, and only near ones show; returns the share of soil that blades leave bare.
    bare, facing, footprint = f32(0), seen[FACING, n], seen[FOOTPRINT, n]
    if c[STONES] > f32(0.02) and footprint < f32(STONE_SIZE / 2):
        sharp = min(f32(STONE_SIZE / 2) / footprint - f32(1), f32(1))
        at_x, at_y = x / STONE_SIZE + f32(0.25) * value[2, n], y / STONE_SIZE + f32(0.25) * value[1, n]
        tone[n] += c[STONES] * sharp * pebbles(ground.lattice, at_x, at_y)
    if c[BLADES] > f32(0.02):
        # Blades hide the soil the more, the flatter one looks.
        bare = np.exp(f32(-3) * c[BLADES] / facing)
        if footprint < f32(2 * BLADE_WIDTH):
            sharp = min(f32(2 * BLADE_WIDTH) / footprint - f32(1), f32(1))
            lean = f32(3.0) * value[8, n] + f32(1.5) * value[6, n]
            cos, sin = np.cos(lean), np.sin(lean)
            across, along = (cos * x + sin * y) / BLADE_WIDTH, (cos * y - sin * x) / BLADE_LENGTH
            tone[n] += c[BLADES] * sharp * value_noise(ground.lattice, across, along)[0]
    if c[RIPPLES] > f32(0.02) and footprint < f32(RIPPLE_LENGTH / 2):
        sharp = min(f32(RIPPLE_LENGTH / 2) / footprint - f32(1), f32(1))
        along = (0.8 * x + 0.6 * y) / RIPPLE_LENGTH + 4.0 * value[9, n] + 2.5 * value[8, n]
        along += 1.2 * value[7, n] + 0.5 * value[6, n]
        relief[n] += c[RIPPLES] * sharp * f32(np.cos(2 * np.pi * along)) * (f32(1) + value[6, n])
    return bare


@RAYS.inlined
def _light_ground(ground, light, count, seen, channels, work, out):  # type: ignore[no-untyped-def]
    hue, tone, relief, bare = work[HUE], work[TONE], work[RELIEF], work[BARE]
    sun, gloss, clear = work[4], work[5], work[6]
    for n in range(count):
        # Rough ground is brightest where one looks away from the sun and sees no shadows (Hapke, JGR 86, 1981).
        rough = min(max(f32(1) + relief[n], f32(0.15)), f32(2))
        sun[n] = channels[n, SUN] * seen[SHADOW, n] * rough * (f32(1) + f32(0.25) * seen[PHASE, n])
    for n in range(count):
        away = f32(1) - seen[FACING, n]
        flat = away * away
        # Schlick, Computer Graphics Forum 13, 1994
        gloss[n] = channels[n, GLOSS] * (f32(0.02) + f32(0.98) * flat * flat * away)
    for n in range(count):
        tone[n] = max(f32(1) + tone[n], f32(0.25))
    for n in range(count):
        clear[n] = np.exp(-f32(light.haze) * seen[DISTANCE, n])
    for channel in range(3):
        colour, soil = out[channel], ground.soil[channel]
        of_sun, of_sky = f32(light.sun_colour[channel]), f32(light.sky_colour[channel])
        horizon = f32(light.horizon_colour[channel])
        for n in range(count):
            low = channels[n, LOW + channel]
            root = low + hue[n] * (channels[n, HIGH + channel] - low)
            colour[n] = root * root
        for n in range(count):
            seen_soil = colour[n] + bare[n] * (soil - colour[n])
            colour[n] = seen_soil * tone[n] * (sun[n] * of_sun + of_sky)
        for n in range(count):
            reflected = colour[n] + gloss[n] * (horizon - colour[n])
            colour[n] = horizon + clear[n] * (reflected - horizon)
