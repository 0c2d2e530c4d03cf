"""Plans on the newest map, as often as the settings say or the processor allows."""

import time

import numpy as np
import torch

from offpiste.live.packing import layers_from, pack_plan, packed, unpacked
from offpiste.live.part import FreedMemory, Part, TrackFeed, keep_loaded
from offpiste.live.parts.setup import NewestCourse, load_kernels
from offpiste.live.session import Session
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.native.compilation import single_threaded_torch
from offpiste.rig.outputs import can_reverse
from offpiste.rig.rig import load_rig
from offpiste.runtime.estimator import Given
from offpiste.runtime.follower import Follower
from offpiste.runtime.perception import Stopwatch
from offpiste.runtime.plan_maker import PlanMaker


class Plans:
    """Makes plans from what the other processes hand over."""

    def __init__(self, part: Part) -> None:
        self._part, settings = part, part.settings
        self.planner, self._rig = settings.load_planner(), load_rig(settings.rig)
        dynamics = self.planner.dynamics.eval().requires_grad_(False)
        self._feed = TrackFeed(part, dynamics.vehicle.actuators)
        wheels, spread = self._rig.wheel_positions(), self.planner.spread
        # In shadow mode somebody else drives, and may wait.
        reverses = settings.drive and can_reverse(self._rig.outputs)
        self._maker = PlanMaker(
            dynamics, wheels, settings.runtime, watch=Stopwatch(last=1), spread=spread, seed=settings.seed,
            reverses=reverses,
        )  # fmt: skip
        self._course = NewestCourse(part)
        self._follower: Follower | None = None
        self._commands, self._map_number = part.ring("commands").written, 0
        self._layers: TerrainLayers | None = None
        self._scan_time, self.took = -np.inf, 0.0

    @torch.no_grad()
    def plan(self) -> str:
        """Make a plan, if all is there; the state in words."""
        part, now = self._part, self._part.now()
        if self._feed.update(now):
            self._layers = None
            self._map_number = part.ring("map").written  # those that were not taken yet are of before, too
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
            part.hand_on("plans", packed({"empty": self._maker.map_empty, "stuck": self._maker.stuck}))
            if self._maker.map_empty or self._maker.stuck:
                return "stuck" if self._maker.stuck else "empty map"
            del self._maker.failures[:-1]
            return f"no plan: {self._maker.failures[-1]}"
        self._follower.schedule.add(planned.plan)
        self._follower.schedule.acting(now)  # those before it are forgotten
        part.hand_on(
            "plans", pack_plan(planned.plan, planned.prediction, empty=False, stuck=False, scan_time=self._scan_time)
        )
        return "ready"

    def _take_over(self) -> None:
        """Take the newest map, course, and what was commanded."""
        if (tracker := self._course.changed()) is not None:
            if self._follower is None:
                self._follower = Follower(self._part.settings.runtime, self._feed.track, tracker)
            self._follower.tracker = tracker
        newest = self._part.ring("map").newest()
        if newest is not None and newest.number != self._map_number:
            self._map_number, values = newest.number, unpacked(newest.data)
            self._layers, self._scan_time = layers_from(values), values.get("scan_time", -np.inf)
        for entry in self._part.ring("commands").since(self._commands):
            self._commands, values = entry.number, unpacked(entry.data)
            driver = Given(**values["driver"])
            self._feed.track.commanded(values["time"], *driver.instead_of(values["applied"], values["gear"]))
            if self._follower is not None:
                self._follower.stopping, self._follower.gear = values["stopping"], values["gear"]
                self._follower.driver = driver


def plan(session: Session) -> None:
    """The process that plans."""
    part = Part("plan", session)
    plans = Plans(part)
    load_kernels(part, plans.planner, part.settings.runtime.device)
    keep_loaded()
    freed = FreedMemory()
    period = 1 / part.settings.runtime.plan_rate
    while not part.ending:
        began = time.monotonic()
        state = plans.plan()
        part.beat(state, plan_ms=1e3 * plans.took)
        freed.give_back()
        time.sleep(max(period - (time.monotonic() - began), 0.002))
