"""Process that shows a drive: the newest messages, at the viewer's pace."""

import time
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Float
from matplotlib import colormaps

from offpiste.core.state import Trajectory
from offpiste.dynamics.base import Dynamics
from offpiste.live.map_and_plan import ground_height
from offpiste.live.part import Part, unused_path
from offpiste.live.ring import from_fields, layers_from, plan_from
from offpiste.live.session import PARTS, Session
from offpiste.live.viewers import VIEWERS, Ground, Line, Viewer
from offpiste.logs.measurements import Image
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.controls import complete
from offpiste.planning.course import Course
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction, coded_area
from offpiste.uncertainty.spread import EVERY, INTERVAL, Spread, inputs_along, radius
from offpiste.visualization.map_figure import STEEP, TALL

PERIODS: Final = {"readings": 0.05, "plans": 0.1, "map": 1.0, "images": 0.2, "commands": 0.1, "course": 0.5}
"""Minimum time between updates of each kind [s]."""
LIFT: Final = 0.3
"""Height of lines above the ground [m]."""
_NUMBERS: Final = 0.2
"""Time between plotted numbers [s]."""
_STEP: Final = 2
"""Step in cells of the shown map, in both directions."""
_EVERY: Final = 5
"""Step in states of the shown plan."""
_OBSTACLE: Final = 0.2
"""Height from which a cell is coloured as an obstacle [m]."""
_FASTEST: Final = 10.0
"""Speed at the upper end of the colours of a plan [m/s]."""
_WHITE, _BLUE = (255, 255, 255), (20, 90, 200)
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
        """Return closed lines x, y [m] on a map with the model's codes as features."""
        vehicle, offset = self._dynamics.vehicle, prediction.state[0, :2].copy()
        states = torch.as_tensor(prediction.state - np.append(offset, np.zeros(4)), dtype=torch.float32)[None]
        source = coded_area(layers, self._dynamics.encoder).terrain(torch.from_numpy(offset), self._wheels, 1)
        control = complete(vehicle, plan.controls[: len(prediction.state)], plan.gear)[None]
        # The state before the first step is not available; the state after it replaces it.
        inputs = inputs_along(vehicle, states[:, 0], Trajectory(states, states[..., :0]), control, source)
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
        self._readers = {name: part.reader(name, all_messages=True) for name in PERIODS}
        self._due = dict.fromkeys((*PERIODS, "states"), 0.0)
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
            self._viewer.lines("course", now, [self._line(self._course.driven, _WHITE, 0.12)])
        if (values := self._newest("plans")) is not None and "start" in values:
            self._show_plan(*plan_from(values))
        if self._is_due("images", PERIODS["images"]):
            images = (from_fields(Image, values) for values in self._readers["images"].new())
            for image in {image.camera: image for image in images}.values():
                self._viewer.image(image)
        if (values := self._newest("commands")) is not None:
            command = dict(zip(("throttle", "brake", "steer"), map(float, values["applied"]), strict=True))
            self._viewer.numbers(values["time"], "command", command)
        if self._is_due("states", _NUMBERS):
            self._show_states(now)

    def _is_due(self, name: str, period: float) -> bool:
        now = time.monotonic()
        due = now >= self._due[name]
        if due:
            self._due[name] = now + period
        return due

    def _newest(self, name: str) -> dict[str, Any] | None:
        """Return the values of the newest message of a ring if it is new and due."""
        if time.monotonic() < self._due[name] or (values := self._readers[name].newest()) is None:
            return None
        self._due[name] = time.monotonic() + PERIODS[name]
        return values

    def _show_plan(self, plan: TimedPlan, prediction: Prediction) -> None:
        states = prediction.state[::_EVERY]
        speed = np.hypot(states[:, 3], states[:, 4])
        colours = (255 * colormaps["plasma"](np.clip(speed / _FASTEST, 0, 1))[:, :3]).astype(np.uint8)
        lines = [self._line(states[:, :2], colours, 0.16)]
        if self._regions is not None and self._layers is not None:
            outlines = self._regions.outlines(self._layers, plan, prediction)
            lines += [self._line(outline, _BLUE, 0.05) for outline in outlines]
        self._viewer.lines("plan", plan.start, lines)

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


def view(session: Session, *, cameras: bool) -> None:
    """Run the process."""
    part, settings = Part("view", session), session.settings
    rig, planner, place = part.rig, settings.load_planner(), settings.view_at
    if place:  # if it is a file, keep that of a killed process
        place = str(unused_path(Path(place)))
    viewer = VIEWERS[settings.view](place, rig.wheel_positions(), tuple(rig.cameras) if cameras else ())
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
