"""Shading of rays: the colour that each one returns, linear RGB (compiled, one ray after the other)."""

from typing import NamedTuple

import numpy as np

from offpiste.compilation import RAYS
from offpiste.simulation.rendering.own_shadow import sunlit
from offpiste.simulation.rendering.texture_noise import hashed, octaves, pebbles, value_noise

SKY, GROUND, TRUNK, CROWN, BUSH, GRASS, BODY = range(7)

LOW, HIGH = 0, 3
FINE, COARSE, RELIEF, STONES, BLADES, RIPPLES, GLOSS, TRAIL, SUN, OPEN, CHANNELS = range(6, 17)
"""Channels of `GroundTexture.nodes`; LOW and HIGH are the first of three."""

MOST_RELIEF = 0.5
"""Relief and tone at which their channels are full."""

TRAIL_REACH = 4.0
"""Distance to a trail's centre line at which its channel is full [m]."""

TRACK_OFFSET, TRACK_WIDTH = 0.66, 0.17
"""Offset of tyre tracks from a trail's centre line (half the vehicle's track), and their width [m]."""

STONE_SIZE, BLADE_WIDTH, BLADE_LENGTH, RIPPLE_LENGTH = 0.05, 0.012, 0.09, 0.13
"""Sizes of texture that is not noise [m]."""


TOGETHER = 128
"""Places on the ground that are shaded together: few enough that their noise stays in the cache."""


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


def shading_buffers(octave_count: int) -> tuple[np.ndarray, ...]:
    """Buffers of `shade_rays`, which a thread uses alone."""
    n = TOGETHER
    channels, colour = np.zeros(CHANNELS, np.float32), np.zeros(3, np.float32)
    place, facing, footprint, finest = np.zeros((2, n)), np.zeros(n), np.zeros(n), np.zeros(n, np.float32)
    noise, work = np.zeros((2, octave_count, n), np.float32), np.zeros((6, n), np.float32)
    return (
        channels,
        colour,
        place,
        facing,
        footprint,
        finest,
        noise,
        np.zeros(n, np.int64),
        np.zeros((2, n), np.int32),
        work,
    )


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


@RAYS.inlined
def shade_ground(ground, light, x, y, facing, phase, footprint, shadow, noise, w, c, out):  # type: ignore[no-untyped-def]
    """Colour of the ground at one place.

    Args:
        facing: cosine between the surface's normal and the ray.
        phase: cosine between the ray back and the sun.
        footprint: size of the pixel on the ground [m].
        shadow: 0 where the vehicle itself keeps the sun off.
        noise, w: `octaves`' noise and slopes, and the place's number among them.
        c: buffer of channels.
        out: [3], overwritten.
    """
    n0, n1, n2, n3, n4 = noise[0, 0, w], noise[0, 1, w], noise[0, 2, w], noise[0, 3, w], noise[0, 4, w]
    n5, n6, n7, n8, n9 = noise[0, 5, w], noise[0, 6, w], noise[0, 7, w], noise[0, 8, w], noise[0, 9, w]
    wander_x, wander_y = n6 + 0.5 * n4, n5 - 0.5 * n3
    read_nodes(ground, x + ground.ragged * wander_x, y + ground.ragged * wander_y, c)

    hue = min(max(np.float32(0.5) + np.float32(0.35) * (n9 - n8 + n7 - n6 + n5), np.float32(0)), np.float32(1))
    for channel in range(3):
        root = c[LOW + channel] + hue * (c[HIGH + channel] - c[LOW + channel])
        out[channel] = root * root
    fine, middle, coarse = n0 + n1 + n2, n3 + n4 + n5, n6 + n7 + n8 + n9
    tone = MOST_RELIEF * (c[FINE] * (fine + 0.5 * middle) + c[COARSE] * (coarse + 0.5 * middle))
    slopes = noise[1, 0, w] + noise[1, 1, w] + noise[1, 2, w] + noise[1, 3, w] + noise[1, 4, w] + noise[1, 5, w]
    relief = MOST_RELIEF * c[RELIEF] * slopes

    if c[STONES] > 0.02 and footprint < STONE_SIZE / 2:
        sharp = min(STONE_SIZE / (2 * footprint) - 1, 1.0)
        tone += c[STONES] * sharp * pebbles(ground.lattice, x / STONE_SIZE + 0.25 * n2, y / STONE_SIZE + 0.25 * n1)
    if c[BLADES] > 0.02:
        # Blades hide the soil the more, the flatter one looks.
        bare = np.exp(-3 * c[BLADES] / facing)
        for channel in range(3):
            out[channel] += bare * (ground.soil[channel] - out[channel])
        if footprint < 2 * BLADE_WIDTH:
            sharp = min(2 * BLADE_WIDTH / footprint - 1, 1.0)
            lean = 3.0 * n8 + 1.5 * n6
            cos, sin = np.cos(lean), np.sin(lean)
            across, along = (cos * x + sin * y) / BLADE_WIDTH, (cos * y - sin * x) / BLADE_LENGTH
            tone += c[BLADES] * sharp * value_noise(ground.lattice, across, along)[0]
    if c[RIPPLES] > 0.02 and footprint < RIPPLE_LENGTH / 2:
        sharp = min(RIPPLE_LENGTH / (2 * footprint) - 1, 1.0)
        along = (0.8 * x + 0.6 * y) / RIPPLE_LENGTH + 4.0 * n9 + 2.5 * n8 + 1.2 * n7 + 0.5 * n6
        relief += c[RIPPLES] * sharp * np.cos(2 * np.pi * along) * (1 + n6)
    if c[TRAIL] < 0.5:
        off = (c[TRAIL] * TRAIL_REACH - TRACK_OFFSET + 0.05 * wander_x) / TRACK_WIDTH
        track = max(1 - 0.3 * off * off, 0.0) ** 2 * min(TRACK_WIDTH / footprint, 1.0)
        tone, relief = tone * (1 - 0.5 * track) - 0.10 * track, relief * (1 - 0.6 * track)

    bright = max(1 + tone, 0.25)
    # Rough ground is brightest where one looks away from the sun and sees no shadows (Hapke, JGR 86, 1981).
    sun = c[SUN] * shadow * min(max(1 + relief, 0.15), 2.0) * (1 + 0.25 * phase)
    flat = (1 - facing) * (1 - facing)
    gloss = c[GLOSS] * (0.02 + 0.98 * flat * flat * (1 - facing))  # Schlick, Computer Graphics Forum 13, 1994
    for channel in range(3):
        lit = out[channel] * bright * (sun * light.sun_colour[channel] + light.sky_colour[channel])
        out[channel] = lit + gloss * (light.horizon_colour[channel] - lit)


