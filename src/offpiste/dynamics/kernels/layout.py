"""Memory layout of compiled code: rows of a sample's workspace, and the vector of constants.

The adjoint of row r is row r of a second workspace.
"""

from typing import Final

from offpiste.core.channels import KERNEL_CONTROLS
from offpiste.core.conventions import ACTUATORS, STATE
from offpiste.dynamics.actuator_lags import lagging
from offpiste.dynamics.bicycle import Constants, DriveTrain, Force

HIDDEN: Final = 4
"""Hidden units of every compensator that the kernels step."""

STEPPED: Final = (*STATE, *ACTUATORS)
"""States and actuators, which the physics steps, in order."""

COMMANDS: Final = tuple(control.name for control in KERNEL_CONTROLS)
"""Controls that kernels know, of which a vehicle has the first ones."""

ABSENT: Final = tuple(control.absent for control in KERNEL_CONTROLS)
"""Values of `COMMANDS` where a log lacks them."""

CONTROLS: Final = tuple(f"{name}_command" if name in ACTUATORS else name for name in COMMANDS)
"""`COMMANDS`, named apart from the actuators."""

NORMAL: Final = ("world_normal_x", "world_normal_y", "world_normal_z")
"""Mean of the wheels' surface normals in the world frame."""

BODY_NORMAL: Final = ("normal_x", "normal_y", "normal_z")
"""The mean normal turned by minus yaw."""

UNKNOWN: Final = ("unknown_normals",)
"""Share of the wheels whose surface normal is unknown."""

FORCE: Final = tuple(f"force_{name}" for name in Force._fields)
"""The parametric force vector F."""

CORRECTION: Final = tuple(f"{name}_correction" for name in Force._fields)
"""Correction of the force by the compensator."""

LAGGING: Final = lagging()
"""Actuators that the kernels step, with their delay models."""

RESIDUALS: Final = tuple(f"{one.label}_residual" for one in LAGGING if one.lag.residual)
"""Outputs of the residual networks of actuators [1/s, rad/s^2]."""

NEXT: Final = tuple(f"next_{name}" for name in STEPPED)
"""`STEPPED` one step later."""

# Networks write their outputs four rows at a time, hence the unused rows behind each residual.
_SPARE: Final = tuple(tuple(f"unused_{name}_{i}" for i in range(3)) for name in RESIDUALS)

ROWS: Final = (
    *STEPPED, *CONTROLS, *NORMAL, *BODY_NORMAL, *FORCE, *CORRECTION,
    *(name for residual, spare in zip(RESIDUALS, _SPARE, strict=True) for name in (residual, *spare)), *NEXT,
    *UNKNOWN,
)  # fmt: skip
"""Rows of the workspace in order; codes of the wheels follow."""

ROW: Final = {name: row for row, name in enumerate(ROWS)}

MEASURED: Final = {
    name: one.actuator.name for name in DriveTrain._fields for one in LAGGING if one.actuator.drives == name
}
"""Inputs of the bicycle that an actuator can measure, and which one."""

SWITCHES: Final = (
    *(f"{name}_measured" for name in MEASURED),
    *(f"{one.label}_lags" for one in LAGGING),
    "max_steer",
)
"""1 or 0: is an input measured, does an actuator lag behind its command; then the steering angle at command 1 [rad]."""

LAG_CONSTANTS: Final = tuple(f"{one.label}_{name}" for one in LAGGING for name in one.lag.constants)
"""In the order of `Actuators.flat_constants`."""

CONSTANTS: Final = (*Constants._fields, *LAG_CONSTANTS, *SWITCHES)
"""The vector of constants; the first `len(Constants._fields)` of them are learned."""

LEARNED: Final = Constants._fields
"""The constants with gradients: the first of `CONSTANTS`."""

_CELL: Final = ("input_gate", "forget_gate", "cell_gate", "output_gate", "memory", "next_hidden", "next_memory")
CELL_ROW: Final = {name: row for row, name in enumerate(_CELL)}
"""Rows of the workspace of one unit of an LSTM."""
