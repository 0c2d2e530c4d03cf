"""The vehicle of a rig: mass, wheels and steering."""

import msgspec
import numpy as np

from offpiste.errors import RigError


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Mass and geometry of a vehicle.

    Attributes:
        wheel_positions: x forward, y left of the pose point [m]: front-left, front-right, rear-left, rear-right.
        pose_point: point of the vehicle whose pose the log has, in words.
        max_steer: road-wheel angle at a steering command of 1 [rad]; 0 for a vehicle that does not steer.
    """

    mass: float
    wheel_positions: tuple[tuple[float, float], tuple[float, float], tuple[float, float], tuple[float, float]]
    pose_point: str
    max_steer: float = 0.0
    source: str = ""

    @property
    def rear_axle(self) -> float:
        """Distance of the rear axle behind the pose point [m]."""
        return -(self.wheel_positions[2][0] + self.wheel_positions[3][0]) / 2

    @property
    def wheelbase(self) -> float:
        """Distance between the axles [m]."""
        front_left, front_right, rear_left, rear_right = (x for x, _ in self.wheel_positions)
        return (front_left + front_right - rear_left - rear_right) / 2

    @property
    def track(self) -> float:
        """Distance between the left and the right wheels, or tracks [m]."""
        front_left, front_right, rear_left, rear_right = (y for _, y in self.wheel_positions)
        return (front_left - front_right + rear_left - rear_right) / 2


def check_vehicle(vehicle: Vehicle, *, steers: bool) -> None:
    """Refuse impossible numbers.

    Args:
        steers: whether the rig has steering commands.

    Raises:
        RigError: which number, and how to fix it.
    """
    if not 0 < vehicle.mass < np.inf:
        raise RigError(f"vehicle.mass is {vehicle.mass} kg", how="give the mass in kg")
    if not 0 < vehicle.wheelbase < np.inf:
        raise RigError("the front wheels are not ahead of the rear wheels", how="fix vehicle.wheel_positions")
    if (steers or vehicle.max_steer != 0) and not 0 < vehicle.max_steer < np.pi / 2:
        raise RigError(f"vehicle.max_steer is {vehicle.max_steer} rad", how="give a road-wheel angle below pi/2")
