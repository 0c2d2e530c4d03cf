"""Interactive charts of pages: what Plotly draws, and Plotly itself as a page holds it."""

import base64
import gzip
import html
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any, Final, Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

DASHES: Final = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
"""Plotly's line styles by Matplotlib's."""

INK, SOFT, LINE, SHADE = (f"var(--op-{name})" for name in ("ink", "soft", "line", "shade"))
"""Colours of look.css, which charts.js resolves, light or dark."""


@dataclass(frozen=True)
class Chart:
    """A chart that Plotly draws.

    Attributes:
        height: in pixels; the width is that of its place on the page.
        traces, layout: as in Plotly's reference; colours may be variables of look.css, "var(--op-ink)".
        title: text above the chart, where there are several.
    """

    height: int
    traces: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any] = field(default_factory=dict)
    title: str = ""


@runtime_checkable
class Drawing(Protocol):
    """What is drawn twice: as a picture, and as charts in a browser that runs scripts."""

    def figure(self) -> Figure:
        """The picture."""
        ...

    def charts(self) -> Sequence[Chart]:
        """The charts, side by side where there is room."""
        ...


def charts_json(charts: Sequence[Chart]) -> str:
    """Charts as JSON that can stand inside a script element; null for what is not finite."""
    text = msgspec.json.encode([asdict(chart) for chart in charts]).decode()
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def layout(*, x: Mapping[str, Any], y: Mapping[str, Any], **others: Any) -> dict[str, Any]:
    """Plotly's layout in the look of the page.

    Args:
        x, y: settings of the axes, beside those that all charts share.
        others: settings of the layout.
    """
    axis = {"gridcolor": LINE, "linecolor": LINE, "zeroline": False, "automargin": True}
    shared = {
        "font": {"size": 12.5, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 48, "r": 12, "t": 28, "b": 44},
        "hoverlabel": {"bgcolor": SHADE, "bordercolor": LINE, "font": {"color": INK, "size": 12.5}, "align": "left"},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": SOFT, "activecolor": INK},
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"},
    }
    return {**shared, "xaxis": {**axis, **x}, "yaxis": {**axis, **y}, **others}


def rounded(values: Float[np.ndarray, " n"] | Sequence[float], digits: int = 3) -> list[float]:
    """Numbers of a chart with as many decimals as can be seen."""
    return [round(float(value), digits) for value in values]


def escaped(text: str) -> str:
    """Text of a trace or layout, in which Plotly would take "<" for markup."""
    return html.escape(text, quote=False)


def translucent(colour: str, alpha: float) -> str:
    """A colour #rrggbb with an opacity [0..1]."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{alpha:g})"


@cache
def plotly_base64() -> str:
    """Plotly's script, which comes with its Python package, compressed: gzip in base64, 2 MB."""
    from plotly.offline import get_plotlyjs

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode("ascii")
