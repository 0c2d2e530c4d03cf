"""Sensors and course as the processes wait for them, and kernels that are compiled before they are needed."""

import time

from offpiste.closed_loop.planner import Planner
from offpiste.live.driver import sensor_setup_of
from offpiste.live.packing import course_from, sensors_from, unpacked
from offpiste.live.part import Part
from offpiste.planning.course import Course
from offpiste.rig.rig import load_rig
from offpiste.runtime.perception import SensorSetup


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


class NewestCourse:
    """The course, and each that replaces it."""

    def __init__(self, part: Part) -> None:
        self._ring, self._number = part.ring("course"), 0

    def changed(self) -> Course | None:
        """A course that has come since the last call."""
        newest = self._ring.newest()
        if newest is None or newest.number == self._number:
            return None
        self._number = newest.number
        return course_from(unpacked(newest.data))
