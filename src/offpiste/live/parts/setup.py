"""Sensors and course as the processes wait for them, and kernels that are compiled before they are needed."""

import time
from dataclasses import replace
from typing import Any, Final

import numpy as np

from offpiste.live.driver import sensor_setup_of
from offpiste.live.packing import course_from, sensors_from, unpacked
from offpiste.live.part import Part
from offpiste.logs.measurements import Camera, Lidar
from offpiste.perception.camera import make_pinhole_camera
from offpiste.planning.course import CourseTracker
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import load_rig
from offpiste.rig.sensors import OPTICAL, CameraSource
from offpiste.runtime.perception import SensorSetup
from offpiste.runtime.planner import Planner, warm_up

LOADING: Final = "loads its kernels"
"""State of a process while it gives no further sign of life."""


def wait_for_sensors(part: Part, planner: Planner) -> SensorSetup | None:
    """Sensors, once the receiver has them; None where the drive ends before."""
    while not part.ending:
        newest = part.ring("sensors").newest()
        if newest is not None:
            sensors = sensors_from(unpacked(newest.data), load_rig(part.settings.rig))
            return sensor_setup_of(planner, sensors)
        part.beat("waits for the sensors' calibrations")
        time.sleep(0.05)
    return None


def load_kernels(part: Part, planner: Planner, device: str = "cpu") -> None:
    """Drive for a second over made-up ground: what is compiled is loaded before the robot is heard.

    Args:
        device: that the process plans on; one that does not plan leaves a GPU alone.
    """
    part.end_with(LOADING)
    rig, still = load_rig(part.settings.rig), np.eye(4)
    still[2, 3] = 1.5
    lidars = {name: Lidar(name, still, entry) for name, entry in list(rig.lidars.items())[:1]}
    setup = SensorSetup(lidars)
    if planner.extractor is not None:
        looks = still.copy()
        looks[:3, :3] = OPTICAL
        model = CameraModel(280, 210, np.array([[200.0, 0, 139.5], [0, 200.0, 104.5], [0, 0, 1]]))
        camera = Camera("made up", model, looks, CameraSource("/made_up"))
        cameras = {"made up": make_pinhole_camera(camera, planner.extractor.patch)}
        setup = SensorSetup(lidars, cameras, planner.extractor.extract)
    runtime = replace(part.settings.runtime, device=device)
    warm_up(planner.dynamics, setup, rig.wheel_positions(), runtime, spread=planner.spread)


class NewestCourse:
    """The course, and each that replaces it.

    Attributes:
        number: of the one that is driven; 0 before the first.
    """

    def __init__(self, part: Part) -> None:
        self._part, self._ring, self.number = part, part.ring("course"), 0

    def changed(self) -> CourseTracker | None:
        """A tracker of a course that has come since the last call; where it was being driven already, from there on."""
        newest = self._ring.newest()
        if newest is None or newest.number == self.number:
            return None
        self.number = newest.number
        tracker = CourseTracker(course_from(unpacked(newest.data)))
        before = last_command(self._part)
        if before.get("course") == self.number:
            tracker.resume(before["progress"])
        return tracker


def last_command(part: Part) -> dict[str, Any]:
    """What was commanded last, maybe by a process that is gone; empty for nothing."""
    newest = part.ring("commands").newest()
    return {} if newest is None else unpacked(newest.data)
