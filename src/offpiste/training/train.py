"""Trains a model on a dataset, once or by blocked cross-validation: actuators, bicycle, then the whole horizon."""

import json
import logging
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from offpiste.core.checksums import CHECKSUMS, sha256_of, sha256_of_json
from offpiste.core.conventions import DT, STATE
from offpiste.core.errors import DatasetError, OffpisteError, RunError, TrainingError
from offpiste.core.files import check_folder, remove_partials
from offpiste.core.state import Trajectory
from offpiste.dataset.assumptions import assumptions_block, assumptions_of
from offpiste.dataset.feature_sets import Draw, hindsight
from offpiste.dataset.ground_tables import free_budget, ground_tables
from offpiste.dataset.log_findings import warning_line
from offpiste.dataset.split_balance import split_warning
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset
from offpiste.dataset.stored_arrays import changed_arrays
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import MODELS, Dynamics
from offpiste.dynamics.models import reference_of
from offpiste.training.actuator_stage import actuators_to_fit, fit_actuators
from offpiste.training.build import build, vehicle_of
from offpiste.training.checkpoint import load_json, refuse_other_folder, save_json
from offpiste.training.config import TrainConfig, other_settings, refuse_impossible
from offpiste.training.distributed import ALONE, Group
from offpiste.training.kept_epoch import FEW_WINDOWS, KeptEpoch
from offpiste.training.losses import loss_scale, robust, speed_weights, summed_loss
from offpiste.training.map_loss import MapLoss, map_loss
from offpiste.training.mirror import mirror_of
from offpiste.training.optimise import REMEDY, Record, Stage, also_tensorboard, metrics_writer, run_stage
from offpiste.training.prediction import predict
from offpiste.training.run import check_device, save_run
from offpiste.training.terrain_sources import encoded

logger = logging.getLogger(__name__)

STANDARDISED = 4096
"""Windows that means and scales of a network's inputs are taken from."""


def train(
    dataset: Dataset,
    config: TrainConfig,
    folder: Path,
    *,
    resume: bool = False,
    tensorboard: bool = False,
    group: Group = ALONE,
    maps: MapLoss | None = None,
) -> Dynamics:
    """Train one model and write its run folder: config.json, metrics.jsonl, model.safetensors, model.json.

    Args:
        group: the processes that train together; only the first one writes and logs.
        maps: those of the validation windows, where a training before has read them; otherwise they are read here.

    Raises:
        RunError: a setting is out of range, or the folder holds a run: `resume` is false, or settings or data differ.
        DatasetError: a part has no window, there are fewer to train than a batch takes, or no ground was ever seen.
        TrainingError: something is not finite; the last good checkpoint stays.
        OffpisteError: the folder is a file.
    """
    refuse_impossible(config)
    check_folder(folder)
    device, dataset = check_device(config.device), dataset.starting_above(config.min_speed)
    vehicle = vehicle_of(dataset, config)
    dynamics = build(config.model, vehicle, seed=config.seed).to(device)
    ground = ground_tables(dataset, device, free_budget(device))
    windows = Windows(dataset, "train", start=config.start, device=device, ground=ground)
    draw = _draw(config.model, windows)
    _refuse_poor(dynamics, windows, config, dataset)
    validation = Windows(dataset, "validation", start=config.start, device=device, ground=ground)
    group.together(_refusal(folder, dataset, config, resume) if group.writes else None)
    record = _recording(folder, tensorboard=tensorboard) if group.writes else _unrecorded
    if group.writes:
        _warn_beforehand(dataset, validation, config, dynamics)
    kept: dict[str, KeptEpoch] = {}

    def keep(name: str, epoch: KeptEpoch) -> None:
        kept[name] = epoch
        _log_kept(name, epoch, group)

    def fit(stage: Stage, model: Dynamics) -> None:
        read = [w if model.encoder is not None else w.without_features() for w in (windows, validation)]
        keep(stage.name, run_stage(stage, read[0], read[1], config, folder, record, group))

    reference = MODELS[reference_of(vehicle)](vehicle, seed=config.seed).to(device)
    if vehicle.actuators:
        lags = actuators_to_fit(vehicle, config, device, group)
        keep("actuators", fit_actuators(lags, config, windows, validation, folder, record, group))
        _freeze(lags, reference, dynamics)
    scale = loss_scale(reference, windows, config)
    window_loss = _window_loss(windows, config, scale)
    maps, mirror = maps or map_loss(validation, group), mirror_of(windows) if config.mirror else None

    def rolled_out(name: str, model: Dynamics, epochs: int, draw: Draw) -> Stage:
        on_map = None if maps is None else partial(maps.of, model, window_loss)
        return Stage(name, model, lambda batch: window_loss(predict(model, batch), batch), epochs, draw, on_map, mirror)

    if (physics := dynamics.physics()) is not None:
        if physics.actuators is not None:
            physics.actuators.requires_grad_(False)
        fit(rolled_out("bicycle", physics, config.bicycle_epochs, hindsight), physics)  # alike, whatever is drawn after
        dynamics.adopt_physics(physics, learns=config.refit_constants)
    standardise(dynamics, windows)
    if any(p.requires_grad for p in dynamics.parameters()):
        fit(rolled_out("model", dynamics, config.epochs, draw), dynamics)
    if group.writes:
        save_run(folder, dynamics, config, dataset, scale, kept)
    return dynamics


