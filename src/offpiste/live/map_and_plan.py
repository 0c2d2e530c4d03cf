"""Processes that extract features from images, map the ground, and plan on the newest map."""

import time
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from jaxtyping import Float

from offpiste.live.part import LOADING, NewestCourse, Part, TrackFeed, freeze_loaded_objects, release_freed_memory
from offpiste.live.ring import Reader, from_fields, layers_from, pack_layers, pack_plan, packed, sensors_from
from offpiste.live.session import Session
from offpiste.logs.measurements import Camera, Cloud, Image, Lidar
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.native.threads import single_threaded_torch
from offpiste.rig.camera import CameraModel
from offpiste.rig.outputs import can_reverse
from offpiste.rig.sensors import OPTICAL, CameraSource
from offpiste.runtime.estimator import Given, VehicleTrack
from offpiste.runtime.follower import Follower
from offpiste.runtime.perception import Measured, OnlineMapper, Stopwatch, encoder_on
from offpiste.runtime.plan_maker import PlanMaker
from offpiste.runtime.planner import Planner, warm_up
from offpiste.runtime.prediction import reachable

_SPARE: Final = 4.0
"""Margin of the map beyond the reach of a plan from the vehicle's position at the time of the map [m]."""
_WITHOUT_COURSE: Final = 3.0
"""Speed for which the map is cropped before a course is known [m/s]."""
_RELEASE: Final = 10.0
"""Time between releases of freed memory [s]."""


def mapper_of(part: Part, watch: Stopwatch, device: str = "cpu") -> tuple[OnlineMapper, TrackFeed] | None:
    """Return a mapper and the readings for its poses once the sensors are known; None if the drive ends first.

    Args:
        device: of feature extractor and encoder.
    """
    planner = part.settings.load_planner(device)
    load_kernels(part, planner)  # on the CPU, since nothing is planned here
    while not (sensors := part.newest("sensors")):
        if part.ending:
            return None
        part.beat("waits for the sensors' calibrations")
        time.sleep(0.05)
    setup = planner.sensor_setup(*sensors_from(sensors, part.rig))
    encoder = encoder_on(device, planner.dynamics.eval().requires_grad_(False).encoder)
    feed = TrackFeed(part, planner.dynamics.vehicle.actuators)
    mapper = OnlineMapper(setup, encoder, feed.track, part.settings.runtime.replay, watch)
    mapper.dropped = part.dropped
    freeze_loaded_objects()
    return mapper, feed


def newest_of_each(part: Part, feed: TrackFeed, reader: Reader, kind: type[Measured]) -> list[Measured]:
    """Return the newest image or scan of each sensor since the last call."""
    what, sensor = ("images", "camera") if kind is Image else ("scans", "lidar")
    newest: dict[str, Measured] = {}
    for values in reader.new():
        name, measured = values[sensor], from_fields(kind, values)
        if not feed.intake.ahead(name, measured.time):
            part.dropped[f"{what}: replaced by a newer one"] += name in newest
            newest[name] = measured
    part.dropped[f"{what}: overwritten"] = reader.lost
    return list(newest.values())


def load_kernels(part: Part, planner: Planner, device: str = "cpu") -> None:
    """Drive for a second over synthetic ground, planning on a device, so that the first plan is made in time."""
    part.report(LOADING)
    rig, still = part.rig, np.eye(4)
    still[2, 3] = 1.5
    lidars = {name: Lidar(name, still, entry) for name, entry in list(rig.lidars.items())[:1]}
    looks = still.copy()
    looks[:3, :3] = OPTICAL
    model = CameraModel(280, 210, np.array([[200.0, 0, 139.5], [0, 200.0, 104.5], [0, 0, 1]]))
    camera = Camera("synthetic", model, looks, CameraSource("/synthetic"))
    setup, runtime = planner.sensor_setup({"synthetic": camera}, lidars), replace(part.settings.runtime, device=device)
    warm_up(planner.dynamics, setup, rig.wheel_positions(), runtime, spread=planner.spread)


def codes(session: Session) -> None:
    """Run the process that encodes keyframes: backbone, PCA and encoder."""
    part, watch = Part("codes", session), Stopwatch(last=1)
    if (found := mapper_of(part, watch, part.settings.runtime.device)) is None:
        return
    mapper, feed = found  # its map stays empty

    def pass_on(camera: str, at: float, codes: np.ndarray | None) -> None:
        part.write("codes", packed({"camera": camera, "time": at, "codes": codes}))

    mapper.pass_on = pass_on
    images = part.reader("images")
    while not part.ending:
        if feed.update(part.now()):
            mapper.restart()
        newest = newest_of_each(part, feed, images, Image)
        mapper.catch_up()
        for image in newest:
            mapper.image(image)
        part.beat("ready", extract_ms=watch.last_ms("extract features"))
        if not newest:
            time.sleep(0.01)


def map_ground(session: Session) -> None:
    """Run the process that maps scans and codes."""
    part = Part("map", session)
    if (found := mapper_of(part, Stopwatch(last=1))) is None:
        return
    mapper, feed = found
    scans, coded, took = part.reader("scans"), part.reader("codes"), 0.0
    course, fastest = NewestCourse(part), _WITHOUT_COURSE
    while not part.ending:
        if (tracker := course.changed()) is not None:
            fastest = tracker.fastest
        if feed.update(part.now()):
            mapper.restart()
            part.write("map", pack_layers(None))
        for values in coded.new():
            mapper.coded(values["camera"], values["time"], values["codes"])
        before = mapper.scan_time
        newest = newest_of_each(part, feed, scans, Cloud)
        began = time.monotonic()
        mapper.catch_up()
        for cloud in newest:
            mapper.scan(cloud)
        if mapper.scan_time > before:
            layers = _within_reach(mapper.layers(), feed.track, part, fastest)
            part.write("map", pack_layers(layers, scan_time=mapper.scan_time, image_time=mapper.state.image_time))
            took = time.monotonic() - began
        state = mapper.state
        part.write("map-state", packed({"scan_time": state.scan_time, "image_time": state.image_time}))
        part.beat("ready" if mapper.scan_time > -np.inf else "waits for a scan", map_ms=1e3 * took)
        if not newest:
            time.sleep(0.01)


