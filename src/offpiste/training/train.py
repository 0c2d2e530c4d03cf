"""Training of a model on a dataset, once or by blocked cross-validation: actuators, bicycle, then the whole model."""

import json
import logging
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

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
from offpiste.training.checkpoint import load_json, refuse_other_folder, save_json
from offpiste.training.config import TrainConfig, other_settings, refuse_impossible
from offpiste.training.distributed import ALONE, Group
from offpiste.training.loop import FEW_WINDOWS, REMEDY, BestEpoch, Stage, metrics_writer, run_stage
from offpiste.training.losses import LOSSES, Loss, MapLoss, WindowLoss, loss_scale, map_loss, squared_errors
from offpiste.training.prediction import encoded, predict_batch
from offpiste.training.run import build, check_device, save_run, vehicle_of

logger = logging.getLogger(__name__)

STANDARDISED = 4096
"""Number of windows used to standardise a network's inputs."""


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
        group: processes that train together; only the first one writes and logs.
        maps: maps of the validation windows if an earlier training has read them; None: they are read here.

    Raises:
        RunError: a setting is out of range; or the folder holds a run and `resume` is false, settings or data differ.
        DatasetError: a part has no window, fewer training windows than a batch, or no visible ground.
        TrainingError: a value is not finite; the last good checkpoint stays.
        OffpisteError: the folder is a file.
    """
    refuse_impossible(config)
    loss = LOSSES[config.loss]
    check_folder(folder)
    device, dataset = check_device(config.device), dataset.starting_above(config.min_speed)
    vehicle = vehicle_of(dataset, config)
    dynamics = build(config.model, vehicle, seed=config.seed).to(device)
    ground = ground_tables(dataset, device, free_budget(device))
    windows = Windows(dataset, "train", start=config.start, device=device, ground=ground)
    _refuse_poor(dynamics, windows, config)
    validation = Windows(dataset, "validation", start=config.start, device=device, ground=ground)
    group.together(_refusal(folder, dataset, config, resume) if group.writes else None)
    record = metrics_writer(folder, tensorboard=tensorboard) if group.writes else lambda line: None
    if group.writes:
        _warn_beforehand(dataset, validation, config, dynamics)
    best: dict[str, BestEpoch] = {}

    def keep(name: str, epoch: BestEpoch) -> None:
        best[name] = epoch
        if group.writes:
            logger.info(epoch.line(name))
            for warning in epoch.warnings(name):
                logger.warning(warning)

    reference = MODELS[reference_of(vehicle)](vehicle, seed=config.seed).to(device)
    if vehicle.actuators:
        lags = actuators_to_fit(vehicle, config, device, group)
        keep("actuators", fit_actuators(lags, config, windows, validation, folder, record, group))
        for actuators in (model.actuators for model in (reference, dynamics)):
            if actuators is not None:
                actuators.load_state_dict(lags.state_dict())
                actuators.requires_grad_(False)
    scale = loss_scale(reference, windows, config)
    window_loss = _window_loss(loss, config, scale)
    maps = maps or map_loss(validation, group)

    def fit(name: str, model: Dynamics, epochs: int, draw: Draw) -> None:
        def loss(batch: Batch) -> Tensor:
            return window_loss(predict_batch(model, batch), batch)

        on_map = None if maps is None else partial(maps.of, model, window_loss)
        stage, parts = Stage(name, model, loss, epochs, draw, on_map), (windows, validation)
        fitted, validated = (part if model.encoder is not None else part.without_features() for part in parts)
        keep(name, run_stage(stage, fitted, validated, config, folder, record, group))

    if (physics := dynamics.physics()) is not None:
        if physics.actuators is not None:
            physics.actuators.requires_grad_(False)
        # Always on hindsight, so that all models of a seed share the result.
        fit("bicycle", physics, config.bicycle_epochs, hindsight)
        dynamics.adopt_physics(physics, learns=config.refit_constants)
    standardise(dynamics, windows)
    if any(p.requires_grad for p in dynamics.parameters()):
        fit("model", dynamics, config.epochs, MODELS[config.model].draw)
    if group.writes:
        save_run(folder, dynamics, config, dataset, scale, best)
    return dynamics


def _window_loss(loss: Loss, config: TrainConfig, scale: Tensor) -> WindowLoss:
    """Return the loss of windows, weighted by component, in units of `scale` (`loss_scale`).

    It raises TrainingError, naming the first state that is not finite, or the fault in the dataset.
    """
    weights = torch.tensor(config.weights.in_order(), device=scale.device) / scale

    def of_windows(predicted: Trajectory, batch: Batch) -> Tensor:
        broken = ~torch.isfinite(predicted.state).all(dim=0)
        if broken.any():
            ground = batch.ground  # opening a dataset does not check its features
            if ground is not None and not torch.isfinite(ground.features[ground.valid]).all():
                raise TrainingError("valid terrain features of the dataset are not finite", how="extract it again")
            step, column = (int(i) for i in broken.nonzero()[0])
            when = f"from step {step + 1} ({(step + 1) * DT:.2f} s) on"
            raise TrainingError(f"the predicted {STATE[column]} is not finite {when}", how=REMEDY)
        squared = squared_errors(predicted.state, batch.target)
        return loss(squared, weights.to(squared.device))

    return of_windows


def _warn_beforehand(dataset: Dataset, validation: Windows, config: TrainConfig, dynamics: Dynamics) -> None:
    """Log warnings about dataset and settings before the training starts; folds are not warned about their split."""
    logger.info(assumptions_block(assumptions_of(dataset)))
    if (line := warning_line(dataset.findings)) is not None:
        logger.warning(line)
    if dynamics.physics() is None and config.bicycle_epochs != TrainConfig.bicycle_epochs:
        logger.warning(f"{config.model} has no bicycle stage: --bicycle-epochs has no effect, --epochs has")
    fold = dataset.split.kind == "fold"
    if not fold and (line := split_warning(dataset)) is not None:
        logger.warning(line)
    elif len(validation) < FEW_WINDOWS:
        logger.warning(
            f"the validation part, by which epochs are chosen, has only {len(validation)} windows: "
            f"extract more or longer drives{'' if fold else ', or choose another --split'}"
        )


def _refuse_poor(dynamics: Dynamics, windows: Windows, config: TrainConfig) -> None:
    """Raise `DatasetError` if the dataset lacks the feature sets, windows or features that a training needs."""
    what = how = ""
    if MODELS[config.model].needs_sets and windows.sets == 1:
        what = f"has no views by distance, on which model '{config.model}' is trained"
        how = "extract visual features (`extract --pca`), or train `cf`"
    elif len(windows) < config.batch:
        what = f"has {len(windows)} training windows, fewer than a batch ({config.batch})"
        how = "extract longer or more drives, or give a smaller --batch"
    elif dynamics.encoder is not None and not windows.features_at_starts()[1].any():
        what = "all terrain features are missing under the wheels where training windows start"
        how = "look at it with `offpiste view`, fix the rig's cameras and LiDARs and extract again, or train `b`"
    if what:
        raise DatasetError(what, where=windows.dataset.path, how=how)


def standardise(dynamics: Dynamics, windows: Windows) -> None:
    """Standardise the networks' inputs on training rows."""
    index = windows.strided(25)
    index = index[np.unique(np.linspace(0, len(index) - 1, min(len(index), STANDARDISED)).astype(int))]
    with torch.no_grad():
        if dynamics.encoder is not None:
            dynamics.encoder.fill_with(*windows.features_at_starts())
        dynamics.standardise_on(encoded(dynamics, windows.gather(index)).history)