def _window_loss(windows: Windows, config: TrainConfig, scale: Tensor) -> Callable[[Trajectory, Batch], Tensor]:
    """Makes losses of windows, robust and weighted by speed as the settings say, in units of `scale` (`loss_scale`)."""
    weights = torch.tensor(config.weights.in_order(), device=scale.device)
    weigh = speed_weights(windows, config.relative)

    def loss(predicted: Trajectory, batch: Batch) -> Tensor:
        squared = summed_loss(_checked(predicted, batch).state, batch.target, scale, weights)
        return weigh(batch) * robust(squared, config.robust)

    return loss


def _log_kept(stage: str, kept: KeptEpoch, group: Group) -> None:
    if not group.writes:
        return
    logger.info(kept.line(stage))
    for doubt in kept.doubts(stage):
        logger.warning(doubt)


def _warn_beforehand(dataset: Dataset, validation: Windows, config: TrainConfig, dynamics: Dynamics) -> None:
    """Log what speaks against dataset and settings before time is spent; a fold is not to be split otherwise."""
    logger.info(assumptions_block(assumptions_of(dataset)))
    if (line := warning_line(dataset.findings)) is not None:
        logger.warning(line)
    if dynamics.physics() is None and config.bicycle_epochs != TrainConfig.bicycle_epochs:
        logger.warning(f"{config.model} is fitted as a whole: --epochs count, and --bicycle-epochs do not")
    fold = dataset.split.kind == "fold"
    if not fold and (line := split_warning(dataset)) is not None:
        logger.warning(line)
    elif len(validation) < FEW_WINDOWS:
        logger.warning(
            f"the validation part has only {len(validation)} windows, by which epochs are chosen: "
            f"extract more or longer drives{'' if fold else ', or choose another --split'}"
        )


def _recording(folder: Path, *, tensorboard: bool) -> Record:
    """What writes a line of metrics."""
    record = metrics_writer(folder / "metrics.jsonl")
    return also_tensorboard(record, folder / "tensorboard") if tensorboard else record


def _unrecorded(line: dict[str, Any]) -> None:
    """What processes do that do not write."""


def _refusal(folder: Path, dataset: Dataset, config: TrainConfig, resume: bool) -> OffpisteError | None:
    try:
        _claim(folder, dataset, config, resume)
    except OffpisteError as error:
        return error
    return None


def _refuse_poor(dynamics: Dynamics, windows: Windows, config: TrainConfig, dataset: Dataset) -> None:
    if len(windows) < config.batch:
        raise DatasetError(
            f"has {len(windows)} windows to train, fewer than a batch of {config.batch}",
            where=dataset.path,
            how="extract longer or more drives, or give a smaller --batch",
        )
    if dynamics.encoder is not None and not windows.features_at_starts()[1].any():
        raise DatasetError(
            "all terrain features are missing under the wheels where training windows start",
            where=dataset.path,
            how="look at it with `offpiste view`, fix the rig's cameras and LiDARs and extract again, or train `b`",
        )


def _draw(model: str, windows: Windows) -> Draw:
    draw = MODELS[model].draw
    if MODELS[model].needs_sets and windows.sets == 1:
        raise DatasetError(
            f"model '{model}' trains on views by distance and the dataset has none",
            how="extract visual features (`extract --pca`), or train `cf`",
        )
    return draw


