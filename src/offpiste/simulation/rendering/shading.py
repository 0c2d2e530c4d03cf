"""Shading of rays: the colour of ground, plants, sky and the vehicle itself, linear RGB (compiled).

Ground is shaded in batches whose loops run in vectors of single precision; all else ray by ray. A plain reference for
the ground is in `tests/simulation/rendering/test_shading.py`.

Textures are value noise (Ebert et al., Texturing and Modeling, 2003, ch. 2) of the place in the world, in octaves from
centimetres to metres, which reads one small table of random numbers. Each octave is rotated by another angle to hide
the period. Octaves finer than a pixel are left out, so that the same ground looks different from near and far.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import float32 as f32

from offpiste.native.compilation import RAYS

WAVELENGTHS: Final = 0.0125 * 2.0 ** np.arange(10)
"""Wavelengths of the octaves, 1.25 cm to 6.4 m [m]."""

PERIOD: Final = 128
"""Period of the table, a power of two."""

_WRAP, _NEXT = np.int32(PERIOD - 1), np.uint32(1)
_ZERO, _ONE, _TWO, _THREE, _SIX = np.float32(0), np.float32(1), np.float32(2), np.float32(3), np.float32(6)


def random_lattice(rng: np.random.Generator) -> Float[np.ndarray, "n n"]:
    """Return periodic random numbers in [-1, 1], with the first row and column repeated at the end."""
    return np.pad(rng.uniform(-1, 1, (PERIOD, PERIOD)).astype(np.float32), ((0, 1), (0, 1)), mode="wrap")


def octave_turns(rng: np.random.Generator) -> Float[np.ndarray, "O 2"]:
    """Return the cosine and sine of each octave's angle, divided by its wavelength [1/m]."""
    angle = rng.uniform(0, 2 * np.pi, len(WAVELENGTHS))
    return (np.stack((np.cos(angle), np.sin(angle)), axis=1) / WAVELENGTHS[:, None]).astype(np.float32)