def _refusal(folder: Path, dataset: Dataset, config: TrainConfig, resume: bool) -> OffpisteError | None:
    """Create the run folder, or check that it holds this run; return the error if it does not."""
    described = {"train": asdict(config), "dataset": str(dataset.path.resolve()), "split": dataset.split.text}
    described, path = json.loads(json.dumps(described)), folder / "config.json"
    try:
        data = digest_of(dataset)
        if not path.exists():
            refuse_other_folder(folder)
            save_json(path, {**described, "dataset_sha256": data})
            return None
        before = load_json(path)
    except OffpisteError as error:
        return error
    if other := other_settings(before, described):
        how = "resume with the same, or choose another --out" if resume else "choose another --out"
        return RunError(f"holds a run that was begun with other settings ({other})", where=folder, how=how)
    if before.get("dataset_sha256") != data:
        how = "restore the dataset, or choose another --out"
        return RunError("holds a run that was begun before the dataset changed", where=folder, how=how)
    if not resume:
        return RunError("holds a run already", where=folder, how="add --resume, or choose another --out")
    remove_partials(folder)
    return None


def digest_of(dataset: Dataset) -> str:
    """SHA-256 of the checksums of a dataset's settings and drives, which depend on rows, parts and features."""
    drives = [dataset.path / drive.name for drive in dataset.drives]
    files = [[file.parent.name, sha256_of(file)] for each in (dataset.path, *drives) for file in each.glob(CHECKSUMS)]
    return sha256_of_json(files + [[each.name, other] for each in drives if (other := changed_arrays(each))])


def train_folds(dataset: Dataset, config: TrainConfig, folder: Path, *, folds: int, resume: bool = False) -> None:
    """Train one run per fold, in `folder/fold-0`, `folder/fold-1`, ...

    Epochs are chosen at recorded places, since snapshots of the map exist for the dataset's own split only.

    Raises:
        RunError: fewer than three folds, or the folder holds other files.
    """
    check_folder(folder)
    refuse_other_folder(folder)
    if folds < 3:
        raise RunError(f"{folds} folds", how="cross-validation takes 3 or more")
    if any(drive.snapshots is not None for drive in dataset.drives):
        logger.info("snapshots of the map are of the dataset's own split: folds are trained and evaluated without them")
    for number in range(folds):
        logger.info(f"fold {number + 1} of {folds}")
        relabelled = dataset.relabelled(parse_split(f"fold:{number}/{folds}"))
        train(relabelled, config, folder / f"fold-{number}", resume=resume)
