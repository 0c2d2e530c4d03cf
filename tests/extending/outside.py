"""Commands and scripts with an extension of examples/extending, in processes of their own."""

import subprocess
from pathlib import Path

import numpy as np

from factories import HEAD
from offpiste.core.conventions import DT
from warm import run_warm

EXTENSIONS = Path(__file__).parents[2] / "examples" / "extending"


def offpiste(*arguments: str | Path, extension: str) -> "subprocess.CompletedProcess[str]":
    """Run a command of offpiste, or `-c SCRIPT`, with a module of examples/extending."""
    return run_warm(*arguments, path=(EXTENSIONS,), OFFPISTE_EXTENSIONS=extension, COLUMNS="100")


def succeeded(*arguments: str | Path, extension: str) -> str:
    """Run a command or script that must succeed, and return its output."""
    done = offpiste(*arguments, extension=extension)
    assert done.returncode == 0, done.stderr
    return done.stdout


CAR = f"""{HEAD}
[channels]
position = {{ fields = ["x", "y"] }}
yaw = {{ fields = ["yaw"] }}
throttle = {{ fields = ["throttle"] }}
brake = {{ fields = ["brake"] }}
steer = {{ fields = ["steer"] }}
"""


def extracted_car(
    folder: Path, channel: str, *, extension: str, split: str = "blocks:1,0,0", **columns: np.ndarray
) -> Path:
    """Extract a dataset of a car that drives straight at 5 m/s, with a channel of the extension.

    Args:
        channel: line of the rig.
        columns: columns of the table at 50 Hz, in addition to pose and commands or instead of them.
    """
    (folder / "rig.toml").write_text(CAR + channel)
    time = DT * np.arange(len(next(iter(columns.values()))))
    zero = 0 * time
    table = {"t": time, "x": 5 * time, "y": zero, "yaw": zero, "throttle": zero, "brake": zero, "steer": zero} | columns
    rows = np.column_stack([*table.values()])
    np.savetxt(folder / "drive.csv", rows, delimiter=",", header=",".join(table), comments="", fmt="%.9g")
    words = ("--rig", folder / "rig.toml", "--out", folder / "d.zarr", "--split", split, "--force")
    succeeded("extract", folder / "drive.csv", *words, extension=extension)
    return folder / "d.zarr"
