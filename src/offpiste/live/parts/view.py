"""Shows the drive: what is newest in the rings, at the viewer's pace; what it is too slow for is left out."""

import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps

from offpiste.closed_loop.recording import LIFT
from offpiste.live.packing import course_from, image_from, layers_from, plan_from, reading_from, unpacked
from offpiste.live.part import Part, free_file
from offpiste.live.plan_regions import PlanRegions
from offpiste.live.reports import ground_height
from offpiste.live.session import PARTS, Session
from offpiste.live.viewers.viewer import VIEWERS, ShownGround, ShownPlan, Viewer
from offpiste.logs.measurements import Image
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.course import Course
from offpiste.rig.rig import load_rig
from offpiste.visualization.map_figure import STEEP, TALL

PERIODS: Final = {"readings": 0.05, "plans": 0.1, "map": 1.0, "images": 0.2, "commands": 0.1, "course": 0.5}
"""Each is shown no more often [s]."""
_NUMBERS: Final = 0.2
"""Time between numbers that are plotted [s]."""
_STEP: Final = 2
"""One cell of the map is shown of so many, in both directions."""
_EVERY: Final = 5
"""One place of a plan is shown of so many."""
_OBSTACLE: Final = 0.2
"""Height from which a cell has the colour of an obstacle [m]."""


class Showing:
    """Gives a viewer what is new.

    Args:
        regions: of the run; None where it has no spread.
    """

    def __init__(self, part: Part, viewer: Viewer, regions: PlanRegions | None = None) -> None:
        self._part, self._viewer, self._regions = part, viewer, regions
        self._seen, self._due = dict.fromkeys(PERIODS, 0), dict[str, float]()
        self._layers: TerrainLayers | None = None
        self._course: Course | None = None
        self._height: float | None = None
        self._said = ("", "")

    def update(self) -> None:
        """Show what is new, once the vehicle's place is known."""
        now = self._part.now()
        if not np.isfinite(now):
            return
        if (values := self._newest("readings")) is not None:
            reading = reading_from(values)
            self._height = float(reading.position[2])
            self._viewer.pose(reading)
        if self._height is None:
            return
        if (values := self._newest("map")) is not None:
            self._layers = layers_from(values)
            if self._layers is not None:
                self._viewer.ground(shown_ground(self._layers, values["scan_time"]))
            self._show_course(now)
        if (values := self._newest("course")) is not None:
            self._course = course_from(values)
            self._show_course(now)
        if (values := self._newest("plans")) is not None and "start" in values:
            self._viewer.plan(self._plan(values))
        self._show_images()
        if (values := self._newest("commands")) is not None:
            throttle, brake, steer = (float(value) for value in values["applied"])
            self._viewer.numbers(values["time"], "command", {"throttle": throttle, "brake": brake, "steer": steer})
        self._show_states(now)

    def _newest(self, name: str) -> dict[str, Any] | None:
        """The newest message of a ring, if it is another one and time for it."""
        ring, now = self._part.ring(name), time.monotonic()
        if ring.written == self._seen[name] or now < self._due.get(name, 0.0):
            return None
        entry = ring.newest()
        if entry is None:
            return None
        self._seen[name], self._due[name] = entry.number, now + PERIODS[name]
        return unpacked(entry.data)

    def _show_images(self) -> None:
        """Show the newest image of each camera."""
        ring, now, newest = self._part.ring("images"), time.monotonic(), dict[str, Image]()
        if ring.written == self._seen["images"] or now < self._due.get("images", 0.0):
            return
        for entry in ring.since(self._seen["images"]):
            self._seen["images"], image = entry.number, image_from(unpacked(entry.data))
            newest[image.camera] = image
        self._due["images"] = now + PERIODS["images"]
        for image in newest.values():
            self._viewer.image(image)

    def _show_course(self, now: float) -> None:
        if self._course is not None:
            self._viewer.course(now, self._lifted(self._course.driven))

    def _plan(self, values: dict[str, Any]) -> ShownPlan:
        plan, prediction = plan_from(values)
        regions: tuple[np.ndarray, ...] = ()
        if self._regions is not None and self._layers is not None:
            regions = self._regions.outlines(self._layers, plan, prediction)
        states = prediction.state[::_EVERY]
        lifted = tuple(self._lifted(outline) for outline in regions)
        return ShownPlan(plan.start, self._lifted(states[:, :2]), np.hypot(states[:, 3], states[:, 4]), lifted)

    def _lifted(self, xy: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "P 3"]:
        """Places a little above the ground; at the vehicle's height where the map does not know it."""
        height = np.full(len(xy), self._height or 0.0)
        if self._layers is not None:
            on_map = ground_height(self._layers, xy)
            height = np.where(np.isfinite(on_map), on_map, height)
        return np.column_stack((xy, height + LIFT))

    def _show_states(self, now: float) -> None:
        """Show latencies and speed as the processes report them, and the mode when it has changed."""
        if time.monotonic() < self._due.get("states", 0.0):
            return
        self._due["states"] = time.monotonic() + _NUMBERS
        states = {name: _unpacked(self._part.ring(f"status-{name}").newest()) for name in PARTS}
        numbers = {key: value for values in states.values() for key, value in values.items() if key.endswith("_ms")}
        self._viewer.numbers(now, "latencies", {key: value for key, value in numbers.items() if np.isfinite(value)})
        control = states["control"]
        if np.isfinite(control.get("speed_mps", np.nan)):
            self._viewer.numbers(now, "speed", {"speed": float(control["speed_mps"])})
        mode, _, why = str(control.get("state", "control has not started")).partition(": ")
        if (mode, why) != self._said:
            self._said = mode, why
            self._viewer.mode(now, mode, why)


