"""Style and files of figures."""

import io
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from offpiste.core.files import write_bytes

INK, SOFT, GRID = "#1b1f24", "#8a939c", "#dddddd"
BLUE, ORANGE, GREEN, PURPLE = "#0072b2", "#d95f02", "#1a7f37", "#7b3fa0"


def png(figure: Figure) -> bytes:
    """Return a figure as the content of a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", facecolor="white", dpi="figure")
    return stream.getvalue()


def write_png(path: Path, figure: Figure) -> None:
    """Write a figure as a PNG file, whole or not at all."""
    write_bytes(path, png(figure))


def plain(axes: Axes, title: str = "", *, grid: Literal["both", "x", "y"] = "both") -> Axes:
    """Style axes: no upper and right frame, a light grid, a title at the left."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis=grid, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_title(title, loc="left", fontsize=10)
    return axes


def coloured_path(
    axes: Axes, path: Float[np.ndarray, "n 2"], value: Float[np.ndarray, " n"], *, width: float = 1.8
) -> LineCollection:
    """Draw a path coloured by a value at its points, with gaps at unknown positions."""
    pieces = LineCollection(list(np.stack((path[:-1], path[1:]), axis=1)), cmap="plasma", linewidths=width, zorder=3)
    pieces.set_array((value[:-1] + value[1:]) / 2)
    axes.add_collection(pieces)
    return pieces