def standardise(dynamics: Dynamics, windows: Windows) -> None:
    """Give the networks mean and scale of their inputs on training rows."""
    index = windows.strided(25)
    index = index[np.unique(np.linspace(0, len(index) - 1, min(len(index), STANDARDISED)).astype(int))]
    with torch.no_grad():
        if dynamics.encoder is not None:
            dynamics.encoder.fill_with(*windows.features_at_starts())
        dynamics.standardise_on(encoded(dynamics, windows.gather(index)).history)


def _claim(folder: Path, dataset: Dataset, config: TrainConfig, resume: bool) -> None:
    """Make the run folder, or check that the run in it is this one."""
    described = {"train": asdict(config), "dataset": str(dataset.path.resolve()), "split": dataset.split.text}
    described, data = json.loads(json.dumps(described)), digest_of(dataset)
    path = folder / "config.json"
    if not path.exists():
        refuse_other_folder(folder)
        save_json(path, {**described, "dataset_sha256": data})
        return
    before = load_json(path)
    if other := other_settings(before, described):
        how = "resume with the same, or choose another --out" if resume else "choose another --out"
        raise RunError(f"holds a run that was begun with other settings ({other})", where=folder, how=how)
    if before.get("dataset_sha256", data) != data:
        how = "restore the dataset, or choose another --out"
        raise RunError("holds a run that was begun before the dataset changed", where=folder, how=how)
    if not resume:
        raise RunError("holds a run already", where=folder, how="add --resume, or choose another --out")
    if "dataset_sha256" not in before:
        logger.warning(f"{path}: has no digest of the dataset, since an older offpiste wrote it: changes go unnoticed")
    remove_partials(folder)


def digest_of(dataset: Dataset) -> str:
    """SHA-256 of the checksums of the dataset's settings and drives, which other rows, parts or features change."""
    drives = [dataset.path / drive.name for drive in dataset.drives]
    files = [[file.parent.name, sha256_of(file)] for each in (dataset.path, *drives) for file in each.glob(CHECKSUMS)]
    return sha256_of_json(files + [[each.name, other] for each in drives if (other := changed_arrays(each))])


def _refuse_ground(batch: Batch) -> None:
    """Features are read from disk batch by batch, and not looked at when a dataset is opened."""
    if batch.ground is not None and not torch.isfinite(batch.ground.features[batch.ground.valid]).all():
        raise TrainingError("valid terrain features of the dataset are not finite", how="extract it again")


def _freeze(fitted: nn.Module, *models: Dynamics) -> None:
    """Put the fitted actuator models into models and keep them from training."""
    for actuators in (model.actuators for model in models):
        if actuators is not None:
            actuators.load_state_dict(fitted.state_dict())
            actuators.requires_grad_(False)


def _checked(trajectory: Trajectory, batch: Batch) -> Trajectory:
    """The same, if all of it is finite.

    Raises:
        TrainingError: names the first step and the state that is not, or what of the dataset made it so.
    """
    broken = ~torch.isfinite(trajectory.state).all(dim=0)
    if broken.any():
        _refuse_ground(batch)
        step, column = (int(i) for i in broken.nonzero()[0])
        raise TrainingError(
            f"the predicted {STATE[column]} is not finite from step {step + 1} ({(step + 1) * DT:.2f} s) on",
            how=REMEDY,
        )
    return trajectory


def train_folds(
    dataset: Dataset,
    config: TrainConfig,
    folder: Path,
    *,
    folds: int,
    resume: bool = False,
) -> None:
    """Train one run a fold, in `folder/fold-0`, `folder/fold-1`, ...

    All choose their epochs at recorded places: snapshots of the map are of the windows of the dataset's own split.

    Raises:
        RunError: fewer than three folds, which leave no row for each part; or the folder is one of something else.
    """
    check_folder(folder)
    refuse_other_folder(folder)
    if folds < 3:
        raise RunError(f"{folds} folds", how="cross-validation takes 3 or more")
    if any(drive.snapshots is not None for drive in dataset.drives):
        logger.info("the map was kept for the dataset's own split: folds choose epochs, and are evaluated, without it")
    for number in range(folds):
        logger.info(f"fold {number + 1} of {folds}")
        relabelled = dataset.relabelled(parse_split(f"fold:{number}/{folds}"))
        train(relabelled, config, folder / f"fold-{number}", resume=resume)
