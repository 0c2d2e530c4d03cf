"""Compile what Numba compiles ahead: run mapping and simulation once on minimal data."""

import io
import logging
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from offpiste.closed_loop.drive_course import CourseDriveSettings, sensor_setup
from offpiste.core.cache import KEPT_DAYS, cache_folder, forget_unused
from offpiste.core.parallel import Report, run_all
from offpiste.core.progress import show
from offpiste.core.shipped import PREFIX
from offpiste.inspection.extract import extract
from offpiste.rig.rig import load_rig
from offpiste.runtime.planner import load_planner, warm_up
from offpiste.simulation.sensors.suite import sensor_suite
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings

MODEL: Final = f"{PREFIX}proving-ground/dc"
RECORD, PLAN, EXTRACT = "record", "plan", "extract"
SMALL: Final = DriveSettings(WorldSettings("uniform", size=100.0, resolution=1.0), 1.2, sensors="light")


def warm_up_all() -> None:
    """Compile the kernels of mapping and simulation, and print the time of each part."""
    logging.getLogger("offpiste.native.kernel_cache").setLevel(logging.WARNING)  # it would advise to warm up
    with tempfile.TemporaryDirectory() as folder:
        parts: dict[str, Callable[[], object]] = {
            "mapping": partial(rehearse_part, PLAN, lambda _: None, run=MODEL, folder=Path(folder)),
        }
        if find_spec("mujoco") is not None:
            for name, part in (("simulation", RECORD), ("extraction", EXTRACT)):
                parts[name] = partial(rehearse_part, part, lambda _: None, run=MODEL, folder=Path(folder))
        for number, (name, compile_part) in enumerate(parts.items(), start=1):
            show(f"[{number}/{len(parts)}] {name} ...")
            began = time.perf_counter()
            with redirect_stdout(io.StringIO()):  # results of a drive
                compile_part()
            show(f"[{number}/{len(parts)}] {name}: {time.perf_counter() - began:.0f} s")
    show(f"stored in {cache_folder() / 'kernels'}")
    if forgotten := forget_unused(cache_folder()):
        show(f"removed {len(forgotten)} entries unused for {KEPT_DAYS:.0f} days")


def rehearse(run: str, processes: int) -> None:
    """Record a short drive and plan with a model in processes that end, to fill the cache of kernels.

    Parallel processes would otherwise each compile the same kernels and keep 300 MB of compiler memory.

    Args:
        run: model, as in `load_planner`.

    Raises:
        OffpisteError: a part failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        work = partial(rehearse_part, run=run, folder=Path(folder))
        run_all(work, (PLAN, RECORD), processes, "rehearsal", finished=lambda _: None).checked()


def rehearse_part(part: str, report: Report, *, run: str, folder: Path) -> str:
    """Record, extract or plan."""
    with redirect_stderr(io.StringIO()):
        if part == RECORD:
            simulate(SMALL, folder / "drive.mcap")
        elif part == EXTRACT:
            simulate(replace(SMALL, seconds=8.0), folder / "extracted.mcap")
            rig, pca = load_rig("proving_ground"), Path(f"{PREFIX}proving-ground")
            extract([folder / "extracted.mcap"], rig, folder / "data.zarr", pca=pca, processes=1, force=True)
        else:
            planner, rig, drive = load_planner(Path(run)), load_rig("proving_ground"), CourseDriveSettings(SMALL.world)
            setup = sensor_setup(planner, sensor_suite(drive.sensors), rig)
            warm_up(planner.dynamics, setup, rig.wheel_positions(), drive.runtime, spread=planner.spread)
    return part
