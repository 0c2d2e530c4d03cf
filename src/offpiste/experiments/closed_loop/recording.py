"""A driven course as a Rerun recording: world, course, plans and vehicle, by time, with speed, slip and mode."""

from pathlib import Path
from typing import Any

import numpy as np

from offpiste.conventions import DT
from offpiste.experiments.closed_loop.drive_course import Driven
from offpiste.experiments.closed_loop.lockstep import time_of
from offpiste.files import write_whole
from offpiste.geometry import rotation_from_quaternion
from offpiste.planning.modes import Mode
from offpiste.simulation.surface import read_grid
from offpiste.simulation.top_view import shaded_colours
from offpiste.viewing.mesh import grid_triangles
from offpiste.viewing.recording import MissingRerun, rerun_is_there

LIFT = 0.3
"""Lines are drawn so far above the ground [m]."""

EVERY = 5
"""Rows between two poses of the vehicle."""

STEP = 4
"""Nodes of the world between two of the drawn ones."""

LEVEL: dict[Mode, int] = {"stopped": 0, "stopping": 1, "degraded": 2, "driving": 3}
"""Of the mode, as a number to plot."""


def require_rerun() -> None:
    """Complain before minutes are spent.

    Raises:
        MissingRerun: the extra `view` is not installed.
    """
    if not rerun_is_there():
        raise MissingRerun(
            "recordings need the package rerun-sdk", how="pip install 'offpiste[view]', or go without --recording"
        )


def record_drive(driven: Driven, path: Path) -> None:
    """Write a recording, whole or not at all.

    Raises:
        MissingRerun: the extra `view` is not installed.
    """
    require_rerun()
    write_whole(path, lambda partial: _write(driven, partial))


def _write(driven: Driven, path: Path) -> None:
    import rerun as rr

    stream = rr.RecordingStream("offpiste drive")
    stream.save(path)
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _add_ground(stream, rr, driven)
    stream.log(
        "world/course",
        rr.LineStrips3D([_lifted(driven, driven.laid.course.driven)], radii=0.06, colors=[255, 255, 255]),
        static=True,
    )
    for prediction in driven.runtime.predictions:
        if len(prediction.state):
            stream.set_time("drive", duration=prediction.time - time_of(0.0))
            strip = _lifted(driven, prediction.state[::10, :2])
            stream.log("world/plan", rr.LineStrips3D([strip], radii=0.08, colors=[0, 213, 255]))
    for row in range(0, len(driven.driving.samples), EVERY):
        sample, controls, trace = driven.driving.samples[row], driven.driving.controls[row], driven.trace
        stream.set_time("drive", duration=row * DT)
        turn = rotation_from_quaternion(sample.orientation[None])[0]
        stream.log("world/vehicle", rr.Transform3D(translation=sample.position, mat3x3=turn))
        numbers = {
            "speed [m/s]/driven": trace.speed[row],
            "speed [m/s]/wanted": trace.target[row],
            "slip": trace.slip[row],
            "path error [m]": trace.off[row],
            "command/throttle": controls.command[0],
            "command/brake": controls.command[1],
            "command/steer": controls.command[2],
            "mode": LEVEL[controls.mode],
        }
        for name, value in numbers.items():
            stream.log(name, rr.Scalars(float(value)))
    stream.log("world/vehicle/body", rr.Boxes3D(half_sizes=[1.4, 0.75, 0.5], colors=[230, 80, 30]), static=True)
    for event in driven.runtime.events:
        stream.set_time("drive", duration=event.time - time_of(0.0))
        stream.log("events", rr.TextLog(f"{event.mode}: {event.why}" if event.why else event.mode))
    stream.flush()
    stream.disconnect()


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
