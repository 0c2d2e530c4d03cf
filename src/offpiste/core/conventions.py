"""Axis orders, names and steps that every stage shares (docs/method.md, "Conventions")."""

from typing import Final

from offpiste.core import channels

DT: Final = 0.02
"""Time step of rows and of forward Euler [s]."""

HORIZON_STEPS: Final = 250
"""Predicted steps: 5 s."""

HISTORY_STEPS: Final = 10
"""Rows before t that set the LSTM's state: tau = 0.2 s."""

STATE: Final = ("px", "py", "yaw", "vx", "vy", "yaw_rate")
"""[m, m, rad, m/s, m/s, rad/s]; vx, vy: horizontal world velocity turned by minus yaw."""

ACTUATORS: Final = tuple(actuator.name for actuator in channels.ACTUATORS)
"""Columns of `actuators` that every dataset has; `offpiste.core.channels` has their units and signs."""

CONTROL: Final = tuple(control.name for control in channels.CONTROLS)
"""Columns of `control` that every dataset has."""

WHEELS: Final = ("front-left", "front-right", "rear-left", "rear-right")

FEATURE_SETS: Final = ("hindsight", "-20", "-10", "0", "10", "20", "30", "40")
"""Views of a map cell by the vehicle's distance to it [m]; negative once driven past."""

MIN_EVALUATION_SPEED: Final = 1.5
"""Evaluation windows of full-size vehicles start above this speed [m/s]; of smaller ones, `min_evaluation_speed`."""

SMALLEST_FULL_SIZE: Final = 1.5
"""Shortest wheelbase of a full-size vehicle [m]."""

EVALUATION_STRIDE: Final = 5
"""Rows between the starts of evaluation windows: one every 0.1 s."""

PERCEPTION_LATENCY: Final = 0.1
"""From the last measurement in a map to the first control that was planned on it [s]."""

GRAVITY: Final = 9.80665
"""Standard gravity [m/s^2] (CGPM 1901)."""

SIGMA_PER_MEDIAN: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def min_evaluation_speed(wheelbase: float) -> float:
    """Speed above which windows of a vehicle start [m/s]: 1.5, or less for a small one, by equal Froude numbers.

    Args:
        wheelbase: [m]; speeds go with its square root below `SMALLEST_FULL_SIZE`.
    """
    return MIN_EVALUATION_SPEED * min(1.0, (wheelbase / SMALLEST_FULL_SIZE) ** 0.5)
