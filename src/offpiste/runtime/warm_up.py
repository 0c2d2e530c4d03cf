"""A drive over made-up ground before there is a real one: what a run time calls is compiled, or read from the cache."""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import registered_actuators
from offpiste.core.conventions import ACTUATORS, DT
from offpiste.core.errors import PlanningError
from offpiste.dynamics.base import Dynamics
from offpiste.logs.measurements import Cloud, Image
from offpiste.planning.course import Course
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.perception import SensorSetup
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.settings import RuntimeSettings
from offpiste.uncertainty.spread import Spread

SECONDS: Final = 1.0
SPEED: Final = 2.0
"""Speed of the vehicle [m/s]."""
EVERY: Final = 10
"""Rows from scan to scan, and from image to image."""


def warm_up(
    dynamics: Dynamics,
    sensors: SensorSetup,
    wheels: Float[np.ndarray, "4 2"],
    settings: RuntimeSettings | None = None,
    *,
    spread: Spread | None = None,
) -> None:
    """Drive along a straight line over flat ground for a second, and forget it.

    A vehicle's first plan would otherwise wait for the compiler: half a minute after an installation.

    Args:
        dynamics, sensors, wheels, settings, spread: as of the `Runtime` that is to drive.

    Raises:
        PlanningError: as `Runtime`, or no plan can be made with these settings.
    """
    x = np.arange(0.0, 60.0)
    course = Course(np.stack((x, np.zeros_like(x)), axis=1), np.full(len(x), SPEED))
    runtime = Runtime(dynamics, sensors, wheels, course, settings, spread=spread)
    level, registered = np.array((0, 0, 0, 1.0)), {actuator.name: 0.0 for actuator in registered_actuators()}
    for row in range(round(SECONDS / DT)):
        time = row * DT
        place, velocity = np.array((SPEED * time, 0.0, 0.0)), np.array((SPEED, 0.0, 0.0))
        runtime.vehicle(VehicleReading(time, place, level, velocity, 0.0, np.zeros(len(ACTUATORS)), registered))
        if row % EVERY == 1:  # of the first moment there is no pose before
            _see(runtime, sensors, time)
        runtime.command(time)
    if not runtime.predictions:
        why = runtime.failures[-1] if runtime.failures else runtime.events[-1].why
        raise PlanningError(f"no plan was made on flat ground: {why}", how="change the settings of the run time")


def _see(runtime: Runtime, sensors: SensorSetup, time: float) -> None:
    """Give the run time a grey image of each camera, and a scan of flat ground from each LiDAR."""
    for name, camera in sensors.cameras.items():
        width, height = camera.rectifier.source.size
        runtime.image(Image(time, name, np.full((height, width, 3), 128, np.uint8)))
    side = np.arange(-20.0, 20.0, 0.25)
    ground = np.stack([axis.ravel() for axis in (*np.meshgrid(side, side), np.zeros((len(side), len(side))))], axis=1)
    for name, lidar in sensors.lidars.items():
        body_from_lidar = lidar.body_from_lidar
        points = (ground - body_from_lidar[:3, 3]) @ body_from_lidar[:3, :3]
        offset, intensity = np.zeros(len(points)), np.full(len(points), np.nan)
        runtime.scan(Cloud(time, name, points, offset, intensity))
