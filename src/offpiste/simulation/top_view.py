"""Top view of a world: natural colours, hillshade, trails and plants."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection

from offpiste.simulation.world.grids import normals_of
from offpiste.simulation.world.ground import colour_table
from offpiste.simulation.world.world import World

SUN = np.array([-0.5, 0.45, 0.74])
"""Direction to the light, from the upper left as on maps."""

_GRASS = np.array([0.62, 0.60, 0.30]), np.array([0.33, 0.43, 0.17])
_CROWN, _BUSH, _SHADOW = "#3d5a2a", "#6f7a4a", "#2a2418"


def draw_top_view(world: World, axes: Axes) -> None:
    """Draw a world into given axes."""
    x0, y0 = world.origin
    ny, nx = world.elevation.shape
    extent = (x0, x0 + (nx - 1) * world.resolution, y0, y0 + (ny - 1) * world.resolution)
    axes.imshow(shaded_colours(world), origin="lower", extent=extent, interpolation="bilinear")
    for loop in world.trails:
        axes.plot(*np.concatenate((loop, loop[:1])).T, color="white", linewidth=0.6, alpha=0.55, dashes=(6, 6))
    _discs(axes, world.bushes.foot[:, :2], world.bushes.radius, _BUSH)
    _discs(axes, world.trees.foot[:, :2], world.trees.crown_radius, _CROWN)
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", xlabel="x [m]", ylabel="y [m]")


def shaded_colours(world: World) -> Float[np.ndarray, "ny nx 3"]:
    """Return the colours of the ground and its tall grass, with hillshade, sRGB [0..1]."""
    dry, wet = colour_table().astype(np.float32)
    shares = np.moveaxis(world.kinds, 0, -1)
    wetness = world.wetness[..., None]
    colour = (1 - wetness) * (shares @ dry) + wetness * (shares @ wet)
    cover = np.clip(world.grass_height / 0.6, 0, 0.75)[..., None]
    straw, green = _GRASS
    colour = (1 - cover) * colour + cover * ((1 - wetness) * straw + wetness * green)
    light = normals_of(world.elevation, world.resolution) @ (SUN / np.linalg.norm(SUN))
    shade = 0.35 + 0.65 * np.clip(light, 0, None) / (SUN[2] / np.linalg.norm(SUN))
    return np.clip(colour * shade[..., None], 0, 1)


def _discs(axes: Axes, centre: Float[np.ndarray, "n 2"], radius: Float[np.ndarray, " n"], colour: str) -> None:
    size = (2 * radius, 2 * radius, np.zeros(len(radius)))
    for offset, face, alpha in ((0.35, _SHADOW, 0.45), (0.0, colour, 1.0)):
        shifted = centre + offset * radius[:, None] * np.array([1.0, -1.0])
        place = {"units": "xy", "offsets": shifted, "offset_transform": axes.transData}
        axes.add_collection(EllipseCollection(*size, facecolor=face, edgecolor="none", alpha=alpha, **place))
