"""A picture of each choice course: both ways from above, and the paths that all planners drove."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke

from experiments.closed_loop_table.drives import Place
from offpiste.closed_loop.courses import ChosenCourse, CourseSettings, choose_course, course_world
from offpiste.core.files import write_whole
from offpiste.simulation.top_view import draw_top_view
from offpiste.simulation.world.world import World

MARGIN = 12.0
"""Margin around the ways and the driven paths [m]."""
WIDE = 6.0
"""Width from which a picture's legend has two columns [inches]."""


def draw_choices(results: Sequence[dict[str, Any]], places: Sequence[Place], out: Path) -> None:
    """Write `<place>.png` into a folder for each course with a choice that was driven."""
    for place in places:
        drives = [r for r in results if r["firm_way"] is not None and _is_at(r, place)]
        if drives:
            world = course_world(*place)
            names = {f.name for f in CourseSettings.__dataclass_fields__.values()}
            settings = CourseSettings(**{k: v for k, v in drives[0]["course"].items() if k in names})
            figure = choice_picture(world, choose_course(world, place.world.seed, settings), drives)
            write_whole(out / f"{place.name}.png", partial(_save, figure))


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, format="png")


def _is_at(result: dict[str, Any], place: Place) -> bool:
    at = (result["world"], result["seed"], result["course"]["kind"])
    return at == (place.world.preset, place.world.seed, place.kind)


def choice_picture(world: World, chosen: ChosenCourse, drives: Sequence[dict[str, Any]]) -> Figure:
    """Both ways, and the paths of all drives, a colour for each row of the table."""
    paths = [np.array(drive["driven_xy"]) for drive in drives]
    ways = [way[chosen.course.before_end] for way in chosen.course.ways]
    shown = np.concatenate((*ways, *paths))
    (left, bottom), (right, top) = shown.min(axis=0) - MARGIN, shown.max(axis=0) + MARGIN
    figure = Figure(figsize=(min(max(7 * (right - left) / (top - bottom), 4), 13), 8), dpi=110, layout="constrained")
    axes = figure.subplots()
    draw_top_view(world, axes)
    for number, way in enumerate(ways):
        style = "solid" if number == chosen.firm else "dotted"
        label = "firm way" if number == chosen.firm else "muddy way"
        outlined = [Stroke(linewidth=3.0, foreground="#00000080"), Normal()]
        axes.plot(*way.T, color="white", linewidth=1.2, linestyle=style, path_effects=outlined, label=label)
    rows = list(dict.fromkeys(drive["row"] for drive in drives))
    for drive, path in zip(drives, paths, strict=True):
        ending = {True: "firm", False: "mud", None: "not there"}[drive["firm_way"]]
        label = f"{drive['row']}: {ending}, " + (f"{drive['time_s']:.1f} s" if drive["finished"] else "not finished")
        colour = colormaps["tab10"](rows.index(drive["row"]) % 10)
        axes.plot(*path.T, color=colour, linewidth=2.0, label=label)
        if not drive["finished"]:
            axes.plot(*path[-1], color=colour, marker="X", markersize=9, markeredgecolor="black")
    axes.plot(*paths[0][0], color="white", marker="o", markeredgecolor="black")
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x [m]", ylabel="y [m]")
    axes.set_title(f"{world.settings.name}, seed {world.settings.seed}", fontsize=10, loc="left")
    columns = 2 if figure.get_figwidth() > WIDE else 1
    figure.legend(loc="outside lower center", ncols=columns, fontsize=8, facecolor="#b8a88a")
    return figure
