"""What all pictures of this package share."""

import io

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap
from matplotlib.figure import Figure

INK, SOFT, GRID = "#1b1f24", "#8a939c", "#dddddd"
BLUE, ORANGE, GREEN, PURPLE = "#0072b2", "#d95f02", "#1a7f37", "#7b3fa0"


def png(figure: Figure) -> bytes:
    """A figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def plain(axes: Axes, title: str = "") -> Axes:
    """Without the upper and the right frame, with a light grid behind."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_title(title, loc="left", fontsize=10)
    return axes


def coloured_path(
    axes: Axes, path: Float[np.ndarray, "N 2"], value: Float[np.ndarray, " N"], cmap: str | Colormap, **kwargs: float
) -> LineCollection:
    """A path whose colour follows a value; broken where places are unknown."""
    pieces = LineCollection(list(np.stack((path[:-1], path[1:]), axis=1)), cmap=cmap, linewidths=1.8)
    pieces.set_array(value[:-1])
    if kwargs:
        pieces.set_clim(kwargs["low"], kwargs["high"])
    axes.add_collection(pieces)
    return pieces
