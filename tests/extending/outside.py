"""Runs the command line, or a script, with an extension from examples/extending in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from offpiste.core.conventions import DT

EXTENSIONS = Path(__file__).parents[2] / "examples" / "extending"


def offpiste(*arguments: str | Path, extension: str) -> "subprocess.CompletedProcess[str]":
    """The finished command; `extension` is the name of a module in examples/extending."""
    return python("-m", "offpiste", *arguments, extension=extension)


def python(*arguments: str | Path, extension: str) -> "subprocess.CompletedProcess[str]":
    """The finished interpreter, for scripts (`"-c", script, ...`)."""
    path = os.pathsep.join((str(EXTENSIONS), *filter(None, sys.path)))
    environment = os.environ | {"OFFPISTE_EXTENSIONS": extension, "PYTHONPATH": path, "COLUMNS": "100"}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


CAR = """
name = "car"
absent = ["brake_pressure", "steer_angle", "steer_rate", "engine_rpm"]
[vehicle]
mass = 800.0
max_steer = 0.4
pose_point = "the rear axle"
wheel_positions = [[2.2, 0.6], [2.2, -0.6], [0.0, 0.6], [0.0, -0.6]]
[channels]
position = { fields = ["x", "y"] }
yaw = { fields = ["yaw"] }
throttle = { fields = ["throttle"] }
brake = { fields = ["brake"] }
steer = { fields = ["steer"] }
"""


def extracted_car(
    folder: Path, channel: str, *, extension: str, split: str = "blocks:1,0,0", **columns: np.ndarray
) -> Path:
    """A dataset of a car that drives straight at 5 m/s, extracted from a table with a channel of the extension.

    Args:
        channel: a line of the rig.
        columns: of the table at 50 Hz, besides pose and commands, or in place of these.
    """
    (folder / "rig.toml").write_text(CAR + channel)
    time = DT * np.arange(len(next(iter(columns.values()))))
    zero = 0 * time
    table = {"t": time, "x": 5 * time, "y": zero, "yaw": zero, "throttle": zero, "brake": zero, "steer": zero} | columns
    rows = np.column_stack([*table.values()])
    np.savetxt(folder / "drive.csv", rows, delimiter=",", header=",".join(table), comments="", fmt="%.9g")
    words = ("--rig", folder / "rig.toml", "--out", folder / "d.zarr", "--split", split, "--force")
    extracted = offpiste("extract", folder / "drive.csv", *words, extension=extension)
    assert extracted.returncode == 0, extracted.stderr
    return folder / "d.zarr"
