"""Rerun recording of a driven course."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps

from offpiste.closed_loop.drive_course import Driven
from offpiste.closed_loop.lockstep import time_of
from offpiste.closed_loop.pictures import SLIP_LIMIT
from offpiste.core.conventions import DT
from offpiste.core.errors import extra
from offpiste.core.files import write_whole
from offpiste.core.geometry import rotation_from_quaternion
from offpiste.report.figure import PATH_COLOURS
from offpiste.runtime.modes import Mode
from offpiste.simulation.top_view import shaded_colours
from offpiste.simulation.world.grids import read_grid
from offpiste.visualization.rerun_recording import following_eye, grid_triangles

LIFT = 0.3
"""Height of lines above the ground [m]."""
EVERY = 5
"""Rows between drawn poses of the vehicle."""
STEP = 4
"""Step in nodes of the drawn grid."""
TIMELINE: Final = "drive"
"""Name of the timeline, in seconds since the start."""
PLOTS: Final = {
    "speed": "speed [m/s]",
    "slip": "slip",
    "path": "off the course [m]",
    "controls": "controls",
    "mode": "mode: 3 driving, 2 degraded, 1 stopping, 0 stopped",
}
"""Titles of the plots by entity."""
GREY, ORANGE, GREEN, RED, BLUE = [160, 160, 160], [230, 80, 30], [60, 170, 80], [215, 50, 60], [0, 160, 230]
"""Colours of lines in plots."""
LEVEL: dict[Mode, int] = {"stopped": 0, "stopping": 1, "degraded": 2, "driving": 3}
"""Mode as a number to plot."""


def record_drive(driven: Driven, path: Path) -> None:
    """Write a drive as a Rerun recording (needs the extra `view`)."""
    write_whole(path, lambda partial: _write(driven, partial))


def _write(driven: Driven, path: Path) -> None:
    with extra("view"):
        import rerun as rr

    stream = rr.RecordingStream("offpiste drive")
    start = driven.driving.samples[0].position
    stream.save(path, default_blueprint=_blueprint(start))
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _add_ground(stream, rr, driven)
    _add_paths(stream, rr, driven)
    _add_plans(stream, rr, driven)
    _add_vehicle(stream, rr, driven)
    _add_numbers(stream, rr, driven)
    for event in driven.runtime.events:
        stream.set_time(TIMELINE, duration=event.time - time_of(0.0))
        stream.log("events", rr.TextLog(f"{event.mode}: {event.why}" if event.why else event.mode))
    stream.flush()
    stream.disconnect()


def _blueprint(start: Float[np.ndarray, " 3"]) -> Any:
    """Return the viewer layout: world, plots and changes of mode."""
    import rerun.blueprint as rrb

    world = rrb.Spatial3DView(
        origin="/world", name="world", eye_controls=following_eye("/world/vehicle", start), line_grid=False
    )
    plots = [
        rrb.TimeSeriesView(origin=f"/{origin}", name=name, plot_legend=rrb.Corner2D.RightTop)
        for origin, name in PLOTS.items()
    ]
    events = rrb.TextLogView(origin="/events", name="changes of mode")
    beside = rrb.Vertical(*plots, events, row_shares=[*(2 for _ in plots), 3])
    whole = rrb.Horizontal(world, beside, column_shares=[2, 1])
    return rrb.Blueprint(whole, rrb.TimePanel(timeline=TIMELINE, state="collapsed"), collapse_panels=True)


def _add_paths(stream: Any, rr: Any, driven: Driven) -> None:
    """Add the course, and the driven path coloured by slip."""
    course = driven.chosen.course
    ways = [_lifted(driven, way[course.before_end]) for way in course.ways]
    stream.log("world/course", rr.LineStrips3D(ways, radii=0.06, colors=[255, 255, 255]), static=True)
    trace = driven.trace
    places, slip = _lifted(driven, trace.place[::EVERY]), trace.slip[::EVERY][:-1]
    shade = (255 * colormaps[PATH_COLOURS](slip / SLIP_LIMIT)[:, :3]).astype(np.uint8)
    pieces = np.stack((places[:-1], places[1:]), axis=1)
    stream.log("world/driven", rr.LineStrips3D(pieces, radii=0.08, colors=shade), static=True)


def _add_plans(stream: Any, rr: Any, driven: Driven) -> None:
    for prediction in driven.runtime.predictions:
        if len(prediction.state):
            stream.set_time(TIMELINE, duration=prediction.time - time_of(0.0))
            strip = _lifted(driven, prediction.state[::10, :2])
            stream.log("world/plan", rr.LineStrips3D([strip], radii=0.08, colors=[0, 213, 255]))


def _add_vehicle(stream: Any, rr: Any, driven: Driven) -> None:
    stream.log("world/vehicle/body", rr.Boxes3D(half_sizes=[1.4, 0.75, 0.5], colors=[230, 80, 30]), static=True)
    for row, sample in enumerate(driven.driving.samples[::EVERY]):
        stream.set_time(TIMELINE, duration=row * EVERY * DT)
        turn = rotation_from_quaternion(sample.orientation[None])[0]
        stream.log("world/vehicle", rr.Transform3D(translation=sample.position, mat3x3=turn))


def _add_numbers(stream: Any, rr: Any, driven: Driven) -> None:
    """Add plots of motion and commands."""
    trace, controls = driven.trace, driven.driving.controls[: len(driven.driving.samples)]
    command = np.array([given.command for given in controls])
    numbers = {
        "speed/wanted": (trace.target, GREY),
        "speed/driven": (trace.speed, ORANGE),
        "slip/slip": (trace.slip, ORANGE),
        "path/error": (trace.off, ORANGE),
        "controls/throttle": (command[:, 0], GREEN),
        "controls/brake": (command[:, 1], RED),
        "controls/steer": (command[:, 2], BLUE),
        "mode/mode": (np.array([LEVEL[given.mode] for given in controls]), BLUE),
    }
    rows = np.arange(0, len(controls), EVERY)
    for name, (values, colour) in numbers.items():
        stream.send_columns(
            name,
            indexes=[rr.TimeColumn(TIMELINE, duration=rows * DT)],
            columns=rr.Scalars.columns(scalars=values[rows].astype(float)),
        )
        stream.log(name, rr.SeriesLines(names=name.split("/")[1], colors=colour, widths=2.0), static=True)


def _lifted(driven: Driven, places: np.ndarray) -> np.ndarray:
    world = driven.world
    height = read_grid(world.elevation, world.origin, world.resolution, places)
    return np.column_stack((places, height + LIFT)).astype(np.float32)


def _add_ground(stream: Any, rr: Any, driven: Driven) -> None:
    world = driven.world
    elevation = world.elevation[::STEP, ::STEP]
    colours = (255 * shaded_colours(world)[::STEP, ::STEP]).astype(np.uint8).reshape(-1, 3)
    ny, nx = elevation.shape
    x, y = (origin + STEP * world.resolution * np.arange(n) for origin, n in zip(world.origin, (nx, ny), strict=True))
    vertices = np.stack((*np.meshgrid(x, y), elevation), axis=-1).reshape(-1, 3).astype(np.float32)
    triangles = grid_triangles(np.ones((ny, nx), bool))
    stream.log(
        "world/ground",
        rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, vertex_colors=colours),
        static=True,
    )