@RAYS.inlined
def shade_plant(ground, light, kind, item, x, y, z, nx, ny, nz, phase, shadow, c, out):  # type: ignore[no-untyped-def]
    """Colour of a leaf, blade or trunk: lit from either side, darker below."""
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
    """Colour of the sky: brighter towards the horizon and the sun, with clouds."""
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
    """Linear RGB of rays that have been cast.

    Args:
        pixel: angle of a pixel [rad].
        origin: of the rays, in the world frame [m].
        rays, normal: in the world frame; normals of the vehicle itself in the body frame.
        buffers: `shading_buffers`.
        out: [n, 3], overwritten.
    """
    c, colour, place, facing, footprint, finest, noise, index, cells, work = buffers
    waiting = 0
    for r in range(len(rays)):
        dx, dy, dz = rays[r, 0], rays[r, 1], rays[r, 2]
        kind, t = surface[r], distance[r]
        nx, ny, nz = normal[r, 0], normal[r, 1], normal[r, 2]
        if kind == SKY:
            shade_sky(ground.lattice, light, dx, dy, dz, out[r])
        elif kind == BODY:
            shade_body(light, vehicle, item[r], nx, ny, nz, out[r])
        elif kind == GROUND:
            index[waiting] = r
            place[0, waiting], place[1, waiting] = origin[0] + t * dx, origin[1] + t * dy
            facing[waiting] = max(-float(dx * nx + dy * ny + dz * nz), 0.02)
            # Geometric mean of length and width.
            footprint[waiting] = max(t * pixel / np.sqrt(facing[waiting]), 1e-4)
            finest[waiting] = 0.5 / footprint[waiting]
            waiting += 1
        else:
            x, y, z = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
            shadow = sunlit(vehicle, x, y, z)
            phase = -(dx * light.sun[0] + dy * light.sun[1] + dz * light.sun[2])
            shade_plant(ground, light, kind, item[r], x, y, z, nx, ny, nz, phase, shadow, c, colour)
            through_haze(light, t, colour, out[r])
        if waiting == TOGETHER or (waiting > 0 and r == len(rays) - 1):
            x_all, y_all = place[0, :waiting], place[1, :waiting]
            tables = (ground.lattice, ground.turn, ground.sun)
            octaves(*tables, x_all, y_all, finest[:waiting], cells, work, noise[0], noise[1])
            for w in range(waiting):
                g = index[w]
                dx, dy, dz, t = rays[g, 0], rays[g, 1], rays[g, 2], distance[g]
                shadow = sunlit(vehicle, x_all[w], y_all[w], origin[2] + t * dz)
                phase = -(dx * light.sun[0] + dy * light.sun[1] + dz * light.sun[2])
                look = (facing[w], phase, footprint[w], shadow)
                shade_ground(ground, light, x_all[w], y_all[w], *look, noise, w, c, colour)
                through_haze(light, t, colour, out[g])
            waiting = 0


@RAYS.inlined
def shade_body(light, vehicle, box, nx, ny, nz, out):  # type: ignore[no-untyped-def]
    """Colour of the vehicle itself; its normal is in the body frame."""
    facing = max(nx * vehicle.sun[0] + ny * vehicle.sun[1] + nz * vehicle.sun[2], 0.0)
    for channel in range(3):
        sky = (0.6 + 0.4 * nz) * light.sky_colour[channel]
        out[channel] = vehicle.paint[box, channel] * (0.8 * facing * light.sun_colour[channel] + sky)


@RAYS.inlined
def through_haze(light, distance, colour, out):  # type: ignore[no-untyped-def]
    """A colour as it is seen through the air, which has that of the horizon."""
    clear = np.exp(-np.float32(light.haze) * distance)
    for channel in range(3):
        out[channel] = light.horizon_colour[channel] + clear * (colour[channel] - light.horizon_colour[channel])