@RAYS.inlined
def hashed(i, j, seed):  # type: ignore[no-untyped-def]
    """Return a pseudorandom number in [0, 1) (after the finaliser of MurmurHash3)."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F) + np.uint64(seed)
    h = (h ^ (h >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xC4CEB9FE1A85EC53)
    return np.float32(h >> np.uint64(40)) * np.float32(1.0 / 16777216.0)


@RAYS.inlined
def value_noise(lattice, x, y):  # type: ignore[no-untyped-def]
    """Return smooth noise of unit wavelength in [-1, 1], and its slopes."""
    low_x, low_y = np.floor(x), np.floor(y)
    i, j = np.int32(low_x) & _WRAP, np.int32(low_y) & _WRAP
    u, v = np.float32(x - low_x), np.float32(y - low_y)
    return blended(lattice[j, i], lattice[j, i + 1], lattice[j + 1, i], lattice[j + 1, i + 1], u, v)


@RAYS.inlined
def blended(corner, right, far, opposite, u, v):  # type: ignore[no-untyped-def]
    """Return the noise and its slopes at (u, v) in a cell with given values at its corners."""
    along_x, along_y = right - corner, far - corner
    twist = opposite - corner - along_x - along_y
    s, t = u * u * (_THREE - _TWO * u), v * v * (_THREE - _TWO * v)
    value = corner + along_x * s + (along_y + twist * s) * t
    slope_x = (along_x + twist * t) * (_SIX * u * (_ONE - u))
    slope_y = (along_y + twist * s) * (_SIX * v * (_ONE - v))
    return value, slope_x, slope_y


@RAYS.loop
def octaves(lattice, turn, sun, x, y, finest, cells, work, value, slope):  # type: ignore[no-untyped-def]
    """Write the noise of each octave at many places and its slope towards the sun, faded where a pixel is too coarse.

    Places are processed in batches, so that all but table look-ups run in vectors.

    Args:
        turn: `octave_turns`.
        sun: horizontal direction to the sun in each octave's lattice [O, 2].
        x, y: places in double precision [n] [m].
        finest: highest frequency that a pixel resolves (Nyquist) [n] [1/m].
        cells, work: integer and float buffers [2, >= n], [6, >= n].
        value, slope: results [O, >= n].
    """
    places, sharpest = len(x), _ZERO
    column, row, off_x, off_y = cells[0], cells[1], work[0], work[1]
    corner, right, far, opposite = work[2], work[3], work[4], work[5]
    for n in range(places):
        sharpest = max(sharpest, finest[n])
    for o in range(len(turn) - 1, -1, -1):
        cos, sin = turn[o, 0], turn[o, 1]
        wavelength = _ONE / np.sqrt(cos * cos + sin * sin)
        if sharpest * wavelength <= _ONE:
            for finer in range(o + 1):
                for n in range(places):
                    value[finer, n] = slope[finer, n] = 0
            break
        # Shift the lattices so that they share no origin.
        shift_x, shift_y = float(o * 17), float(o * 29)
        # LLVM does not vectorise loops over more arrays than these.
        for n in range(places):
            at = cos * x[n] + sin * y[n] + shift_x
            low = np.floor(at)
            off_x[n], column[n] = np.float32(at - low), np.int32(low) & _WRAP
        for n in range(places):
            at = cos * y[n] - sin * x[n] + shift_y
            low = np.floor(at)
            off_y[n], row[n] = np.float32(at - low), np.int32(low) & _WRAP
        for n in range(places):
            i, j = np.uint32(column[n]), np.uint32(row[n])
            corner[n], right[n] = lattice[j, i], lattice[j, i + _NEXT]
            far[n], opposite[n] = lattice[j + _NEXT, i], lattice[j + _NEXT, i + _NEXT]
        values, slopes, sun_x, sun_y = value[o], slope[o], sun[o, 0], sun[o, 1]
        for n in range(places):
            fade = min(max(finest[n] * wavelength - _ONE, _ZERO), _ONE)
            result, _, _ = blended(corner[n], right[n], far[n], opposite[n], off_x[n], off_y[n])
            values[n] = fade * result
        for n in range(places):
            fade = min(max(finest[n] * wavelength - _ONE, _ZERO), _ONE)
            _, slope_x, slope_y = blended(corner[n], right[n], far[n], opposite[n], off_x[n], off_y[n])
            slopes[n] = -fade * (slope_x * sun_x + slope_y * sun_y)


@RAYS.inlined
def pebbles(lattice, x, y):  # type: ignore[no-untyped-def]
    """Return the brightness of round stones about one unit apart (Worley noise, SIGGRAPH 1996, over four cells)."""
    low_x, low_y = np.floor(x - 0.5), np.floor(y - 0.5)
    nearest, tone = np.float32(9.0), np.float32(0.0)
    for n in range(4):
        cell_x, cell_y = low_x + (n & 1), low_y + (n >> 1)
        i, j = np.int32(cell_x) & _WRAP, np.int32(cell_y) & _WRAP
        off_x = np.float32(x - cell_x - 0.5) - np.float32(0.42) * lattice[j, i]
        off_y = np.float32(y - cell_y - 0.5) - np.float32(0.42) * lattice[i, j]
        distance = off_x * off_x + off_y * off_y
        if distance < nearest:
            nearest, tone = distance, lattice[(j + 64) & _WRAP, i]
    # Large stones are rarer than small ones; stones are brightest in the middle.
    size = np.float32(0.16) + np.float32(0.10) * tone
    return np.float32(0.5) * tone + np.float32(0.45) - nearest if nearest < size else np.float32(-0.3)


SKY, GROUND, TRUNK, CROWN, BUSH, GRASS, BODY = range(7)
"""Indices of `scene.SURFACES`."""
SHADOW_REACH = 8.0
"""Distance from the vehicle up to which its shadow is drawn [m]."""
LOW, HIGH = 0, 3
FINE, COARSE, BUMPS, STONES, BLADES, RIPPLES, GLOSS, TRAIL, SUN, OPEN, CHANNELS = range(6, 17)
"""Channels of `GroundTexture.nodes`; LOW and HIGH are the first of three."""
MOST_RELIEF = 0.5
"""Relief and tone at which their channels saturate."""

TRAIL_REACH = 4.0
"""Distance to a trail's centre line at which its channel saturates [m]."""
TRACK_OFFSET, TRACK_WIDTH = 0.66, 0.17
"""Offset of tyre tracks from a trail's centre line (half the vehicle's track), and their width [m]."""

