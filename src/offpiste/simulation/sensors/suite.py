"""Sensors and their mountings on the vehicle: profiles `full` as in the paper, `light` for long drives, `none`."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from offpiste.errors import OffpisteError
from offpiste.simulation.sample import Pose
from offpiste.simulation.sensors.camera import CameraSettings
from offpiste.simulation.sensors.lidar import LidarSettings
from offpiste.simulation.sensors.messages import Mounting

_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation to body axes from those of a camera that looks ahead: z forward, x right, y down."""


@dataclass(frozen=True)
class SensorSuite:
    """Cameras and LiDARs of a vehicle."""

    cameras: tuple[CameraSettings, ...]
    lidars: tuple[LidarSettings, ...]

    def mountings(self) -> tuple[Mounting, ...]:
        """Mountings of all sensors, for the recorder."""
        poses = [(camera.name, camera.body_from_camera) for camera in self.cameras]
        poses += [(lidar.name, lidar.body_from_lidar) for lidar in self.lidars]
        return tuple(Mounting(n, tuple(p.position.tolist()), tuple(p.orientation.tolist())) for n, p in poses)


def full_suite() -> SensorSuite:
    """Four cameras around the roof, a LiDAR above it and one low over the tail, which sees the ground just driven over.

    Rates and image sizes are the paper's (section "Visual features"); its lenses and mountings are not published.
    """
    front = CameraSettings("camera_front", mounted((0.60, 0.0, 1.54), pitch=17.0, optical=True))
    return SensorSuite(
        cameras=(
            front,
            replace(front, name="camera_left", body_from_camera=_side(80.0)),
            replace(front, name="camera_right", body_from_camera=_side(-80.0)),
            replace(
                front,
                name="camera_back",
                body_from_camera=mounted((-0.62, 0.0, 1.54), yaw=180.0, pitch=20.0, optical=True),
                rate=2.0,
            ),
        ),
        lidars=(
            LidarSettings("lidar_top", mounted((0.0, 0.0, 1.95))),
            LidarSettings("lidar_back", mounted((-1.45, 0.0, 0.75), yaw=180.0, pitch=8.0)),
        ),
    )


def light_suite() -> SensorSuite:
    """The front camera at 2 Hz and the upper LiDAR with 32 x 512 rays: simulated faster than it happens."""
    full = full_suite()
    return SensorSuite(
        cameras=(replace(full.cameras[0], rate=2.0),),
        lidars=(replace(full.lidars[0], rings=32, columns=512),),
    )


def no_sensors() -> SensorSuite:
    """A drive without cameras and LiDAR."""
    return SensorSuite((), ())


PROFILES: Final[dict[str, Callable[[], SensorSuite]]] = {"full": full_suite, "light": light_suite, "none": no_sensors}


def sensor_suite(profile: str) -> SensorSuite:
    """The sensors of a profile: `full`, `light`, or `none`.

    Raises:
        OffpisteError: there is no such profile.
    """
    if profile not in PROFILES:
        raise OffpisteError(f"no sensor profile is called {profile!r}", how=f"choose one of {', '.join(PROFILES)}")
    return PROFILES[profile]()


def mounted(
    position: tuple[float, float, float], *, yaw: float = 0.0, pitch: float = 0.0, optical: bool = False
) -> Pose:
    """`body_from_sensor` of a sensor that looks to the left by `yaw` and down by `pitch` [deg].

    Args:
        position: in the body frame [m].
        optical: axes of a camera (z forward, x right, y down) instead of x forward, y left, z up.
    """
    turn = Rotation.from_euler("ZY", (yaw, pitch), degrees=True)
    axes = turn * Rotation.from_matrix(_OPTICAL) if optical else turn
    return Pose(np.array(position), axes.as_quat())


def _side(yaw: float) -> Pose:
    return mounted((0.05, np.copysign(0.62, yaw), 1.60), yaw=yaw, pitch=24.0, optical=True)
