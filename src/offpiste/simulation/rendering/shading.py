"""Shading of rays: the colour of ground, plants, sky and the vehicle itself, linear RGB (shading.h).

Textures are value noise (Ebert et al., Texturing and Modeling, 2003, ch. 2) of the place in the world, in octaves from
centimetres to metres, which reads one small table of random numbers. Each octave is rotated by another angle to hide
the period. Octaves finer than a pixel are left out, so that the same ground looks different from near and far.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from offpiste.native.library import entry
from offpiste.simulation.rendering.scene import Hits

WAVELENGTHS: Final = 0.0125 * 2.0 ** np.arange(10)
"""Wavelengths of the octaves, 1.25 cm to 6.4 m [m]."""

OCTAVES: Final = len(WAVELENGTHS)
PERIOD: Final = 128
"""Number of octaves, and period of the table of random numbers, as in shading.h."""
LOW, HIGH = 0, 3
FINE, COARSE, BUMPS, STONES, BLADES, RIPPLES, GLOSS, TRAIL, SUN, OPEN, CHANNELS = range(6, 17)
"""Channels of `GroundTexture.nodes`, as in shading.h; LOW and HIGH are the first of three."""
MOST_RELIEF = 0.5
"""Relief and tone at which their channels saturate."""
TRAIL_REACH = 4.0
"""Distance to a trail's centre line at which its channel saturates [m]."""


def random_lattice(rng: np.random.Generator) -> Float[np.ndarray, "n n"]:
    """Return periodic random numbers in [-1, 1], with the first row and column repeated at the end."""
    return np.pad(rng.uniform(-1, 1, (PERIOD, PERIOD)).astype(np.float32), ((0, 1), (0, 1)), mode="wrap")


def octave_turns(rng: np.random.Generator) -> Float[np.ndarray, "O 2"]:
    """Return the cosine and sine of each octave's angle, divided by its wavelength [1/m]."""
    angle = rng.uniform(0, 2 * np.pi, OCTAVES)
    return (np.stack((np.cos(angle), np.sin(angle)), axis=1) / WAVELENGTHS[:, None]).astype(np.float32)


class GroundTexture(NamedTuple):
    """Appearance of the ground at the nodes of the world."""

    # Square roots of the two colours blended by large noise (3 each), brightness shares of fine and coarse noise,
    # relief, stones, blades and ripples, gloss of water, distance to the trail's centre line, direct sun on the ground,
    # sun on plants; 0..255
    nodes: UInt8[np.ndarray, "ny nx c"]
    x0: float  # x of node [0, 0] [m]
    y0: float  # y of node [0, 0] [m]
    resolution: float  # spacing of the nodes [m]
    elevation: Float[np.ndarray, "ny nx"]  # [m]
    lattice: Float[np.ndarray, "n n"]  # `random_lattice`
    turn: Float[np.ndarray, "O 2"]  # `octave_turns`
    sun: Float[np.ndarray, "O 2"]  # horizontal direction to the sun in each octave's lattice
    soil: Float[np.ndarray, " 3"]  # colour between blades
    plants: Float[np.ndarray, "4 3"]  # colours of trunks, crowns and bushes, and factor of blades on the ground below


class Light(NamedTuple):
    """Light of a drive; colours are linear RGB, with about 1 for white ground in full sun."""

    sun: Float[np.ndarray, " 3"]  # unit vector to the sun in the world frame
    sun_colour: Float[np.ndarray, " 3"]  # light of the sun on a surface facing it
    sky_colour: Float[np.ndarray, " 3"]  # light of the whole sky on a level surface
    horizon_colour: Float[np.ndarray, " 3"]  # visible colours of the sky
    zenith_colour: Float[np.ndarray, " 3"]
    haze: float  # share of light lost per metre [1/m]
    overcast: float  # share of clouds in the sky [0..1]
    clouds: Float[np.ndarray, " 2"]  # offset of the pattern of clouds
    exposure: float  # factor on the automatic exposure
    balance: Float[np.ndarray, " 3"]  # white balance factors of red, green and blue


class Vehicle(NamedTuple):
    """The vehicle in an image, with its own shadow."""

    position: Float[np.ndarray, " 3"]  # `world_from_body`
    rotation: Float[np.ndarray, "3 3"]  # `world_from_body`
    sun: Float[np.ndarray, " 3"]  # direction to the sun in the body frame, not exactly along an axis
    shadow: Float[np.ndarray, "n 2 3"]  # a bounding box, then the boxes that cast shadows, in the body frame
    paint: Float[np.ndarray, "m 3"]  # colour of each box


_GROUND = (int, int, float, float, float, "u1", "f4", "f4", "f4", "f4", "f4", "f4")
_HITS = (int, "f4", "f4", "i1", "i4", "f4")
_shade_rays = entry("shade_rays", *_GROUND, "f4", "f8", int, "f4", int, "f4", float, "f8", *_HITS, "i4", "f4")


def shade_rays(
    ground: GroundTexture,
    light: Light,
    vehicle: Vehicle,
    pixel: float,
    origin: Float[np.ndarray, " 3"],
    rays: Float[np.ndarray, "n 3"],
    hits: Hits,
    places: Int[np.ndarray, " n"],
    out: Float[np.ndarray, "m 3"],
) -> None:
    """Shade rays with known hits.

    Args:
        pixel: angle of a pixel [rad].
        origin: origin of the rays in the world frame [m].
        rays: in the world frame.
        hits: normals are in the world frame, on the vehicle itself in the body frame.
        places: row of each ray in `out`.
        out: result, linear RGB; other rows are left as they are.

    Raises:
        ValueError: a shape is wrong, or a place lies outside `out`.
    """
    shadow, paint = (np.ascontiguousarray(boxes, np.float32) for boxes in (vehicle.shadow, vehicle.paint))
    numbers = np.concatenate([np.ravel(values) for values in light]).astype(np.float32)
    pose = np.concatenate([np.ravel(values) for values in vehicle[:3]]).astype(float)
    nodes, count, found = ground.nodes.shape[:2], len(rays), (rays, *vars(hits).values())
    texture = (ground.nodes, ground.elevation, ground.lattice, ground.turn, ground.sun, ground.soil, ground.plants)
    _check_shapes(texture, ((*nodes, CHANNELS), nodes, (PERIOD + 1,) * 2, (OCTAVES, 2), (OCTAVES, 2), (3,), (4, 3)))
    _check_shapes((numbers, pose, origin), ((23,), (15,), (3,)))
    _check_shapes((shadow, paint), ((len(shadow), 2, 3), (len(paint), 3)))
    of_rays = ((count, 3), (count,), (count,), (count,), (count, 3), (count,))
    _check_shapes((*found, places, out), (*of_rays, (len(out), 3)))
    if min(nodes) < 2 or not len(shadow):
        raise ValueError(f"shading needs 2 x 2 nodes and a box around the vehicle, not {nodes} and {len(shadow)}")
    if count and not 0 <= places.min() <= places.max() < len(out):
        raise ValueError(f"places {places.min()} to {places.max()} exceed the {len(out)} rows")
    grid, boxes = (*nodes, ground.x0, ground.y0, ground.resolution), (len(shadow), shadow, len(paint), paint)
    _shade_rays(*grid, *texture, numbers, pose, *boxes, pixel, origin, count, *found, places, out)


def _check_shapes(arrays: tuple[np.ndarray, ...], wanted: tuple[tuple[int, ...], ...]) -> None:
    if (shapes := tuple(array.shape for array in arrays)) != wanted:
        raise ValueError(f"shading needs arrays of shapes {wanted}, not {shapes}")
