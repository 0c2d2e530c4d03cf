"""Interactive charts of pages: traces and layout for Plotly, and Plotly's script."""

import base64
import gzip
import html
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.report.chart import MEAN, Box, Chart, Line, Panel, Raster
from offpiste.report.text_table import number

DASHES: Final = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
"""Plotly's line styles by Matplotlib's."""
INK, SOFT, LINE, SHADE = (f"var(--op-{name})" for name in ("ink", "soft", "line", "shade"))
"""Colours of look.css, which charts.js resolves for light and dark pages."""
BLACK: Final = "#000000"
"""Colour replaced by the page's ink."""
MOST_POINTS, MOST_POINTS_SMALL = 200, 26
"""Largest number of points of a line in a single chart and in one of several."""
LINE_PIXELS: Final = 54
"""Height of a box with the space around it."""
QUALITY: Final = 70
"""WebP quality of images, 1 to 100."""

Traces = list[dict[str, Any]]


def charts_of(chart: Chart) -> Traces:
    """Return title, height [px] and Plotly's traces and layout for each panel."""
    small = len(chart.panels) > 1
    return [_chart(panel, small) for panel in chart.panels]


def charts_json(chart: Chart) -> str:
    """Return charts as JSON that is safe inside a script element; null for values that are not finite."""
    text = msgspec.json.encode(charts_of(chart)).decode()
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@cache
def plotly_base64() -> str:
    """Return the script of Plotly's Python package as gzip in base64, 2 MB."""
    from plotly.offline import get_plotlyjs

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode("ascii")


def _chart(panel: Panel, small: bool) -> dict[str, Any]:
    axis = {"gridcolor": LINE, "linecolor": LINE, "zeroline": False, "automargin": True}
    x: dict[str, Any] = {**axis, "title": {"text": _text(panel.x_axis)}}
    y: dict[str, Any] = {**axis, "title": {"text": _text(panel.y_axis)}, "range": panel.y_range or (0.0, _top(panel))}
    if panel.x_range is not None:
        x["range"] = panel.x_range
    if panel.x_ticks:
        x |= _named_ticks(panel.x_ticks)
    if panel.equal:
        x["constrain"] = y["constrain"] = "domain"
        y["scaleanchor"] = "x"
    traces = [trace for line in panel.lines for trace in _line_traces(line, panel, small)]
    first: dict[str, Any] = {trace["name"]: trace for trace in reversed(traces) if trace.get("showlegend", True)}
    for trace in traces:
        if trace.get("showlegend", True) and trace is not first[trace["name"]]:
            trace["showlegend"] = False  # runs of a model share a label
    if panel.boxes:
        traces += _box_traces(panel.boxes)
        y |= {"showgrid": False, **_named_ticks([box.label for box in panel.boxes])}
    layout = {
        "font": {"size": 12.5, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hoverlabel": {"bgcolor": SHADE, "bordercolor": LINE, "font": {"color": INK, "size": 12.5}, "align": "left"},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": SOFT, "activecolor": INK},
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"},
        "xaxis": x,
        "yaxis": y,
        "hovermode": panel.hover,
        "showlegend": not small and not panel.boxes,
        "boxgap": 0.45,
        "images": [] if panel.raster is None else [_image(panel.raster)],
        "margin": {"l": 36, "r": 6, "t": 6, "b": 36} if small else {"l": 48, "r": 12, "t": 48, "b": 44},
    }
    height = 330 if small else 106 + LINE_PIXELS * len(panel.boxes) if panel.boxes else 430
    return {"title": panel.title, "height": height, "traces": traces, "layout": layout}


def _named_ticks(names: Sequence[str]) -> dict[str, Any]:
    return {"tickvals": [*range(len(names))], "ticktext": [_text(name) for name in names]}


def _text(text: str) -> str:
    """Escape text, in which Plotly takes "<" for markup."""
    return html.escape(text, quote=False).replace("\n", "<br>")


def _rounded(values: Float[np.ndarray, " n"]) -> list[float]:
    return [round(float(value), 3) for value in values]


