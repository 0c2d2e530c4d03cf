"""Compiles everything ahead: each part of offpiste once, on as little data as it takes."""

import io
import logging
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import torch

from offpiste.core.cache import KEPT_DAYS, cache_folder, forget_unused
from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.core.progress import show
from offpiste.core.shipped import PREFIX
from offpiste.core.state import ModelState, Terrain
from offpiste.demo.rehearsal import EXTRACT, PLAN, RECORD, rehearse_part
from offpiste.dynamics import Vehicle
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.dynamics.hybrid import Hybrid
from offpiste.dynamics.kernels.actuators import rollout_actuators
from offpiste.dynamics.kernels.autograd import rollout_recorded
from offpiste.dynamics.kernels.encoder import codes_under_wheels, encode_cells
from offpiste.dynamics.kernels.map_rollout import predict_on
from offpiste.mapping.terrain_sampler import CellStack, MapTerrain

MODEL: Final = f"{PREFIX}proving-ground/dc"
STEPS: Final = 2


def warm_up_all() -> None:
    """Compile what training, planning, mapping and simulation call, and print how long each part took."""
    logging.getLogger("offpiste.kernel_cache").setLevel(logging.WARNING)  # it would advise what is being done
    with tempfile.TemporaryDirectory() as folder:
        parts: dict[str, Callable[[], object]] = {
            "training": compile_training,
            "mapping and planning": partial(rehearse_part, PLAN, _unreported, run=MODEL, folder=Path(folder)),
        }
        if find_spec("mujoco") is not None:
            for name, part in (("simulation", RECORD), ("extraction", EXTRACT)):
                parts[name] = partial(rehearse_part, part, _unreported, run=MODEL, folder=Path(folder))
        for number, (name, compile_part) in enumerate(parts.items(), start=1):
            show(f"[{number}/{len(parts)}] {name} ...")
            began = time.perf_counter()
            with redirect_stdout(io.StringIO()):  # results of a drive that nobody asked for
                compile_part()
            show(f"[{number}/{len(parts)}] {name}: {time.perf_counter() - began:.0f} s")
    show(f"kept in {cache_folder() / 'kernels'}")
    if forgotten := forget_unused(cache_folder()):
        show(f"removed {len(forgotten)} of its entries that nothing has used for {KEPT_DAYS:.0f} days")


def compile_training() -> None:
    """Roll a model and its actuators out and back, with codes of two cells; and the model over a map of one."""
    vehicle = Vehicle(1000.0, 2.0, 0.5, CONTROL, ACTUATORS, features=2)
    encoder = Compressor(vehicle.features)
    model, lags = Hybrid(vehicle, encoder=encoder), Actuators(vehicle)
    model.actuators.requires_grad_(False)
    state, actuators = torch.zeros(1, 6), torch.zeros(1, len(ACTUATORS))
    controls, recurrent = torch.zeros(1, STEPS, len(CONTROL)), torch.zeros(1, model.recurrent_size)
    codes = encode_cells(encoder, torch.zeros(2, vehicle.features), torch.ones(2, dtype=torch.bool))
    level = Terrain.of(torch.tensor([0.0, 0.0, 1.0]).expand(1, STEPS, 4, 3))
    ground = Terrain(level.normal, level.known, codes_under_wheels(codes, torch.zeros(1, STEPS, 4, dtype=torch.int64)))
    rollout_recorded(model, ModelState(state, actuators, recurrent, recurrent), controls, ground).state.sum().backward()
    maps = CellStack(
        0.2,
        torch.zeros(1, 2, dtype=torch.float64),
        torch.zeros(1, 2, dtype=torch.int64),
        torch.zeros(1, 1, 1, dtype=torch.int32),
        torch.zeros(1, 2, dtype=torch.float16),
        torch.zeros(1, vehicle.features, dtype=torch.float16),
    )
    terrain = MapTerrain(
        maps,
        torch.zeros(1, dtype=torch.int64),
        torch.zeros(1, 2, dtype=torch.float64),
        torch.zeros(4, 2),
        encoder,
    )
    with torch.no_grad():
        predict_on(model, ModelState(state, actuators, recurrent, recurrent), controls, terrain)
    units = torch.zeros(1, lags.hidden)
    rollout_actuators(lags, controls, torch.zeros(1, STEPS), actuators, units, units).sum().backward()


def _unreported(share: float) -> None:
    """No progress within a part."""
