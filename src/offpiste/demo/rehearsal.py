"""A rehearsal on made-up ground, in processes that end: it compiles what the demo calls.

Without it, processes that work side by side compile the same, and keep the compiler's 300 MB each.
"""

import io
import tempfile
from contextlib import redirect_stderr
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from offpiste.closed_loop.drive_course import CourseDriveSettings, sensor_setup
from offpiste.closed_loop.planner import load_planner
from offpiste.core.parallel import Report, run_all
from offpiste.core.shipped import PREFIX
from offpiste.dataset.extract import make_dataset
from offpiste.rig.rig import load_rig
from offpiste.runtime.warm_up import warm_up
from offpiste.simulation.sensors.suite import sensor_suite
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings

RECORD, PLAN, EXTRACT = "record", "plan", "extract"
SMALL: Final = DriveSettings(WorldSettings("uniform", size=100.0, resolution=1.0), 1.2, sensors="light")


def rehearse(run: str, processes: int) -> None:
    """Record a drive of a second, and plan with a model, in processes of their own.

    Args:
        run: of the model, as `load_planner` takes it.

    Raises:
        OffpisteError: what would also end the demo.
    """
    with tempfile.TemporaryDirectory() as folder:
        work = partial(rehearse_part, run=run, folder=Path(folder))
        failed = run_all(work, (PLAN, RECORD), processes, "rehearsal", finished=_unsaid)
    if failed:
        raise failed[0]


def rehearse_part(part: str, report: Report, *, run: str, folder: Path) -> str:
    """Record, extract what was recorded, or plan."""
    with redirect_stderr(io.StringIO()):
        if part == RECORD:
            simulate(SMALL, folder / "drive.mcap")
        elif part == EXTRACT:
            simulate(replace(SMALL, seconds=8.0), folder / "extracted.mcap")
            rig, pca = load_rig("proving_ground"), Path(f"{PREFIX}proving-ground")
            make_dataset([folder / "extracted.mcap"], rig, folder / "data.zarr", pca=pca, processes=1, force=True)
        else:
            planner, rig, drive = load_planner(Path(run)), load_rig("proving_ground"), CourseDriveSettings(SMALL.world)
            setup = sensor_setup(planner, sensor_suite(drive.sensors), rig)
            warm_up(planner.dynamics, setup, rig.wheel_positions(), drive.runtime, spread=planner.spread)
    return part


def _unsaid(result: str) -> None:
    """Nothing: it is no result that anyone asked for."""
