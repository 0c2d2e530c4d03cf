"""Compile all kernels ahead: run each part of offpiste once on minimal data."""

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

import torch

from offpiste.closed_loop.drive_course import CourseDriveSettings, sensor_setup
from offpiste.core.cache import KEPT_DAYS, cache_folder, forget_unused
from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.core.parallel import Report, run_all
from offpiste.core.progress import show
from offpiste.core.shipped import PREFIX
from offpiste.core.state import ModelState, Terrain
from offpiste.dynamics import Vehicle
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.dynamics.hybrid import Hybrid
from offpiste.dynamics.kernels.actuators import rollout_actuators
from offpiste.dynamics.kernels.autograd import rollout_recorded
from offpiste.dynamics.kernels.encoder import codes_under_wheels, encode_cells
from offpiste.dynamics.kernels.map_rollout import predict_on
from offpiste.inspection.extract import extract
from offpiste.mapping.terrain_sampler import CellStack, MapTerrain
from offpiste.rig.rig import load_rig
from offpiste.runtime.planner import load_planner, warm_up
from offpiste.simulation.sensors.suite import sensor_suite
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings

MODEL: Final = f"{PREFIX}proving-ground/dc"
STEPS: Final = 2
RECORD, PLAN, EXTRACT = "record", "plan", "extract"
SMALL: Final = DriveSettings(WorldSettings("uniform", size=100.0, resolution=1.0), 1.2, sensors="light")


def warm_up_all() -> None:
    """Compile the kernels of training, planning, mapping and simulation, and print the time of each part."""
    logging.getLogger("offpiste.native.kernel_cache").setLevel(logging.WARNING)  # it would advise to warm up
    with tempfile.TemporaryDirectory() as folder:
        parts: dict[str, Callable[[], object]] = {
            "training": compile_training,
            "mapping and planning": partial(rehearse_part, PLAN, lambda _: None, run=MODEL, folder=Path(folder)),
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


def compile_training() -> None:
    """Run model and actuators forward and backward with codes of two cells, and the model over a map of one cell."""
    vehicle = Vehicle(1000.0, 2.0, 0.5, CONTROL, ACTUATORS, features=2)
    encoder = Compressor(vehicle.features)
    model, lags = Hybrid(vehicle, encoder=encoder), Actuators(vehicle)
    model.actuators.requires_grad_(False)
    state, actuators = torch.zeros(1, 6), torch.zeros(1, len(ACTUATORS))
    controls, recurrent = torch.zeros(1, STEPS, len(CONTROL)), torch.zeros(1, model.recurrent_size)
    codes = encode_cells(encoder, torch.zeros(2, vehicle.features), torch.ones(2, dtype=torch.bool))
    level = Terrain.of(torch.tensor([0.0, 0.0, 1.0]).expand(1, STEPS, 4, 3))
    ground = Terrain(level.normal, level.known, codes_under_wheels(codes, torch.zeros(1, STEPS, 4, dtype=torch.int64)))
    rollout_recorded(model, ModelState(state, actuators, recurrent), controls, ground).state.sum().backward()
    maps = CellStack(
        0.2,
        torch.zeros(1, 2, dtype=torch.float64),
        torch.zeros(1, 2, dtype=torch.int64),
        torch.zeros(1, 1, 1, dtype=torch.int32),
        torch.zeros(1, 2, dtype=torch.float16),
        torch.zeros(1, vehicle.features, dtype=torch.float16),
    )
    origin = torch.zeros(1, 2, dtype=torch.float64)
    terrain = MapTerrain(maps, torch.zeros(1, dtype=torch.int64), origin, torch.zeros(4, 2), encoder)
    with torch.no_grad():
        predict_on(model, ModelState(state, actuators, recurrent), controls, terrain)
    recurrent = torch.zeros(1, lags.recurrent_size)
    rollout_actuators(lags, controls, torch.zeros(1, STEPS), actuators, recurrent).sum().backward()


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
