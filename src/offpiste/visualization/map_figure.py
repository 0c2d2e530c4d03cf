"""Map of a drive from above: elevation, features, obstacles and slope, validity, and the wheels' tracks."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.report.feature_colours import colours
from offpiste.report.figure import INK

UNKNOWN, FILLED, OBSERVED, FEATURED = range(4)
"""State of a cell: unknown; filled from a cell nearby; hit by a LiDAR; seen by a camera."""

MOST_CELLS: Final = 3_000_000
"""Largest number of cells of a mosaic; on long drives it takes every second, third, ... cell."""


@dataclass(frozen=True)
class Ground:
    """Cells from above; row j lies at y = origin[1] + j resolution, column i alike in x.

    Attributes:
        origin: x, y of the centre of cell [0, 0] [m].
        elevation: NaN if unknown [m].
        components: the first three features; NaN without features.
        obstacle: height of obstacles above the ground [m]; NaN if unknown.
        slope: rise over run; NaN if unknown.
        known: `UNKNOWN` to `FEATURED`.
    """

    origin: Float[np.ndarray, " 2"]
    resolution: float
    elevation: Float[np.ndarray, "ny nx"]
    components: Float[np.ndarray, "ny nx 3"]
    obstacle: Float[np.ndarray, "ny nx"]
    slope: Float[np.ndarray, "ny nx"]
    known: Int[np.ndarray, "ny nx"]

    def cropped(self, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> "Ground":
        """Return the cells with centres in a box of the world frame."""
        ny, nx = self.known.shape
        first = np.clip(np.ceil((low - self.origin) / self.resolution).astype(int), 0, [nx, ny])
        stop = np.clip(np.floor((high - self.origin) / self.resolution).astype(int) + 1, first, [nx, ny])
        box = slice(first[1], stop[1]), slice(first[0], stop[0])
        layers = (self.elevation, self.components, self.obstacle, self.slope, self.known)
        return Ground(self.origin + first * self.resolution, self.resolution, *(layer[box] for layer in layers))

    def trimmed(self) -> "Ground":
        """Return the ground without unknown rows and columns at its edges."""
        rows, columns = np.nonzero(self.known)
        if not len(rows):
            return self
        low = self.origin + np.array([columns.min(), rows.min()]) * self.resolution
        high = self.origin + np.array([columns.max(), rows.max()]) * self.resolution
        half = self.resolution / 2
        return self.cropped(low - half, high + half)


class Mosaic:
    """Ground of a whole drive, each cell in its last state; memory is bounded by `MOST_CELLS`.

    Args:
        low, high: corners of a box around all maps [m].
        resolution: size of the maps' cells [m].
        most: largest number of cells.
    """

    def __init__(
        self, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"], resolution: float, *, most: int = MOST_CELLS
    ) -> None:
        cells = (high - low) / resolution
        self.step = max(1, int(np.ceil(np.sqrt(cells.prod() / most))))
        self._resolution = resolution
        self._first = np.floor(low / resolution / self.step).astype(int)
        nx, ny = np.ceil(high / resolution / self.step).astype(int) + 1 - self._first
        self._elevation = np.full((ny, nx), np.nan, np.float32)
        self._components = np.full((ny, nx, 3), np.nan, np.float16)
        self._obstacle = np.full((ny, nx), np.nan, np.float16)
        self._slope = np.full((ny, nx), np.nan, np.float16)
        self._known = np.zeros((ny, nx), np.int8)

    def add(self, layers: TerrainLayers) -> None:
        """Update the cells that a map knows; other cells stay."""
        low = np.floor(layers.origin / layers.resolution).astype(int)  # cell i covers [i, i + 1) cells
        skip = -low % self.step
        every = slice(skip[1], None, self.step), slice(skip[0], None, self.step)
        at = (low + skip) // self.step - self._first
        known = layers.known[every]
        rows, columns = np.nonzero(known)
        inside = (rows + at[1] >= 0) & (rows + at[1] < len(self._known))
        inside &= (columns + at[0] >= 0) & (columns + at[0] < self._known.shape[1])
        rows, columns = rows[inside], columns[inside]
        here = rows + at[1], columns + at[0]
        self._elevation[here] = layers.elevation[every][rows, columns]
        self._obstacle[here] = layers.obstacle_height[every][rows, columns]
        self._slope[here] = np.clip(layers.slope[every][rows, columns], 0, 100)
        given = min(3, layers.features.shape[2])
        self._components[here] = np.where(given, np.float16(0), np.float16(np.nan))
        self._components[here[0], here[1], :given] = layers.features[every][rows, columns, :given]
        observed = layers.observed[every][rows, columns]
        valid = layers.valid[every][rows, columns]
        self._known[here] = np.where(valid, FEATURED, np.where(observed, OBSERVED, FILLED))

    def ground(self) -> Ground:
        """Return the ground so far; shares memory with the mosaic."""
        size = self._resolution * self.step
        origin = self._first * size + self._resolution / 2
        return Ground(origin, size, self._elevation, self._components, self._obstacle, self._slope, self._known)


SUN = np.array([-0.5, 0.45, 0.74])
"""Direction towards the light, at the upper left as on maps."""

PAPER = 0.97
"""Brightness of unknown cells."""

RELIEF = ListedColormap(colormaps["gist_earth"](np.linspace(0.15, 0.9, 256)))
"""Colours of elevation, without blue and white."""

STEEP = 0.8
"""Slope drawn in the last colour, rise over run."""

TALL = 2.0
"""Height of obstacles drawn in the last colour [m]."""

KNOWN_COLOURS = ("#f7f7f7", "#b9c2cc", "#e0a458", "#2f7d4f")
KNOWN_NAMES = ("unknown", "filled", "hit by a LiDAR", "seen by a camera")

Limits = Float[np.ndarray, "2 3"]


def draw_map(ground: Ground, wheels: Float[np.ndarray, "N 4 2"], limits: Limits | None, *, title: str = "") -> Figure:
    """Draw elevation, features, obstacles and validity of the same ground.

    Args:
        wheels: positions of the wheels [m].
        limits: colours of the features (`feature_colours.colour_limits`); None without features.
    """
    tall = ground.known.shape[0] / max(ground.known.shape[1], 1)
    figure = Figure(figsize=(13, 1.4 + float(np.clip(9.4 * tall, 4, 20))), dpi=120, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    panels = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    relief = _relief(panels[0], ground)
    figure.colorbar(relief, ax=panels[0], shrink=0.7, label="elevation [m]")
    _show(panels[1], ground, feature_colours(ground, limits))
    panels[1].set_title("features, first three components" if limits is not None else "no features (give --pca)")
    _obstacles(figure, panels[2], ground)
    known = panels[3].imshow(
        ground.known, origin="lower", extent=_extent(ground), cmap=ListedColormap(KNOWN_COLOURS), vmin=-0.5, vmax=3.5
    )
    bar = figure.colorbar(known, ax=panels[3], shrink=0.7, ticks=range(4))
    bar.ax.set_yticklabels(KNOWN_NAMES, fontsize=8)
    panels[3].set_title(f"validity: {(ground.known == FEATURED).mean():.0%} of the box has features")
    for axes in panels:
        draw_wheels(axes, wheels)
        axes.title.set_fontsize(10)
        axes.set(xlim=_extent(ground)[:2], ylim=_extent(ground)[2:], xlabel="x [m]", ylabel="y [m]")
    return figure


def draw_wheels(axes: Axes, wheels: Float[np.ndarray, "N 4 2"]) -> None:
    """Draw the tracks of the four wheels."""
    for number in range(4):
        axes.plot(*wheels[:, number].T, color="white", linewidth=1.1, alpha=0.8)
        axes.plot(*wheels[:, number].T, color=INK, linewidth=0.5)


def hillshade(ground: Ground) -> Float[np.ndarray, "ny nx"]:
    """Return the brightness of lit ground [0..1], about 0.7 on level ground; NaN beside unknown cells."""
    if min(ground.elevation.shape) < 2:
        return np.full(ground.elevation.shape, np.nan)
    rise_y, rise_x = np.gradient(ground.elevation.astype(np.float64), ground.resolution)
    sun = SUN / np.linalg.norm(SUN)
    light = (sun[2] - rise_x * sun[0] - rise_y * sun[1]) / np.sqrt(1 + rise_x**2 + rise_y**2)
    return np.asarray(light.clip(0, 1))


def feature_colours(ground: Ground, limits: Limits | None) -> Float[np.ndarray, "ny nx 3"]:
    """Return the first three components as RGB [0..1]; ground without features is grey, unknown cells nearly white."""
    grey = np.where(ground.known > 0, np.nan_to_num(0.35 + 0.35 * hillshade(ground), nan=0.6), PAPER)
    picture = np.repeat(grey[..., None], 3, axis=2)
    if limits is not None:
        seen = ground.known == FEATURED
        picture = np.where(seen[..., None], colours(ground.components.astype(np.float32), limits) / 255, picture)
    return np.asarray(picture)


def _relief(axes: Axes, ground: Ground) -> ScalarMappable:
    """Draw elevation in shaded colours; return the colour scale."""
    known = ground.known > 0
    low, high = np.percentile(ground.elevation[known], (1, 99)) if known.any() else (0.0, 1.0)
    scale = ScalarMappable(Normalize(low, max(high, low + 0.5)), RELIEF)
    light = np.nan_to_num(0.3 + 0.9 * hillshade(ground), nan=0.9)[..., None]
    lit = (np.asarray(scale.to_rgba(np.nan_to_num(ground.elevation)))[..., :3] * light).clip(0, 1)
    _show(axes, ground, np.where(known[..., None], lit, PAPER))
    axes.set_title("elevation")
    return scale


def _obstacles(figure: Figure, axes: Axes, ground: Ground) -> None:
    """Draw slope, and obstacles on top of it."""
    _show(axes, ground, np.full((*ground.known.shape, 3), PAPER))
    slope = axes.imshow(ground.slope, origin="lower", extent=_extent(ground), cmap="Greys", vmin=0, vmax=STEEP)
    stands = np.where(ground.obstacle > 0.2, ground.obstacle, np.nan)
    height = axes.imshow(stands, origin="lower", extent=_extent(ground), cmap="YlOrRd", vmin=0, vmax=TALL)
    figure.colorbar(slope, ax=axes, shrink=0.7, pad=0.01, label="slope")
    figure.colorbar(height, ax=axes, shrink=0.7, pad=0.01, label="obstacle [m]")
    axes.set_title("obstacles above 0.2 m on slope (rise over run)")


def _show(axes: Axes, ground: Ground, picture: Float[np.ndarray, "ny nx 3"]) -> None:
    axes.imshow(picture, origin="lower", extent=_extent(ground), interpolation="nearest")


def _extent(ground: Ground) -> tuple[float, float, float, float]:
    half, (ny, nx) = ground.resolution / 2, ground.known.shape
    x, y = ground.origin
    return (x - half, x + nx * ground.resolution - half, y - half, y + ny * ground.resolution - half)