STONE_SIZE, BLADE_WIDTH, BLADE_LENGTH, RIPPLE_LENGTH = 0.05, 0.012, 0.09, 0.13
"""Sizes of texture other than noise [m]."""
RAGGED = 0.12
"""Amplitude of the borders between kinds of ground [m]."""
HUE, TONE, RELIEF, BARE = range(4)
"""Rows of `work` between the steps."""
FACING, PHASE, FOOTPRINT, FINEST, SHADOW, DISTANCE = range(6)
"""Rows of `seen`: cosine between surface normal and ray; cosine between reversed ray and sun; size of the pixel on the
ground [m]; highest frequency it resolves [1/m]; 0 in the vehicle's own shadow, else 1; distance [m]."""
TOGETHER = 128
"""Size of a batch of ground points; small enough for its noise to stay in the cache."""


class GroundTexture(NamedTuple):
    """Appearance of the ground at the nodes of the world."""

    # [ny, nx, CHANNELS], 0..255: square roots of the two colours blended by large noise (3 each), brightness shares
    # of fine and coarse noise, relief, stones, blades and ripples, gloss of water, distance to the trail's centre
    # line, direct sun on the ground, sun on plants
    nodes: np.ndarray
    x0: float  # x of node [0, 0] [m]
    y0: float  # y of node [0, 0] [m]
    resolution: float  # spacing of the nodes [m]
    elevation: np.ndarray  # [ny, nx] [m]
    lattice: np.ndarray  # tables of the noise
    turn: np.ndarray  # tables of the noise
    sun: np.ndarray  # horizontal direction to the sun in each octave's lattice [O, 2]
    soil: np.ndarray  # colour between blades [3]
    # Colours of trunks, crowns and bushes, and factor of blades on the colour of the ground below [4, 3]
    plants: np.ndarray


class Vehicle(NamedTuple):
    """The vehicle in an image, with its own shadow."""

    position: np.ndarray  # `world_from_body`
    rotation: np.ndarray  # `world_from_body`
    sun: np.ndarray  # direction to the sun in the body frame, not exactly along an axis
    shadow: np.ndarray  # a bounding box, then the boxes that cast shadows, in the body frame [n, 2, 3]
    paint: np.ndarray  # colour of each box [m, 3]


@RAYS.inlined
def meets(boxes, b, px, py, pz, ix, iy, iz):  # type: ignore[no-untyped-def]
    """Return whether a ray from p with inverse direction i meets a box (slab test, Kay and Kajiya, SIGGRAPH 1986)."""
    x0, x1 = (boxes[b, 0, 0] - px) * ix, (boxes[b, 1, 0] - px) * ix
    y0, y1 = (boxes[b, 0, 1] - py) * iy, (boxes[b, 1, 1] - py) * iy
    z0, z1 = (boxes[b, 0, 2] - pz) * iz, (boxes[b, 1, 2] - pz) * iz
    enter = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), 0.0))
    return enter < min(min(max(x0, x1), max(y0, y1)), max(z0, z1))


@RAYS.inlined
def sunlit(vehicle, x, y, z):  # type: ignore[no-untyped-def]
    """Return 0 if a place in the world frame lies in the vehicle's shadow, else 1."""
    position, rotation, sun = vehicle.position, vehicle.rotation, vehicle.sun
    bx, by, bz = x - position[0], y - position[1], z - position[2]
    if bx * bx + by * by >= SHADOW_REACH * SHADOW_REACH:
        return 1.0
    px = rotation[0, 0] * bx + rotation[1, 0] * by + rotation[2, 0] * bz
    py = rotation[0, 1] * bx + rotation[1, 1] * by + rotation[2, 1] * bz
    pz = rotation[0, 2] * bx + rotation[1, 2] * by + rotation[2, 2] * bz
    ix, iy, iz = 1 / sun[0], 1 / sun[1], 1 / sun[2]
    if meets(vehicle.shadow, 0, px, py, pz, ix, iy, iz):
        for b in range(1, len(vehicle.shadow)):
            if meets(vehicle.shadow, b, px, py, pz, ix, iy, iz):
                return 0.0
    return 1.0


