"""Axis orders, names and time steps of all stages (docs/method.md, "Conventions")."""

from typing import Final

from offpiste.core import channels

DT: Final = 0.02
"""Time step of rows and of forward Euler [s]."""

HORIZON_STEPS: Final = 250
"""Predicted steps (5 s)."""

HISTORY_STEPS: Final = 10
"""Rows before t that initialise the LSTM (tau = 0.2 s)."""

FADE: Final = 10.0
"""Corrections of a network are divided by 1 + FADE d^2 at the distance d of the inputs from their ranges, in standard
deviations."""

STATE: Final = ("px", "py", "yaw", "vx", "vy", "yaw_rate")
"""[m, m, rad, m/s, m/s, rad/s]; vx, vy are the horizontal world velocity turned by minus yaw."""

ACTUATORS: Final = tuple(actuator.name for actuator in channels.ACTUATORS)
"""Columns of `actuators` in every dataset (units and signs: `offpiste.core.channels`)."""

CONTROL: Final = tuple(control.name for control in channels.CONTROLS)
"""Columns of `control` in every dataset."""

WHEELS: Final = ("front-left", "front-right", "rear-left", "rear-right")

FEATURE_SETS: Final = ("hindsight", "-20", "-10", "0", "10", "20", "30", "40")
"""Distances between vehicle and map cell when its features were seen [m]; negative after passing it."""

MIN_EVALUATION_SPEED: Final = 1.5
"""Smallest speed at the start of evaluation windows of full-size vehicles [m/s]."""

SMALLEST_FULL_SIZE: Final = 1.5
"""Smallest wheelbase of a full-size vehicle [m]."""

EVALUATION_STRIDE: Final = 5
"""Rows between the starts of evaluation windows (0.1 s)."""

PERCEPTION_LATENCY: Final = 0.1
"""Time from the last measurement in a map to the first control planned on it [s]."""

GRAVITY: Final = 9.80665
"""Standard gravity [m/s^2] (CGPM 1901)."""

SIGMA_PER_MEDIAN: Final = 1.4826
"""Ratio of standard deviation and median absolute deviation of a normal distribution."""


def min_evaluation_speed(wheelbase: float) -> float:
    """Return the smallest speed at the start of windows [m/s], scaled to small vehicles by equal Froude numbers."""
    return MIN_EVALUATION_SPEED * min(1.0, (wheelbase / SMALLEST_FULL_SIZE) ** 0.5)