def _within_reach(layers: TerrainLayers, track: VehicleTrack, part: Part, fastest: float) -> TerrainLayers:
    """Crop the map to the reach of plans until the next map, at the course's maximum speed [m/s]."""
    latest = track.latest
    assert latest is not None
    state, gear = track.rows(latest.time).state[-1], part.newest("commands").get("gear", 1.0)
    return reachable(layers, state, fastest, gear, part.settings.runtime.margin + _SPARE)


def ground_height(layers: TerrainLayers, xy: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " N"]:
    """Return the elevation of the nearest cells [m]; NaN where unknown."""
    cell = np.rint((xy - layers.origin) / layers.resolution).astype(int)
    inside = ((cell >= 0) & (cell < layers.known.shape[::-1])).all(axis=1)
    height = np.full(len(xy), np.nan)
    height[inside] = layers.elevation[cell[inside, 1], cell[inside, 0]]
    return height


class Plans:
    """Plan on the values of the other processes."""

    def __init__(self, part: Part) -> None:
        self._part, settings, rig = part, part.settings, part.rig
        self.planner = settings.load_planner()
        dynamics = self.planner.dynamics.eval().requires_grad_(False)
        self._feed = TrackFeed(part, dynamics.vehicle.actuators)
        self._maker = PlanMaker(
            dynamics, rig.wheel_positions(), settings.runtime, watch=Stopwatch(last=1), spread=self.planner.spread,
            seed=settings.seed, reverses=settings.drive and can_reverse(rig.outputs),
        )  # fmt: skip
        self._course = NewestCourse(part)
        self._follower: Follower | None = None
        self._commands, self._maps = part.reader("commands"), part.reader("map", all_messages=True)
        self._layers: TerrainLayers | None = None
        self._scan_time, self.took = -np.inf, 0.0

    @torch.no_grad()
    def plan(self) -> str:
        """Write a plan if its inputs are available; return the state."""
        part, now = self._part, self._part.now()
        if self._feed.update(now):
            self._layers = None
            self._maps.newest()  # maps that were not taken yet are obsolete, too
            self._maker.forget()
            if self._follower is not None:
                self._follower.restart()
        self._take_over()
        latest = self._feed.track.latest
        if self._follower is None:
            return "waits for a course"
        if latest is None or not self._feed.track.enough:
            return "waits for readings of the vehicle"
        self._follower.tracker.move(latest.position[:2])
        if self._layers is None:
            return "waits for a map"
        timeouts = part.settings.runtime.timeouts
        if now - latest.time > timeouts.state or now - self._scan_time > timeouts.scan_limit:
            return "waits for newer readings or scans"
        began, rows = time.monotonic(), self._feed.track.rows(latest.time)
        slow = now - self._scan_time > timeouts.scan
        with single_threaded_torch():
            planned = self._maker.plan(now, self._layers, self._follower, rows, latest.time, slow=slow)
        self.took = time.monotonic() - began
        if planned is None:
            part.write("plans", packed({"empty": self._maker.map_empty, "stuck": self._maker.stuck}))
            if self._maker.map_empty or self._maker.stuck:
                return "stuck" if self._maker.stuck else "empty map"
            del self._maker.failures[:-1]
            return f"no plan: {self._maker.failures[-1]}"
        self._follower.schedule.add(planned.plan)
        self._follower.schedule.acting(now)  # forgets the plans before it
        more = {"empty": False, "stuck": False, "scan_time": self._scan_time}
        part.write("plans", pack_plan(planned.plan, **more))
        return "ready"

    def _take_over(self) -> None:
        """Take the newest map and course, and the commands since the last call."""
        if (tracker := self._course.changed()) is not None:
            if self._follower is None:
                self._follower = Follower(self._part.settings.runtime, self._feed.track, tracker)
            self._follower.tracker = tracker
        if (values := self._maps.newest()) is not None:
            self._layers, self._scan_time = layers_from(values), values.get("scan_time", -np.inf)
        for values in self._commands.new():
            driver = Given(**values["driver"])
            self._feed.track.commanded(values["time"], *driver.instead_of(values["applied"], values["gear"]))
            if self._follower is not None:
                self._follower.stopping, self._follower.gear = values["stopping"], values["gear"]
                self._follower.driver = driver


def plan(session: Session) -> None:
    """Run the process that plans, as often as the settings demand or the processor allows."""
    part = Part("plan", session)
    plans = Plans(part)
    load_kernels(part, plans.planner, part.settings.runtime.device)
    freeze_loaded_objects()
    period, released = 1 / part.settings.runtime.plan_rate, time.monotonic()
    while not part.ending:
        began = time.monotonic()
        state = plans.plan()
        part.beat(state, plan_ms=1e3 * plans.took)
        if began - released > _RELEASE:
            released = began
            release_freed_memory()
        time.sleep(max(period - (time.monotonic() - began), 0.002))
