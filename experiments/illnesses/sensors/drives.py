"""Simulates drives with one camera and one LiDAR in three layouts, and keeps them in a folder."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from experiments.illnesses.behaviours import BEHAVIOURS, world_of
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, load_rig
from offpiste.simulation.sample import Pose
from offpiste.simulation.sensors.camera import MODEL, Camera
from offpiste.simulation.sensors.suite import SensorSuite, light_suite, mounted
from offpiste.simulation.simulate import DriveSettings, record
from offpiste.simulation.vehicle.parameters import load_vehicle

logger = logging.getLogger("experiments")

CAMERA, LIDAR = "camera_front", "lidar_top"
"""Names of the two sensors, in every layout."""
SECONDS: Final = 40.0
_LEAST: Final = 25.0
"""A drive that ends earlier than this, by a rollover or stuck, is driven again [s]."""
_FORWARDS: Final = [name for name in BEHAVIOURS if name != "reversing"]
_MODEL: Final = replace(
    MODEL,
    width=MODEL.width // 2,
    height=MODEL.height // 2,
    # The middle of the first pixel is (0, 0).
    matrix=np.array([[0.5, 0.0, -0.25], [0.0, 0.5, -0.25], [0.0, 0.0, 1.0]]) @ MODEL.matrix,
)
"""Half of the proving ground's images: what the checks make of them anyway."""


@dataclass(frozen=True)
class Layout:
    """Mountings of the camera and the LiDAR, as `body_from_sensor`."""

    camera: Pose
    lidar: Pose

    def suite(self) -> SensorSuite:
        """The sensors, at the rates and resolutions of profile `light`."""
        (camera,), (lidar,) = light_suite().cameras, light_suite().lidars
        return SensorSuite(
            (replace(camera, body_from_camera=self.camera, model=_MODEL),),
            (replace(lidar, body_from_lidar=self.lidar),),
        )

    def rig(self) -> Rig:
        """The proving ground's rig with these two sensors; the camera's own body is where its rays meet it."""
        camera = Camera(self.suite().cameras[0])
        own = camera.in_rows(camera.own).distance
        seen = np.isfinite(own).reshape(_MODEL.height, _MODEL.width).astype(np.uint8)
        outlines, _ = cv2.findContours(cv2.dilate(seen, np.ones((5, 5))), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        polygons = [line[:, 0].tolist() for line in outlines if len(line) > 2]
        rig = load_rig("proving_ground")
        others = [f"cameras.{name}" for name in rig.cameras if name != CAMERA]
        others += [f"lidars.{name}" for name in rig.lidars if name != LIDAR]
        return edited(rig, [*(Edit(key, None) for key in others), Edit(f"cameras.{CAMERA}.own_body", polygons)])


_USUAL: Final = light_suite()
LAYOUTS: Final[dict[str, Layout]] = {
    "roof": Layout(_USUAL.cameras[0].body_from_camera, _USUAL.lidars[0].body_from_lidar),
    "mast": Layout(mounted((0.3, 0.1, 2.1), pitch=24.0, optical=True), mounted((-0.2, 0.0, 2.5), pitch=8.0)),
    "hood": Layout(mounted((1.3, -0.2, 0.9), pitch=8.0, optical=True), mounted((1.0, 0.2, 1.1), yaw=15.0, pitch=3.0)),
}
"""Layouts by name."""


@dataclass(frozen=True)
class SensorDrive:
    """A recorded drive.

    Attributes:
        path: of the log.
        behaviour, layout: by name.
    """

    number: int
    path: Path
    behaviour: str
    layout: str


def drive_of(number: int, cache: Path) -> SensorDrive:
    """A drive by its number: simulated once, then found in the folder.

    Args:
        cache: folder of simulated drives.
    """
    kept = sorted(cache.glob(f"sensors-{number:06d}-*.mcap"))
    if not kept:
        _simulate(number, cache)
        return drive_of(number, cache)
    behaviour, layout = kept[0].stem.split("-")[2:]
    return SensorDrive(number, kept[0], behaviour, layout)


def _simulate(number: int, cache: Path) -> None:
    """Record a drive; one that ends too early is begun again with the next random numbers."""
    world, vehicle, random = world_of(number), load_vehicle(), np.random.default_rng([number, 0x5E5])
    layout = list(LAYOUTS)[number % len(LAYOUTS)]
    shares = np.array([BEHAVIOURS[name].share for name in _FORWARDS])
    cache.mkdir(parents=True, exist_ok=True)
    part = cache / f"part-{number:06d}.mcap"
    while True:
        behaviour = str(random.choice(_FORWARDS, p=shares / shares.sum()))
        ground = BEHAVIOURS[behaviour].ground(world, random)
        start, controller = BEHAVIOURS[behaviour].driver(ground, vehicle, random)
        settings = DriveSettings(world=ground.settings, seed=int(random.integers(1 << 30)))
        steps, suite = round(SECONDS * 50), LAYOUTS[layout].suite()
        part.unlink(missing_ok=True)
        if record(settings, ground, vehicle, start, controller, part, steps=steps, suite=suite).seconds > _LEAST:
            part.rename(cache / f"sensors-{number:06d}-{behaviour}-{layout}.mcap")
            return
