"""Map of a drive from above: elevation, features, obstacles and slope, validity, and the wheels' tracks."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int
from matplotlib import colormaps
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
        cells = np.argwhere(self.known)[:, ::-1]
        if not len(cells):
            return self
        low, high = (self.origin + at * self.resolution for at in (cells.min(axis=0) - 0.5, cells.max(axis=0) + 0.5))
        return self.cropped(low, high)


class Mosaic:
    """Ground of a whole drive, each cell in its last state; memory is bounded by `MOST_CELLS`.

    Args:
        low, high: corners of a box around all maps [m].
        resolution: size of the maps' cells [m].
        most: largest number of cells.

    Attributes:
        step: number of the maps' cells from one cell to the next.
        ground: so far.
    """

    def __init__(
        self, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"], resolution: float, *, most: int = MOST_CELLS
    ) -> None:
        self.step = max(1, int(np.ceil(np.sqrt(((high - low) / resolution).prod() / most))))
        size = resolution * self.step
        self._first = np.floor(low / size).astype(int)
        nx, ny = np.ceil(high / size).astype(int) + 1 - self._first
        self.ground = Ground(
            origin=self._first * size + resolution / 2,
            resolution=size,
            elevation=np.full((ny, nx), np.nan, np.float32),
            components=np.full((ny, nx, 3), np.nan, np.float16),
            obstacle=np.full((ny, nx), np.nan, np.float16),
            slope=np.full((ny, nx), np.nan, np.float16),
            known=np.zeros((ny, nx), np.int8),
        )

    def add(self, layers: TerrainLayers) -> None:
        """Update the cells that a map knows; other cells stay."""
        low = np.floor(layers.origin / layers.resolution).astype(int)  # cell i covers [i, i + 1) cells
        cells = np.argwhere(layers.known)
        at, rest = np.divmod(cells + low[::-1], self.step)
        at -= self._first[::-1]
        kept = ~rest.any(axis=1) & ((at >= 0) & (at < self.ground.known.shape)).all(axis=1)
        here, there = tuple(at[kept].T), tuple(cells[kept].T)
        self.ground.elevation[here] = layers.elevation[there]
        self.ground.obstacle[here] = layers.obstacle_height[there]
        self.ground.slope[here] = np.clip(layers.slope[there], 0, 100)
        given = layers.features[there][:, :3]
        missing = np.full((len(given), 3 - given.shape[1]), 0.0 if given.shape[1] else np.nan)
        self.ground.components[here] = np.concatenate((given, missing), axis=1)
        seen = np.where(layers.observed[there], OBSERVED, FILLED)
        self.ground.known[here] = np.where(layers.valid[there], FEATURED, seen)


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
    left, right, bottom, top = extent = _extent(ground)
    place: dict[str, Any] = {"origin": "lower", "extent": extent, "interpolation": "nearest"}
    scale, picture = _relief(ground)
    panels[0].imshow(picture, **place)
    panels[1].imshow(feature_colours(ground, limits), **place)
    slope = panels[2].imshow(ground.slope, cmap="Greys", vmin=0, vmax=STEEP, **place)
    stands = np.where(ground.obstacle > 0.2, ground.obstacle, np.nan)
    height = panels[2].imshow(stands, cmap="YlOrRd", vmin=0, vmax=TALL, **place)
    known = panels[3].imshow(ground.known, cmap=ListedColormap(KNOWN_COLOURS), vmin=-0.5, vmax=3.5, **place)
    for axes, image, label in (
        (panels[0], scale, "elevation [m]"),
        (panels[2], slope, "slope"),
        (panels[2], height, "obstacle [m]"),
    ):
        figure.colorbar(image, ax=axes, shrink=0.7, pad=0.01, label=label)
    bar = figure.colorbar(known, ax=panels[3], shrink=0.7, ticks=range(4))
    bar.ax.set_yticklabels(KNOWN_NAMES, fontsize=8)
    titles = (
        "elevation",
        "features, first three components" if limits is not None else "no features (give --pca)",
        "obstacles above 0.2 m on slope (rise over run)",
        f"validity: {(ground.known == FEATURED).mean():.0%} of the box has features",
    )
    for axes, text in zip(panels, titles, strict=True):
        for wheel in wheels.transpose(1, 2, 0):
            axes.plot(*wheel, color="white", linewidth=1.1, alpha=0.8)
            axes.plot(*wheel, color=INK, linewidth=0.5)
        axes.set_title(text, fontsize=10)
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x [m]", ylabel="y [m]")
    return figure


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


def _relief(ground: Ground) -> tuple[ScalarMappable, Float[np.ndarray, "ny nx 3"]]:
    """Return the colour scale of the elevation, and the elevation in shaded colours."""
    known = ground.known > 0
    low, high = np.percentile(ground.elevation[known], (1, 99)) if known.any() else (0.0, 1.0)
    scale = ScalarMappable(Normalize(low, max(high, low + 0.5)), RELIEF)
    light = np.nan_to_num(0.3 + 0.9 * hillshade(ground), nan=0.9)[..., None]
    lit = (np.asarray(scale.to_rgba(np.nan_to_num(ground.elevation)))[..., :3] * light).clip(0, 1)
    return scale, np.where(known[..., None], lit, PAPER)


def _extent(ground: Ground) -> tuple[float, float, float, float]:
    half, (ny, nx) = ground.resolution / 2, ground.known.shape
    x, y = ground.origin
    return (x - half, x + nx * ground.resolution - half, y - half, y + ny * ground.resolution - half)
