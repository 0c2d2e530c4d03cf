"""The light of one drive: sun, sky, clouds, haze and the camera's mood. It varies from drive to drive and says nothing
about grip.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from offpiste.simulation.noise import smooth_noise, smooth_step
from offpiste.simulation.scene import Scene
from offpiste.simulation.surface import normals_of
from offpiste.simulation.world import World

WARMER, GREENER = np.array((1.0, 0.0, -1.0)), np.array((-0.5, 1.0, -0.5))
"""How a camera's white balance errs: mostly along the colours of daylight."""


class Light(NamedTuple):
    """Colours are linear RGB; white ground in full sun has about 1.

    Attributes:
        sun: unit vector to it, in the world frame.
        sun_colour, sky_colour: light of the sun on a surface that faces it, and of the whole sky on a level one.
        horizon_colour, zenith_colour: of the sky as one sees it.
        haze: share of light lost per metre [1/m].
        overcast: share of the sky with clouds [0..1].
        clouds: offset of their pattern.
        exposure: times what the automatic exposure chooses.
        balance: of red, green and blue by the camera.
    """

    sun: Float[np.ndarray, " 3"]
    sun_colour: Float[np.ndarray, " 3"]
    sky_colour: Float[np.ndarray, " 3"]
    horizon_colour: Float[np.ndarray, " 3"]
    zenith_colour: Float[np.ndarray, " 3"]
    haze: float
    overcast: float
    clouds: Float[np.ndarray, " 2"]
    exposure: float
    balance: Float[np.ndarray, " 3"]


def draw_light(rng: np.random.Generator, noise: float) -> Light:
    """The light of a drive.

    Args:
        noise: 0: always the same clear afternoon; 1: any weather without rain, sun 20 to 70 degrees high.
    """
    azimuth = 2.3 + noise * rng.uniform(-np.pi, np.pi)
    elevation = np.radians(np.clip(48 + noise * rng.uniform(-26, 22), 15, 80))
    overcast = float(np.clip(0.15 + noise * rng.uniform(-0.15, 0.75) * rng.uniform(), 0.0, 0.95))
    visibility = 1500 * np.exp(noise * rng.uniform(-1.2, 1.2))
    sun = np.array((np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)))
    # The lower the sun, the redder (the path through the air grows with 1 / sin), and the weaker.
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


def sunlit_ground(
    world: World, scene: Scene, light: Light, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "ny nx"], Float[np.ndarray, "ny nx"]]:
    """How much of the sun each node gets [0..1]: by the ground, with its slope and all shadows; by plants above it."""
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
