"""Process that shows a drive: the newest messages, at the viewer's pace."""

import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps

from offpiste.live.map_and_plan import ground_height
from offpiste.live.part import Part, unused_path
from offpiste.live.ring import from_fields, layers_from, plan_from
from offpiste.live.session import PARTS, Session
from offpiste.live.viewers import VIEWERS, Ground, Line, Viewer
from offpiste.logs.measurements import Image
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.course import Course
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.prediction import Prediction
from offpiste.visualization.map_figure import STEEP, TALL

PERIODS: Final = {
    "readings": 0.05, "plans": 0.1, "map": 1.0, "images": 0.2, "commands": 0.1, "course": 0.5, "states": 0.2,
}  # fmt: skip
"""Minimum time between updates from each ring, and of the processes' states [s]."""
LIFT: Final = 0.3
"""Height of lines above the ground [m]."""
_STEP: Final = 2
"""Step in cells of the shown map, in both directions."""
_EVERY: Final = 5
"""Step in states of the shown plan."""
_OBSTACLE: Final = 0.2
"""Height from which a cell is coloured as an obstacle [m]."""
_FASTEST: Final = 10.0
"""Speed at the upper end of the colours of a plan [m/s]."""


class Showing:
    """Pass new messages to a viewer."""

    def __init__(self, part: Part, viewer: Viewer) -> None:
        self._part, self._viewer = part, viewer
        self._readers = {name: part.reader(name, all_messages=True) for name in PERIODS if name != "states"}
        self._due = dict.fromkeys(PERIODS, 0.0)
        self._layers: TerrainLayers | None = None
        self._course: Course | None = None
        self._height: float | None = None
        self._said = ("", "")

    def update(self) -> None:
        """Show new messages, once the vehicle's position is known."""
        now = self._part.now()
        if not np.isfinite(now):
            return
        if (values := self._newest("readings")) is not None:
            reading = from_fields(VehicleReading, values)
            self._height = float(reading.position[2])
            self._viewer.pose(reading)
        if self._height is None:
            return
        mapped, course = self._newest("map"), self._newest("course")
        if mapped is not None:
            self._layers = layers_from(mapped)
            if self._layers is not None:
                self._viewer.ground(shown_ground(self._layers, mapped["scan_time"]))
        if course is not None:
            self._course = from_fields(Course, course)
        if self._course is not None and (mapped or course):
            self._viewer.line("course", now, self._line(self._course.driven, (255, 255, 255), 0.12))
        if (values := self._newest("plans")) is not None and "start" in values:
            self._show_plan(plan_from(values).prediction)
        if self._is_due("images"):
            images = (from_fields(Image, values) for values in self._readers["images"].new())
            for image in {image.camera: image for image in images}.values():
                self._viewer.image(image)
        if (values := self._newest("commands")) is not None:
            command = dict(zip(("throttle", "brake", "steer"), map(float, values["applied"]), strict=True))
            self._viewer.numbers(values["time"], "command", command)
        if self._is_due("states"):
            self._show_states(now)

    def _is_due(self, name: str) -> bool:
        due = time.monotonic() >= self._due[name]
        if due:
            self._due[name] = time.monotonic() + PERIODS[name]
        return due

    def _newest(self, name: str) -> dict[str, Any] | None:
        """Return the values of the newest message of a ring if it is new and due."""
        if time.monotonic() < self._due[name] or (values := self._readers[name].newest()) is None:
            return None
        self._due[name] = time.monotonic() + PERIODS[name]
        return values

    def _show_plan(self, prediction: Prediction) -> None:
        states = prediction.state[::_EVERY]
        speed = np.hypot(states[:, 3], states[:, 4])
        colours = (255 * colormaps["plasma"](np.clip(speed / _FASTEST, 0, 1))[:, :3]).astype(np.uint8)
        self._viewer.line("plan", prediction.time, self._line(states[:, :2], colours, 0.16))

    def _line(self, xy: Float[np.ndarray, "P 2"], colour: Any, width: float) -> Line:
        """Return a line above the ground; where that is unknown, above the vehicle's height."""
        height = np.full(len(xy), self._height or 0.0)
        if self._layers is not None:
            on_map = ground_height(self._layers, xy)
            height = np.where(np.isfinite(on_map), on_map, height)
        return Line(np.column_stack((xy, height + LIFT)), np.broadcast_to(np.uint8(colour), (len(xy), 3)), width)

    def _show_states(self, now: float) -> None:
        """Show latencies and speed reported by the processes, and changes of the mode."""
        states = {name: self._part.newest(f"status-{name}") for name in PARTS}
        numbers = {key: value for values in states.values() for key, value in values.items() if key.endswith("_ms")}
        self._viewer.numbers(now, "latencies", {key: value for key, value in numbers.items() if np.isfinite(value)})
        control = states["control"]
        if np.isfinite(control.get("speed_mps", np.nan)):
            self._viewer.numbers(now, "speed", {"speed": float(control["speed_mps"])})
        mode, _, why = str(control.get("state", "control has not started")).partition(": ")
        if (mode, why) != self._said:
            self._said = mode, why
            self._viewer.mode(now, mode, why)


def shown_ground(layers: TerrainLayers, moment: float) -> Ground:
    """Return the known cells of a map for a viewer, coloured by obstacle height, or by slope without an obstacle."""
    some = (slice(None, None, _STEP), slice(None, None, _STEP))
    known = layers.known[some]
    centres = layers.centres.reshape(*layers.known.shape, 2)[some][known]
    names = ("slope", "roughness", "obstacle_height")
    values = {name: np.asarray(getattr(layers, name)[some][known], np.float32) for name in names}
    slope, height = np.nan_to_num(values["slope"]), np.nan_to_num(values["obstacle_height"])
    shade = colormaps["viridis"](np.clip(slope / STEEP, 0, 1))
    stands = height > _OBSTACLE
    shade[stands] = colormaps["YlOrRd"](np.clip(height[stands] / TALL, 0, 1))
    places = np.column_stack((centres, layers.elevation[some][known]))
    return Ground(moment, places, values, (255 * shade[:, :3]).astype(np.uint8))


def view(session: Session) -> None:
    """Run the process."""
    part, settings = Part("view", session), session.settings
    rig, place = part.rig, settings.view_at
    if place:  # if it is a file, keep that of a killed process
        place = str(unused_path(Path(place)))
    viewer = VIEWERS[settings.view](place, rig.wheel_positions(), tuple(rig.cameras) if settings.cameras else ())
    showing = Showing(part, viewer)
    while not part.ending:
        began = time.monotonic()
        showing.update()
        took = time.monotonic() - began
        part.beat(f"shows it in {viewer.where}", view_ms=1e3 * took)
        time.sleep(max(PERIODS["readings"] - took, 0.01))
    viewer.close()