def _translucent(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


def _top(panel: Panel) -> float:
    """Return the upper end of the vertical axis, a little above all lines."""
    values = [part[np.isfinite(part)] for line in panel.lines for part in (line.y, line.high) if part is not None]
    return 1.05 * (max((float(part.max()) for part in values if len(part)), default=1.0) or 1.0)


def _line_traces(line: Line, panel: Panel, small: bool) -> Traces:
    most = MOST_POINTS_SMALL if small else MOST_POINTS
    thin = np.unique(np.linspace(0, len(line.x) - 1, min(most, len(line.x))).astype(int))
    colour = INK if line.colour == BLACK else line.colour
    name = {"name": _text(line.label), "legendgroup": _text(line.label)} if line.label else {"showlegend": False}
    trace: dict[str, Any] = {
        "mode": "lines+markers" if line.marker else "lines",
        "x": _rounded(line.x[thin]),
        "y": _rounded(line.y[thin]),
        "line": {"color": colour, "dash": DASHES[line.style], "width": 1.4 * line.width},
        "marker": {
            "color": colour,
            "symbol": "triangle-up" if line.marker == "^" else "circle",
            "size": [0] * (len(thin) - 1) + [9] if line.marked == "last" else 7,
        },
        "opacity": line.opacity,
        "hoverinfo": "text" if line.label else "skip",
        **name,
    }
    if line.hover:
        trace["hovertext"] = [_text(line.hover[place]) for place in thin]
    elif line.label:
        trace["hovertemplate"] = "%{x:.2f}" if panel.hover == "y unified" else "%{y:.2f}"
    if line.low is None or line.high is None:
        return [trace]
    known = np.isfinite(line.low) & np.isfinite(line.high)
    band = {
        "mode": "lines",
        "x": _rounded(np.concatenate((line.x[known], line.x[known][::-1]))),
        "y": _rounded(np.concatenate((line.high[known], line.low[known][::-1]))),
        "fill": "toself",
        "fillcolor": _translucent(line.colour, 0.15),
        "line": {"width": 0},
        "hoverinfo": "skip",
        **name,
        "showlegend": False,
    }
    return [band, trace]


def _image(raster: Raster) -> dict[str, Any]:
    left, right, bottom, top = raster.extent
    done, data = cv2.imencode(".webp", raster.rgba[..., [2, 1, 0, 3]], [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    assert done, "OpenCV encodes every image"
    source = "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode("ascii")
    place = {"xref": "x", "yref": "y", "x": left, "y": top, "sizex": right - left, "sizey": top - bottom}
    return {"source": source, **place, "sizing": "stretch", "layer": "below", "opacity": raster.opacity}


def _box_traces(boxes: Sequence[Box]) -> Traces:
    """Return boxes, and markers at their means (else medians) whose text has all numbers."""
    drawn = {place: box for place, box in enumerate(boxes) if np.isfinite(box.numbers["whishi"])}
    traces: Traces = [
        {
            "type": "box",
            "orientation": "h",
            "y": [place],
            **{name: [round(box.numbers[key], 3)] for name, key in _BOX_NUMBERS.items()},
            "fillcolor": _translucent(box.colour, 0.45),
            "line": {"color": INK, "width": 1.3},
            "hoverinfo": "skip",
        }
        for place, box in drawn.items()
    ]
    all_numbers = [{name: number(value) for name, value in box.numbers.items()} for box in drawn.values()]
    means: dict[str, Any] = {
        "mode": "markers",
        "x": [round(box.numbers["mean" if np.isfinite(box.numbers["mean"]) else "med"], 3) for box in drawn.values()],
        "y": [*drawn],
        "marker": {"color": MEAN, "symbol": "diamond", "size": 9},
        "hoverinfo": "text",
        "hovertext": [_BOX_TEXT.format(**numbers) for numbers in all_numbers],
    }
    return [*traces, means]


_BOX_NUMBERS: Final = {"q1": "q1", "median": "med", "q3": "q3", "lowerfence": "whislo", "upperfence": "whishi"}
_BOX_TEXT: Final = "median {med}, mean {mean}<br>quartiles {q1} and {q3}<br>whiskers {whislo} and {whishi}"
