"""Process that shows a drive: the newest messages, at the viewer's pace."""

import time
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Float
from matplotlib import colormaps

from offpiste.closed_loop.recording import LIFT
from offpiste.core.state import Terrain
from offpiste.dynamics.base import Dynamics
from offpiste.live.map_and_plan import ground_height
from offpiste.live.part import Part, unused_path
from offpiste.live.ring import from_fields, layers_from, plan_from, unpacked
from offpiste.live.session import PARTS, Session
from offpiste.live.viewers import VIEWERS, ShownGround, ShownPlan, Viewer
from offpiste.logs.measurements import Image
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.controls import complete
from offpiste.planning.course import Course
from offpiste.rig.rig import load_rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction, coded_area
from offpiste.uncertainty.spread import EVERY, INTERVAL, Spread, radius, spread_inputs
from offpiste.visualization.map_figure import STEEP, TALL

PERIODS: Final = {"readings": 0.05, "plans": 0.1, "map": 1.0, "images": 0.2, "commands": 0.1, "course": 0.5}
"""Minimum time between updates of each kind [s]."""
_NUMBERS: Final = 0.2
"""Time between plotted numbers [s]."""
_STEP: Final = 2
"""Step in cells of the shown map, in both directions."""
_EVERY: Final = 5
"""Step in states of the shown plan."""
_OBSTACLE: Final = 0.2
"""Height from which a cell is coloured as an obstacle [m]."""
WITHIN: Final = 0.8
"""Probability that the vehicle is within a region."""
_POINTS: Final = 24
"""Number of points of a region's outline."""


class PlanRegions:
    """Uncertainty regions of plans: ellipses along the predicted heading, one per second.

    Args:
        spread: of the model's predictions (`offpiste calibrate`).
        wheels: positions in the body frame [m].
    """

    def __init__(self, dynamics: Dynamics, spread: Spread, wheels: Float[np.ndarray, "4 2"]) -> None:
        self._dynamics, self._spread = dynamics.eval().requires_grad_(False), spread
        self._wheels = torch.as_tensor(wheels, dtype=torch.float32)

    @torch.no_grad()
    def outlines(
        self, layers: TerrainLayers, plan: TimedPlan, prediction: Prediction
    ) -> tuple[Float[np.ndarray, "_ 2"], ...]:
        """Return closed lines x, y [m].

        Args:
            layers: of the map, with the model's codes as features.
        """
        offset = prediction.state[0, :2].copy()
        # The state before the first step is not available; the state after it replaces it.
        states = np.concatenate((prediction.state[:1], prediction.state[EVERY - 1 : -1 : EVERY]))
        moments = torch.as_tensor(states - np.concatenate((offset, np.zeros(4))), dtype=torch.float32)
        area = coded_area(layers, self._dynamics.encoder)
        under = area.terrain(torch.from_numpy(offset), self._wheels, len(moments)).at(0, moments)
        terrain = Terrain(under.normal[None], under.known[None], under.latent[None])
        control = complete(self._dynamics.vehicle, plan.controls[: len(prediction.state) : EVERY], plan.gear)
        inputs = spread_inputs(self._dynamics.vehicle, moments[None], control[None], terrain)
        axes = radius(WITHIN, float(self._spread.freedom)) * self._spread(inputs)[0].double().numpy()
        each = round(1 / INTERVAL)
        ends = prediction.state[EVERY - 1 :: EVERY][each - 1 :: each]
        return tuple(_ellipse(state, half) for state, half in zip(ends, axes[each - 1 :: each], strict=True))


def _ellipse(state: Float[np.ndarray, " 6"], half: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "P 2"]:
    """Return the outline around a state; half axes along and across its heading [m]."""
    angle = np.linspace(0, 2 * np.pi, _POINTS + 1)
    along, across = half[0] * np.cos(angle), half[1] * np.sin(angle)
    cos, sin = np.cos(state[2]), np.sin(state[2])
    return state[:2] + np.stack((cos * along - sin * across, sin * along + cos * across), axis=1)


class Showing:
    """Pass new messages to a viewer.

    Args:
        regions: None if the run has no spread.
    """

    def __init__(self, part: Part, viewer: Viewer, regions: PlanRegions | None = None) -> None:
        self._part, self._viewer, self._regions = part, viewer, regions
        self._seen, self._due = dict.fromkeys(PERIODS, 0), dict[str, float]()
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
        if (values := self._newest("map")) is not None:
            self._layers = layers_from(values)
            if self._layers is not None:
                self._viewer.ground(shown_ground(self._layers, values["scan_time"]))
            self._show_course(now)
        if (values := self._newest("course")) is not None:
            self._course = from_fields(Course, values)
            self._show_course(now)
        if (values := self._newest("plans")) is not None and "start" in values:
            self._viewer.plan(self._plan(values))
        self._show_images()
        if (values := self._newest("commands")) is not None:
            throttle, brake, steer = (float(value) for value in values["applied"])
            self._viewer.numbers(values["time"], "command", {"throttle": throttle, "brake": brake, "steer": steer})
        self._show_states(now)

    def _newest(self, name: str) -> dict[str, Any] | None:
        """Return the newest message of a ring if it is new and due."""
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
            self._seen["images"], image = entry.number, from_fields(Image, unpacked(entry.data))
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
        """Return points above the ground; where that is unknown, above the vehicle's height."""
        height = np.full(len(xy), self._height or 0.0)
        if self._layers is not None:
            on_map = ground_height(self._layers, xy)
            height = np.where(np.isfinite(on_map), on_map, height)
        return np.column_stack((xy, height + LIFT))

    def _show_states(self, now: float) -> None:
        """Show latencies and speed reported by the processes, and changes of the mode."""
        if time.monotonic() < self._due.get("states", 0.0):
            return
        self._due["states"] = time.monotonic() + _NUMBERS
        entries = {name: self._part.ring(f"status-{name}").newest() for name in PARTS}
        states = {name: {} if entry is None else unpacked(entry.data) for name, entry in entries.items()}
        numbers = {key: value for values in states.values() for key, value in values.items() if key.endswith("_ms")}
        self._viewer.numbers(now, "latencies", {key: value for key, value in numbers.items() if np.isfinite(value)})
        control = states["control"]
        if np.isfinite(control.get("speed_mps", np.nan)):
            self._viewer.numbers(now, "speed", {"speed": float(control["speed_mps"])})
        mode, _, why = str(control.get("state", "control has not started")).partition(": ")
        if (mode, why) != self._said:
            self._said = mode, why
            self._viewer.mode(now, mode, why)


def shown_ground(layers: TerrainLayers, moment: float) -> ShownGround:
    """Return the known cells of a map for a viewer."""
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
    """Run the process."""
    part, settings = Part("view", session), session.settings
    assert settings.view is not None
    rig, planner = load_rig(settings.rig), settings.load_planner()
    names = tuple(rig.cameras) if cameras else ()
    place = settings.view.place
    if place:  # if it is a file, keep that of a killed process
        place = str(unused_path(Path(place)))
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
