"""Axis orders, names and steps that every stage shares (docs/method.md, "Conventions")."""

from typing import Final

DT: Final = 0.02
"""Time step of rows and of forward Euler [s]."""

HORIZON_STEPS: Final = 250
"""Predicted steps: 5 s."""

HISTORY_STEPS: Final = 10
"""Rows before t that set the LSTM's state: tau = 0.2 s."""

STATE: Final = ("px", "py", "yaw", "vx", "vy", "yaw_rate")
"""[m, m, rad, m/s, m/s, rad/s]; vx, vy: horizontal world velocity turned by minus yaw."""

ACTUATORS: Final = ("brake", "steer", "steer_rate", "engine_rpm")
"""[0..1 of full pressure, rad at the road wheel and + left, rad/s, 1000 rev/min]."""

CONTROL: Final = ("throttle", "brake", "steer")
"""As commanded: [0..1, 0..1, -1..1 and + left]."""

WHEELS: Final = ("front-left", "front-right", "rear-left", "rear-right")

FEATURE_SETS: Final = ("hindsight", "-20", "-10", "0", "10", "20", "30", "40")
"""Views of a map cell by the vehicle's distance to it [m]; negative once driven past."""

MIN_EVALUATION_SPEED: Final = 1.5
"""Judged windows start above this speed [m/s]."""

EVALUATION_STRIDE: Final = 5
"""Rows between the starts of judged windows: one every 0.1 s."""

GRAVITY: Final = 9.80665
"""Standard gravity [m/s^2] (CGPM 1901)."""