def _unpacked(entry: Any) -> dict[str, Any]:
    return {} if entry is None else unpacked(entry.data)


def shown_ground(layers: TerrainLayers, moment: float) -> ShownGround:
    """Known cells of a map as they are drawn."""
    some = (slice(None, None, _STEP), slice(None, None, _STEP))
    known = layers.known[some]
    ny, nx = layers.known.shape
    centres = layers.centres.reshape(ny, nx, 2)[some][known]
    names = ("slope", "roughness", "obstacle_height")
    values = {name: np.asarray(getattr(layers, name)[some][known], np.float32) for name in names}
    slope, height = np.nan_to_num(values["slope"]), np.nan_to_num(values["obstacle_height"])
    shade = colormaps["viridis"](np.clip(slope / STEEP, 0, 1))
    stands = height > _OBSTACLE
    shade[stands] = colormaps["YlOrRd"](np.clip(height[stands] / TALL, 0, 1))
    places = np.column_stack((centres, layers.elevation[some][known]))
    return ShownGround(moment, places, values, (255 * shade[:, :3]).astype(np.uint8))


def view(session: Session, *, cameras: bool) -> None:
    """The process that shows."""
    part, settings = Part("view", session), session.settings
    assert settings.view is not None
    rig, planner = load_rig(settings.rig), settings.load_planner()
    names = tuple(rig.cameras) if cameras else ()
    place = settings.view.place
    if place:  # where it is a file, a process that is started again must not find it
        place = str(free_file(Path(place)))
    viewer = VIEWERS[settings.view.name](place, rig.wheel_positions(), names)
    regions = None
    if planner.spread is not None:
        regions = PlanRegions(planner.dynamics, planner.spread, rig.wheel_positions())
    showing = Showing(part, viewer, regions)
    while not part.ending:
        began = time.monotonic()
        showing.update()
        took = time.monotonic() - began
        part.beat(f"shows it in {viewer.where}", view_ms=1e3 * took)
        time.sleep(max(PERIODS["readings"] - took, 0.01))
    viewer.close()
