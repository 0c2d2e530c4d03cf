"""Appearance of a world during a drive: colours and textures of the ground, sun, sky, clouds, haze and exposure.

The light varies between drives and is independent of grip.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.rendering import shading
from offpiste.simulation.rendering.scene import BODY, Scene
from offpiste.simulation.rendering.shading import GroundTexture, Light, octave_turns, random_lattice
from offpiste.simulation.world.grids import Grid, normals_of, smooth_noise, smooth_step
from offpiste.simulation.world.ground import colour_table, grounds
from offpiste.simulation.world.world import World

WARMER, GREENER = np.array((1.0, 0.0, -1.0)), np.array((-0.5, 1.0, -0.5))
"""Directions of white balance errors, mostly along the colours of daylight."""


def draw_light(rng: np.random.Generator, noise: float) -> Light:
    """Draw a random light: a fixed clear afternoon at noise 0; any dry weather, sun 20 to 70 degrees high, at 1."""
    azimuth = 2.3 + noise * rng.uniform(-np.pi, np.pi)
    elevation = np.radians(np.clip(48 + noise * rng.uniform(-26, 22), 15, 80))
    overcast = float(np.clip(0.15 + noise * rng.uniform(-0.15, 0.75) * rng.uniform(), 0.0, 0.95))
    visibility = 1500 * np.exp(noise * rng.uniform(-1.2, 1.2))
    sun = np.array((np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)))
    # A low sun is redder and weaker, as its path through the air grows with 1 / sin.
    red = np.exp(-np.array((0.06, 0.10, 0.17)) / np.sin(elevation))
    sun_colour = 0.95 * red * (1 - 0.9 * overcast)
    grey, blue = np.array((0.75, 0.78, 0.82)), np.array((0.30, 0.50, 0.90))
    sky = blue + overcast * (grey - blue)
    return Light(
        sun=sun,
        sun_colour=sun_colour,
        sky_colour=(0.22 + 0.25 * overcast) * (0.4 * grey + 0.6 * sky),
        horizon_colour=0.45 * grey + 0.15 * sky + 0.15 * red,
        zenith_colour=0.55 * sky,
        haze=float(1 / visibility),
        overcast=overcast,
        clouds=rng.uniform(0, 100, 2),
        exposure=float(2.0 ** np.clip(noise * rng.normal(0, 0.25), -1.5, 1.5)),
        balance=np.exp(np.clip(noise * (rng.normal(0, 0.05) * WARMER + rng.normal(0, 0.015) * GREENER), -0.3, 0.3)),
    )


def sunlit_ground(world: World, scene: Scene, light: Light, rng: np.random.Generator) -> tuple[Grid, Grid]:
    """Return the share of sunlight [0..1] at each node: on the ground, with all shadows, and on plants above it."""
    nodes = world.elevation.shape
    x, y = (origin + world.resolution * np.arange(n) for origin, n in zip(world.origin, nodes[::-1], strict=True))
    clouds = smooth_noise(rng, x, y, 40.0) + 0.4 * smooth_noise(rng, x, y, 15.0)
    open_sky = 1 - 0.7 * smooth_step(clouds, 2.0 - 2.5 * light.overcast, 2.8 - 2.5 * light.overcast)
    facing = np.maximum(normals_of(world.elevation, world.resolution) @ light.sun.astype(np.float32), 0)

    place = np.empty((*nodes, 3), np.float32)
    place[..., 0], place[..., 1], place[..., 2] = x, y[:, None], world.elevation + 0.03
    towards = np.broadcast_to(light.sun.astype(np.float32), (place.size // 3, 3))
    shadow = scene.occluded(place.reshape(-1, 3), towards).reshape(nodes)
    return np.where(shadow, 0.0, facing * open_sky), open_sky


COMMON_ROCK: Final = 0.3
"""Similarity in colour of the kinds of ground of a world, at `appearance_noise` 1."""
SOIL: Final = (0.20, 0.14, 0.09)
PLANTS: Final = ((0.14, 0.11, 0.08), (0.12, 0.17, 0.06), (0.20, 0.22, 0.13), (1.1, 1.15, 1.0))
"""Linear RGB of soil between blades, and of trunks, crowns and bushes; factor of blades on the ground below."""


@dataclass(frozen=True)
class Appearance:
    """Inputs of shading besides hits; `shadow_boxes` and `paint` as in `shading.Vehicle`."""

    ground: GroundTexture
    light: Light
    shadow_boxes: Float[np.ndarray, "n 2 3"]
    paint: Float[np.ndarray, "m 3"]


def make_appearance(world: World, scene: Scene, drive_seed: int) -> Appearance:
    """Build the appearance of a world during a drive; takes about half a second, mostly for the shadows.

    The world's seed decides textures, tints and colours of plants, the drive's seed light and clouds.
    `WorldSettings.appearance_noise` scales all of them.
    """
    noise = world.settings.appearance_noise
    of_world, of_drive = np.random.default_rng([world.settings.seed, 5]), np.random.default_rng([drive_seed, 6])
    light, turn = draw_light(of_drive, noise), octave_turns(of_world)
    unit = turn * shading.WAVELENGTHS[:, None]
    # The sun's direction, rotated like each octave: x' = cos x + sin y, y' = cos y - sin x.
    sun = np.stack((unit @ light.sun[:2], unit @ np.array((light.sun[1], -light.sun[0]))), axis=1)
    leaves = np.exp(np.clip(noise * of_world.normal(0, 0.08, (len(PLANTS), 3)), -0.4, 0.4))
    ground = GroundTexture(
        nodes=_nodes(world, scene, light, of_world, of_drive),
        x0=world.origin[0],
        y0=world.origin[1],
        resolution=world.resolution,
        elevation=np.ascontiguousarray(world.elevation, np.float32),
        lattice=random_lattice(of_world),
        turn=turn,
        sun=sun.astype(np.float32),
        soil=np.array(SOIL, np.float32),
        plants=(np.array(PLANTS) * leaves).astype(np.float32),
    )
    boxes = np.array([(part.low, part.high) for part in BODY.values() if part.shadow])
    around = np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))
    paint = np.array([part.paint for part in BODY.values()])
    return Appearance(ground, light, np.concatenate((around[None], boxes)), paint)


def _nodes(
    world: World, scene: Scene, light: Light, of_world: np.random.Generator, of_drive: np.random.Generator
) -> UInt8[np.ndarray, "ny nx c"]:
    """Return `GroundTexture.nodes`."""
    noise, resolution = world.settings.appearance_noise, world.resolution
    nodes = np.empty((*world.elevation.shape, shading.CHANNELS), np.uint8)
    shares = np.square(world.kinds, dtype=np.float32)
    shares /= shares.sum(axis=0)

    # Colours of the kinds, dry and wet, with random patches.
    x, y = (resolution * np.arange(n) for n in world.elevation.shape[::-1])
    patches = (smooth_noise(of_world, x, y, 11.0) + 0.5 * smooth_noise(of_world, x, y, 3.0) for _ in range(2))
    bright, warm = (0.12 * noise * np.clip(patch, -3, 3) for patch in patches)
    for channel, (dry, wet) in enumerate(_colours(of_world, noise).transpose(2, 0, 1, 3)):
        tint = np.exp(bright + (0.5, 0.0, -0.5)[channel] * warm)
        for first, shift in ((shading.LOW, 0), (shading.HIGH, 1)):
            mixed = _mix(shares, dry[shift]) * (1 - world.wetness) + _mix(shares, wet[shift]) * world.wetness
            nodes[..., first + channel] = _byte(np.sqrt(mixed * tint))

    names = ("fine", "coarse", "bumps", "stones", "blades", "ripples")
    for channel, name in enumerate(names, start=shading.FINE):
        full = shading.MOST_RELIEF if channel <= shading.BUMPS else 1.0
        texture = np.array([ground["texture"].get(name, 0.0) for ground in grounds()])
        nodes[..., channel] = _byte(_mix(shares, texture / full))
    nodes[..., shading.GLOSS] = _byte(world.wetness**2 * (0.15 + 0.45 * shares[GROUND_KINDS.index("mud")]))
    nodes[..., shading.TRAIL] = _byte(_distance_to_trails(world) / shading.TRAIL_REACH)
    on_ground, above = sunlit_ground(world, scene, light, of_drive)
    nodes[..., shading.SUN], nodes[..., shading.OPEN] = _byte(on_ground), _byte(above)
    return nodes


def _colours(rng: np.random.Generator, noise: float) -> Float[np.ndarray, "2 2 3 K"]:
    """Return linear RGB, dry and wet, on either side of the accent; soils of worlds differ independently of grip."""
    colour = linear_from_srgb(colour_table())
    local = noise * (rng.normal(0, 0.10, (len(GROUND_KINDS), 1)) + rng.normal(0, 0.04, (len(GROUND_KINDS), 3)))
    colour = colour * np.exp(np.clip(local, -0.6, 0.6))
    # Soils of one world share a parent rock.
    colour += min(COMMON_ROCK * noise, 0.6) * (colour.mean(axis=1, keepdims=True) - colour)
    accent = np.array([ground["texture"]["accent"] for ground in grounds()])
    sides = np.stack((colour - accent, colour + accent), axis=1)
    return np.clip(sides, 0.01, 1.0).transpose(0, 1, 3, 2)


def _mix(shares: Float[np.ndarray, "K ny nx"], values: Float[np.ndarray, " K"]) -> Grid:
    return np.einsum("kji,k->ji", shares, values.astype(np.float32))


def _distance_to_trails(world: World) -> Grid:
    """Return the distance to the nearest centre line, to about half a node [m]."""
    free = np.full(world.elevation.shape, 255, np.uint8)
    for trail in world.trails:
        pixels = np.rint((trail - np.array(world.origin)) / world.resolution).astype(np.int32)
        cv2.polylines(free, [pixels.reshape(-1, 1, 2)], True, 0)
    distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * world.resolution
    return np.asarray(cv2.GaussianBlur(distance, (0, 0), 1.0))


def linear_from_srgb(colour: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Convert sRGB (IEC 61966-2-1) to linear values, both in [0..1]."""
    return np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def _byte(share: Grid) -> UInt8[np.ndarray, "ny nx"]:
    return np.clip(255 * share + 0.5, 0, 255).astype(np.uint8)