@RAYS.inlined
def read_nodes(ground, x, y, c):  # type: ignore[no-untyped-def]
    """Read all channels at (x, y), bilinear, 0..1, into `c`; clamped at the border."""
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


def ground_buffers(octave_count: int) -> tuple[np.ndarray, ...]:
    """Return buffers of `shade_ground` for one thread."""
    n = TOGETHER
    numbers = [np.zeros(shape, np.float32) for shape in ((6, n), (2, octave_count, n), (n, CHANNELS), (8, n), (3, n))]
    return (np.zeros((4, n)), np.zeros((2, n), np.int32), *numbers)


@RAYS.loop
def shade_ground(ground, light, vehicle, pixel, origin, rays, distance, normal, index, buffers, out):  # type: ignore[no-untyped-def]
    """Shade ground, with haze, for at most `TOGETHER` rays in `index`; other arguments as in `shade_rays`."""
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


# LLVM does not vectorise loops over more arrays than those below, hence one loop per result.


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
        # geometric mean of length and width
        seen[FOOTPRINT, n] = max(seen[DISTANCE, n] * size / np.sqrt(seen[FACING, n]), f32(1e-4))
        seen[FINEST, n] = f32(0.5) / seen[FOOTPRINT, n]


@RAYS.inlined
def _read_channels(ground, x, y, value, places, channels):  # type: ignore[no-untyped-def]
    # Displace the borders between kinds.
    along, across = places[2], places[3]
    for n in range(len(x)):
        along[n] = x[n] + RAGGED * (value[6, n] + f32(0.5) * value[4, n])
    for n in range(len(x)):
        across[n] = y[n] + RAGGED * (value[5, n] - f32(0.5) * value[3, n])
    for n in range(len(x)):
        read_nodes(ground, along[n], across[n], channels[n])


@RAYS.inlined
def _add_tracks(count, value, seen, channels, work):  # type: ignore[no-untyped-def]
    # Tyre tracks along trails.
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
    # Hue, tone and relief without details.
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
    # Stones, blades and ripples, visible from nearby; returns the share of soil visible between blades.
    bare, facing, footprint = f32(0), seen[FACING, n], seen[FOOTPRINT, n]
    if c[STONES] > f32(0.02) and footprint < f32(STONE_SIZE / 2):
        sharp = min(f32(STONE_SIZE / 2) / footprint - f32(1), f32(1))
        at_x, at_y = x / STONE_SIZE + f32(0.25) * value[2, n], y / STONE_SIZE + f32(0.25) * value[1, n]
        tone[n] += c[STONES] * sharp * pebbles(ground.lattice, at_x, at_y)
    if c[BLADES] > f32(0.02):
        # blades hide more soil at flatter view angles
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
        # Rough ground is brightest seen along the sun, where no shadows are visible (Hapke, JGR 86, 1981).
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


def shading_buffers(octave_count: int) -> tuple[Any, ...]:
    """Return buffers of `shade_rays` for one thread."""
    channels, colour = np.zeros(CHANNELS, np.float32), np.zeros(3, np.float32)
    return np.zeros(TOGETHER, np.int64), ground_buffers(octave_count), channels, colour


@RAYS.inlined
def shade_plant(ground, light, kind, item, x, y, z, nx, ny, nz, phase, shadow, c, out):  # type: ignore[no-untyped-def]
    """Shade a leaf, blade or trunk: lit from both sides, darker below."""
    read_nodes(ground, x, y, c)
    own = hashed(item, kind, 43)
    up = 1.0
    if kind != CROWN:
        rows, columns = ground.elevation.shape
        i = min(max(int((x - ground.x0) / ground.resolution + 0.5), 0), columns - 1)
        j = min(max(int((y - ground.y0) / ground.resolution + 0.5), 0), rows - 1)
        up = min(max(0.35 + 1.3 * (z - ground.elevation[j, i]), 0.35), 1.0)
    facing = abs(nx * light.sun[0] + ny * light.sun[1] + nz * light.sun[2])
    sun = c[OPEN] * shadow * (0.25 + 0.75 * facing) * up * (1 + 0.3 * phase)
    sky = up * (0.6 + 0.4 * abs(nz))
    for channel in range(3):
        colour = ground.plants[kind - TRUNK, channel]
        if kind == GRASS:
            root = c[LOW + channel] + own * (c[HIGH + channel] - c[LOW + channel])
            colour *= root * root
        out[channel] = colour * (0.7 + 0.6 * own) * (sun * light.sun_colour[channel] + sky * light.sky_colour[channel])


