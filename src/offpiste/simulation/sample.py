"""What a simulated vehicle can say of itself at one moment: what its sensors measure, and the truth."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class WheelTruth:
    """What no real log has; front-left, front-right, rear-left, rear-right.

    Attributes:
        contact: where the wheels touch the ground, in the world frame [m].
        properties: of the ground there (`world.GROUND_PROPERTIES`).
        kind: the ground's main kind there (index into `world.GROUND_KINDS`).
        load: normal load [N].
        slip_ratio: (wheel speed - ground speed) / ground speed, limited to [-1, 1].
        slip_angle: [rad].
    """

    contact: Float[np.ndarray, "4 3"]
    properties: Float[np.ndarray, "4 4"]
    kind: Int[np.ndarray, " 4"]
    load: Float[np.ndarray, " 4"]
    slip_ratio: Float[np.ndarray, " 4"]
    slip_angle: Float[np.ndarray, " 4"]


@dataclass(frozen=True)
class VehicleSample:
    """One moment of a drive.

    Attributes:
        time: since the start of the drive [s].
        position: of the pose point, in the world frame [m].
        orientation: world_from_body, xyzw.
        velocity: of the pose point, in the world frame [m/s].
        angular_velocity: in the body frame [rad/s].
        command: throttle [0..1], brake [0..1], steer [-1..1], held since this moment.
        brake_pressure: [0..1 of full pressure].
        steer_angle: road wheels, + left [rad].
        steer_rate: [rad/s].
        engine_speed: [rev/min].
        wheel_speed: rolling speed of each wheel (its rotation times its radius) [m/s].
        suspension: compression of each from full droop [m].
        events: what happened since the last sample: "rollover", "collision with a tree", "left the world".
    """

    time: float
    position: Float[np.ndarray, " 3"]
    orientation: Float[np.ndarray, " 4"]
    velocity: Float[np.ndarray, " 3"]
    angular_velocity: Float[np.ndarray, " 3"]
    command: Float[np.ndarray, " 3"]
    brake_pressure: float
    steer_angle: float
    steer_rate: float
    engine_speed: float
    wheel_speed: Float[np.ndarray, " 4"]
    suspension: Float[np.ndarray, " 4"]
    truth: WheelTruth
    events: tuple[str, ...] = ()
