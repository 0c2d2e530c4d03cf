"""Top view of a drive along a course."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke

from offpiste.closed_loop.scores import Trace
from offpiste.planning.course import Course
from offpiste.report.figure import coloured_path
from offpiste.runtime.prediction import Prediction
from offpiste.simulation.top_view import draw_top_view
from offpiste.simulation.world.world import World

MARGIN = 15.0
"""Margin around course and driven path [m]."""
SLIP_LIMIT = 0.4
"""Slip at the upper end of the colour bar of the driven path."""


def course_picture(
    world: World, course: Course, trace: Trace, predictions: list[Prediction], title: str, *, scored: int
) -> Figure:
    """Draw the course, the driven path coloured by slip, and predicted trajectories.

    Args:
        scored: number of rows up to the end of the course or drive.
    """
    shown = np.concatenate((*(way[course.before_end] for way in course.ways), trace.place))
    (left, bottom), (right, top) = shown.min(axis=0) - MARGIN, shown.max(axis=0) + MARGIN
    wide = 6.6 * (right - left) / (top - bottom)
    figure = Figure(figsize=(min(max(wide, 3.5), 13.0) + 2.5, 8), dpi=130, layout="constrained")
    axes = figure.subplots()
    draw_top_view(world, axes)
    outlined = [Stroke(linewidth=3.0, foreground="#00000090"), Normal()]
    for number, way in enumerate(course.ways):
        label = None if number else "course"
        axes.plot(*way[course.before_end].T, color="white", linewidth=1.2, path_effects=outlined, label=label)
    for number, prediction in enumerate(predictions[::30]):
        label = "plans, 5 s" if not number else None
        axes.plot(*prediction.state[:, :2].T, color="#00d5ff", linewidth=1.0, label=label)
    if len(trace.place) - scored > 1:
        axes.plot(*trace.place[scored - 1 :].T, color="#909090", linewidth=1.6, label="after the end, not scored")
    pieces = coloured_path(axes, trace.place[:scored], trace.slip[:scored], width=2.4)
    pieces.set_clim(0.0, SLIP_LIMIT)
    figure.colorbar(pieces, ax=axes, shrink=0.7, extend="max", label="slip of the driven path")
    axes.plot(*trace.place[0], "o", color="white", markeredgecolor="black", zorder=5, label="start")
    axes.set(xlim=(left, right), ylim=(bottom, top))
    figure.legend(loc="outside lower center", ncols=5, fontsize=8, facecolor="#b8a88a")
    axes.set_title(title, fontsize=10, loc="left")
    return figure