@RAYS.inlined
def shade_sky(lattice, light, dx, dy, dz, out):  # type: ignore[no-untyped-def]
    """Shade the sky: brighter towards the horizon and the sun, with clouds."""
    rise = max(dz, np.float32(0.0))
    flat = (1 - rise) ** 4
    towards = max(dx * light.sun[0] + dy * light.sun[1] + dz * light.sun[2], 0.0)
    glow = 0.25 * towards**8 + 2.0 * towards**300
    cx, cy = 0.8 * dx / (rise + 0.12) + light.clouds[0], 0.8 * dy / (rise + 0.12) + light.clouds[1]
    cloud = 0.0
    for o in range(4):
        cloud += value_noise(lattice, cx * 2**o, cy * 2**o)[0] / 2**o
    cloud = min(max((cloud + 2.0 * light.overcast - 0.9) * 1.2, 0.0), 1.0) * min(8 * rise, 1.0)
    for channel in range(3):
        clear = light.zenith_colour[channel] + flat * (light.horizon_colour[channel] - light.zenith_colour[channel])
        clear += glow * light.sun_colour[channel]
        out[channel] = clear + 0.8 * cloud * (0.85 - clear)


@RAYS.entry
def shade_rays(  # type: ignore[no-untyped-def]
    ground, light, vehicle, pixel, origin, rays, distance, surface, item, normal, buffers, out
):
    """Shade rays with known hits, linear RGB.

    Args:
        pixel: angle of a pixel [rad].
        origin: origin of the rays in the world frame [m].
        rays, normal: in the world frame; normals on the vehicle itself in the body frame.
        buffers: `shading_buffers`.
        out: result [n, 3].
    """
    index, ground_buffers, channels, colour = buffers
    sun_x, sun_y, sun_z = f32(light.sun[0]), f32(light.sun[1]), f32(light.sun[2])
    waiting = 0
    for r in range(len(rays)):
        dx, dy, dz = rays[r, 0], rays[r, 1], rays[r, 2]
        kind, t = surface[r], distance[r]
        if kind == GROUND:
            index[waiting] = r
            waiting += 1
        elif kind == SKY:
            shade_sky(ground.lattice, light, dx, dy, dz, out[r])
        elif kind == BODY:
            shade_body(light, vehicle, item[r], normal[r, 0], normal[r, 1], normal[r, 2], out[r])
        else:
            x, y, z = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
            shadow = sunlit(vehicle, x, y, z)
            phase = -(dx * sun_x + dy * sun_y + dz * sun_z)
            leaf = (normal[r, 0], normal[r, 1], normal[r, 2], phase, shadow)
            shade_plant(ground, light, kind, item[r], x, y, z, *leaf, channels, colour)
            through_haze(light, t, colour, out[r])
        if waiting == TOGETHER or (waiting > 0 and r == len(rays) - 1):
            where = index[:waiting]
            shade_ground(ground, light, vehicle, pixel, origin, rays, distance, normal, where, ground_buffers, out)
            waiting = 0


@RAYS.inlined
def shade_body(light, vehicle, box, nx, ny, nz, out):  # type: ignore[no-untyped-def]
    """Shade the vehicle itself, with the normal in the body frame."""
    facing = max(nx * vehicle.sun[0] + ny * vehicle.sun[1] + nz * vehicle.sun[2], 0.0)
    for channel in range(3):
        sky = (0.6 + 0.4 * nz) * light.sky_colour[channel]
        out[channel] = vehicle.paint[box, channel] * (0.8 * facing * light.sun_colour[channel] + sky)


@RAYS.inlined
def through_haze(light, distance, colour, out):  # type: ignore[no-untyped-def]
    """Blend a colour with that of the horizon by the haze over a distance."""
    clear = np.exp(-np.float32(light.haze) * distance)
    for channel in range(3):
        out[channel] = light.horizon_colour[channel] + clear * (colour[channel] - light.horizon_colour[channel])
