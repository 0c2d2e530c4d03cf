"""Shading of rays: the colour that each one returns, linear RGB (compiled, one ray after the other)."""

from typing import Any

import numpy as np
from numpy import float32 as f32

from offpiste.compilation import RAYS
from offpiste.simulation.rendering.ground_shading import (
    CHANNELS,
    HIGH,
    LOW,
    OPEN,
    TOGETHER,
    ground_buffers,
    read_nodes,
    shade_ground,
)
from offpiste.simulation.rendering.own_shadow import sunlit
from offpiste.simulation.rendering.texture_noise import hashed, value_noise

SKY, GROUND, TRUNK, CROWN, BUSH, GRASS, BODY = range(7)


def shading_buffers(octave_count: int) -> tuple[Any, ...]:
    """Buffers of `shade_rays`, which a thread uses alone."""
    channels, colour = np.zeros(CHANNELS, np.float32), np.zeros(3, np.float32)
    return np.zeros(TOGETHER, np.int64), ground_buffers(octave_count), channels, colour


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
