"""Fit of the actuators' delay models, cached for all runs under a digest of its inputs.

The result depends on dataset, vehicle, settings of the stage and seed, but not on the model to train. An entry of the
user's cache is one safetensors file with its own digest, written whole or not at all.
"""

import logging
import platform
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
import torch

from offpiste.core.cache import cache_folder
from offpiste.core.checksums import sha256_of_arrays
from offpiste.core.errors import RunError
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Vehicle
from offpiste.dynamics.actuator_lags import lagging_of
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.kernels.actuators import supports_actuators
from offpiste.dynamics.models import initial_actuators
from offpiste.native.compilation import sources_digest, target_machine
from offpiste.training.checkpoint import load_tensors, save_tensors
from offpiste.training.config import TrainConfig
from offpiste.training.distributed import ALONE, Group
from offpiste.training.loop import BestEpoch, Record, Stage, metrics_of, run_stage, write_metrics
from offpiste.training.losses import FITTED_STEPS, actuator_loss

logger = logging.getLogger(__name__)

NAME: Final = "actuators"
"""Name of the stage, and stem of its files."""

LARGEST_EPOCH: Final = 100_000
"""Approximate largest number of windows per epoch; of more windows, only some are used, evenly spread."""

LARGEST_BATCH: Final = 1024
"""Largest batch; a GPU's larger batches would leave too few steps."""

FORMAT: Final = 1
"""Version of an entry and of its digest."""

SETTINGS: Final = (
    "actuator_epochs", "batch", "stride", "learning_rate", "constants_learning_rate", "gradient_clip", "start", "seed",
    "device",
)  # fmt: skip
"""Settings that the result depends on."""

SOURCES: Final = (
    "dynamics", "training", "dataset/windows.py", "dataset/window_starts.py", "dataset/columns",
    "dataset/features_under_wheels.py", "core/channels.py", "core/conventions.py", "native/compilation.py",
)  # fmt: skip
"""Code that the result depends on, relative to the package."""


def actuators_to_fit(vehicle: Vehicle, config: TrainConfig, device: torch.device, group: Group) -> Actuators:
    """Return untrained actuators; on the CPU where its kernels support them, since a GPU would step eagerly."""
    lags = initial_actuators(vehicle, config.seed)
    alone = group.size == 1 and supports_actuators(lags, torch.device("cpu"), torch.float32)
    return lags if alone else lags.to(device)


def fit_actuators(
    actuators: Actuators,
    config: TrainConfig,
    windows: Windows,
    validation: Windows,
    folder: Path,
    record: Record,
    group: Group = ALONE,
) -> BestEpoch:
    """Fit the actuators' models in place, or load the result of an earlier run with the same digest.

    Raises:
        TrainingError: as `run_stage`.
    """
    device = actuators.raw.device
    fitted, validated = (part.without_terrain(FITTED_STEPS, device) for part in (windows, validation))
    stride, batch = max(config.stride, -(-len(windows) // LARGEST_EPOCH)), min(config.batch, LARGEST_BATCH)
    config = replace(config, stride=stride, batch=batch, device=str(device))
    key, done = "", (folder / f"{NAME}.safetensors").exists()
    if group.writes and not done:
        key = stage_key(fitted, validated, actuators.vehicle, config, group.size)
        done = take_stage(key, folder)
    group.together(None)
    loss = actuator_loss(actuators, windows.without_terrain(device=device))
    stage = Stage(NAME, actuators, loss, config.actuator_epochs)
    kept = run_stage(stage, fitted, validated, config, folder, record, group)
    if group.writes and not done:
        store_stage(key, folder)
    return kept


def stage_key(windows: Windows, validation: Windows, vehicle: Vehicle, config: TrainConfig, processes: int) -> str:
    """Return the digest of the inputs of the fit: recorded rows, channels, settings, code and machine.

    Args:
        windows, validation: windows of the two parts.
        processes: number of processes that train together, on which rounding depends.
    """
    arrays = windows.motion() | {"rows to train": windows.rows, "rows to validate": validation.rows}
    settings = asdict(config)
    lags = {
        one.label: [one.actuator.name, one.actuator.follows, one.columns, one.lag.residual, *_code_of(one.lag.change)]
        + [[name, *bounds] for name, bounds in one.lag.constants.items()]
        for one in lagging_of(vehicle)
    }
    about = {
        "format": FORMAT,
        "settings": {name: settings[name] for name in SETTINGS},
        "horizon": windows.horizon,
        "channels": [vehicle.control, vehicle.actuators, vehicle.control_columns, vehicle.actuator_columns],
        "lags": lags,
        "processes": processes,
        "code": sources_digest(SOURCES),
        "versions": [torch.__version__, numba.__version__, np.__version__, platform.python_version()],
        "machine": [target_machine(), torch.backends.cpu.get_cpu_capability()],
    }
    return sha256_of_arrays(arrays, about)


def _code_of(function: Any) -> list[str]:
    """Return the byte code of a function, which may be defined by an extension."""
    code = function.__code__
    return [code.co_code.hex(), repr(code.co_names), repr([c for c in code.co_consts if not hasattr(c, "co_code")])]


def stage_entry(key: str) -> Path:
    """Return the path of a cache entry."""
    return cache_folder() / "stages" / f"{NAME}-{key[:32]}.safetensors"


def take_stage(key: str, run: Path) -> bool:
    """Copy a cached stage into a run, as if it had been fitted there; return False if there is none."""
    entry = stage_entry(key)
    if not entry.is_file():
        return False
    try:
        weights, about = load_tensors(entry)
        if about.get("key") != key:
            raise RunError("belongs to another stage", where=entry)
        metrics, kept = about["metrics"], about["kept"]
    except (RunError, KeyError) as error:
        logger.warning(f"{entry}: cannot be used, so the actuators are fitted again ({error})")
        return False
    # The stage's own file comes last: it marks the stage as done.
    write_metrics(run / "metrics.jsonl", metrics)
    save_tensors(run / f"{NAME}.safetensors", weights, **kept)
    logger.info(f"{NAME}: read from {entry}, fitted before on the same data with the same settings and seed")
    return True


def store_stage(key: str, run: Path) -> None:
    """Add a run's fitted stage to the cache; a cache that cannot be written is ignored."""
    entry = stage_entry(key)
    weights, kept = load_tensors(run / f"{NAME}.safetensors")
    metrics = [line for line in metrics_of(run / "metrics.jsonl") if line["stage"] == NAME]
    try:
        save_tensors(entry, weights, key=key, kept=kept, metrics=metrics)
    except OSError as error:
        logger.info(f"{NAME}: fitted; not cached for other runs ({error})")
    else:
        logger.info(f"{NAME}: fitted, and cached for other runs in {entry}")
