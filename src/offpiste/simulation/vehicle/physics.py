"""Physics of the simulated vehicle, in C++ (`native/cpp/simulation`), and the arrays that it works on."""

from typing import Final

import numpy as np

from offpiste.native.library import entry
from offpiste.simulation.vehicle.parameters import RECORD

WHEEL: Final = np.dtype(
    [
        ("contact", float, 3),  # point of contact with the ground in the world frame [m]
        ("properties", float, 4),  # `logs.ground_truth.GROUND_PROPERTIES` at the contact
        ("load", float),  # [N]
        ("slip_ratio", float),  # [1]
        ("slip_angle", float),  # [rad]
    ]
)
"""Ground under a wheel, its load and slip; `Wheel` in forces.h."""

STATE: Final = np.dtype(
    [
        ("belt_ratio", float),  # speed of the engine over that of the belt's secondary shaft
        ("brake_pressure", float),  # 0..1
        ("steering", [("angle", float), ("rate", float)]),  # of a wheel midway between the front wheels [rad], [rad/s]
        ("speeds", float, 5),  # of the engine and the wheels [rad/s]
        ("deflection", float, (4, 2)),  # of the tyres, forward and left [m]
        ("wheels", WHEEL, 4),
        ("roof_touched", float),  # 1 after the roof touched the ground
        ("tree_touched", float),  # 1 after the body touched a tree
    ]
)
"""State of a vehicle besides its rigid bodies; `State` in forces.h."""

engine_torque = entry("engine_torque", float, float, RECORD, returns=float)
"""Torque of the engine [N m] at a speed [rad/s] and a throttle 0..1, given `VehicleParameters.as_record()`."""

substeps = entry(
    "substeps", int, int, int, int, "f8", "f8", int, int, float, float, float, "f8", int, "f8", int,
    "f8", "f8", "f8", STATE, "f8", "f8", float, RECORD,
)  # fmt: skip
"""Advance the state, write the forces on the bodies and run MuJoCo's step, `count` times.

Args:
    count: number of steps.
    mj_step, model, data: addresses of MuJoCo's function and of its arguments.
    elevation, properties, rows, columns, x0, y0, resolution: grids [rows, columns] and [rows, columns, 4] of the world,
        at least 2 x 2.
    trees, tree_count: x, y, radius of the trunks [n, 3] [m]; obstacles are searched once, at the start.
    bushes, bush_count: x, y, radius [m] and drag [N] of the bushes [n, 4].
    command: throttle, (delayed) brake, steer, engaged gear [4].
    qpos, qvel: MuJoCo's state [11], [10].
    state: `STATE`.
    body_forces: force and torque on each body in the world frame [6, 6]: MuJoCo's xfrc_applied.
    joint_forces: [10]: MuJoCo's qfrc_applied.
    dt: [s].
    parameters: `VehicleParameters.as_record()`.
"""
