"""Twins: whether a model tells one ground from another as the simulator does, from one start under the same commands.

Test drives are recorded once more, every message the same but for what cameras and LiDARs see: the same hills on other
ground. So two maps show the same places with other looks, all else being equal, and `b` cannot tell them apart.
The simulator says where the vehicle would have gone there, parting from the drive at each window's start.
"""

import logging
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from experiments.control_experiments.branches import branches_of, load_branches, record_on, save_branches, twin_worlds
from experiments.control_experiments.data import claim_drives, driven_dataset, oracle_dataset
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.sensitivity import Differences, draw_sensitivity, sensitivity, sensitivity_table
from experiments.control_experiments.tables import write_control
from offpiste.conventions import DT
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.errors import RunError
from offpiste.evaluation.errors import trajectories
from offpiste.geometry import planar_body_from_world
from offpiste.reproduction.data import PlannedDrive, drive_settings
from offpiste.reproduction.gains import same_windows
from offpiste.simulation.simulate import DriveSettings
from offpiste.training.run import Run, load_run

logger = logging.getLogger("experiments")


def twins_control(of: Reproduced, out: Path, *, drives: int, seconds: float, oracle: Path | None) -> Path:
    """Record twins of test drives, and compare what models predict on both grounds with what the simulator says.

    Args:
        drives: how many of the test drives; those of other worlds come first.
        seconds: of each, from its beginning [s].
        oracle: folder of the `oracle` control, for its run and its dataset of the same drives.
    """
    folder = out / "twins"
    chosen = [PlannedDrive(settings_of(of, name, seconds), "test") for name in _spread_out(of.dataset, drives)]
    claim_drives(folder, chosen)
    for drive in chosen:
        log, kept = folder / "logs" / f"{drive.name}.mcap", folder / "branches" / f"{drive.name}.safetensors"
        if not (log.exists() and kept.exists()):
            logger.info(f"driving {drive.name} once more")
            world, ground = twin_worlds(drive.settings)
            if not kept.exists():
                save_branches(kept, branches_of(drive.settings, world, ground, _snapshot_rows(of.dataset, drive.name)))
            record_on(drive.settings, world, ground, log)
    rig, snapshot_seconds = of.dataset.rig, of.size.snapshot_seconds
    other = driven_dataset(chosen, folder, pca=of.pca, snapshot_seconds=snapshot_seconds, min_hindsight=0.0, rig=rig)
    result: dict[str, Differences] = {}
    for model in ("b", *of.present(("cf", "dc"))):
        runs = of.runs(model)
        result[model] = _mean([_compared(run, of.dataset, other, folder / "branches") for run in runs])
    if oracle is not None and (oracle / "runs" / "df-0" / "model.json").exists():
        logs = [folder / "logs" / f"{drive.name}.mcap" for drive in chosen]
        truth = oracle_dataset(logs, f"drives:{folder / 'parts.txt'}", folder / "truth.zarr", rig)
        run, own = load_run(oracle / "runs" / "df-0"), open_dataset(oracle / "dataset.zarr")
        result["oracle"] = _compared(run, own, truth, folder / "branches", like=result["b"], names=of.dataset)
    measured = [sensitivity(model, differences) for model, differences in result.items()]
    return write_control(
        folder,
        [sensitivity_table(measured)],
        {"control": "twins", "sensitivity": measured},
        {"twins": draw_sensitivity(result, measured)},
    )


def settings_of(of: Reproduced, name: str, seconds: float) -> DriveSettings:
    """The settings of a reproduction's drive, from its name PRESET-SEED."""
    preset, _, seed = name.rpartition("-")
    recorded = next(drive for drive in of.dataset.drives if drive.name == name)
    return drive_settings(of.size, preset, int(seed), min(seconds, DT * len(recorded.rows.time)), of.contrast)


def _snapshot_rows(dataset: Dataset, name: str) -> Int[np.ndarray, " n"]:
    """Rows of a drive at which windows have a map: rows and steps are the same, a drive's log begins with it.

    Raises:
        RunError: the drive has no snapshots.
    """
    snapshots = next(drive.snapshots for drive in dataset.drives if drive.name == name)
    if snapshots is None:
        raise RunError(f"drive '{name}' has no snapshots of the map", where=dataset.path, how="extract it again")
    return snapshots.row


def _spread_out(dataset: Dataset, count: int) -> list[str]:
    """Names of test drives, one of each kind of world first."""
    names = [drive.name for drive in dataset.drives if (drive.part == 2).any()]
    worlds = [name.rpartition("-")[0] for name in names]
    order = sorted(range(len(names)), key=lambda i: (worlds[:i].count(worlds[i]), i))
    return sorted(names[i] for i in order[:count])


def _compared(
    run: Run,
    own: Dataset,
    other: Dataset,
    branches: Path,
    *,
    like: Differences | None = None,
    names: Dataset | None = None,
) -> Differences:
    """Predicted and simulated differences on the windows that both grounds have maps for.

    Args:
        like: other differences whose windows are taken; `names` is the dataset that their drives are numbered in.
    """
    here, there = Windows(own, "test"), Windows(other, "test")
    index = _both(here, there, like, names)
    simulated, ok = _simulated(here, index, own, branches)
    index = index[ok]
    yaw = here.gather(index).state[:, 2].numpy()
    ends = [
        trajectories(run.dynamics, windows, which, lookup="map")[:, -1, :2]
        for windows, which in ((here, index), (there, same_windows(here, index, there)))
    ]
    predicted = ends[1] - ends[0]
    names_of = names or own
    drive = np.array([[d.name for d in names_of.drives].index(here.drive_names[d]) for d in here.drive[index]])
    return Differences(
        drive,
        here.row_in_drive(index),
        planar_body_from_world(simulated[ok], yaw),
        planar_body_from_world(predicted, yaw),
    )


def _both(here: Windows, there: Windows, like: Differences | None, names: Dataset | None) -> Int[np.ndarray, " n"]:
    """Windows with a map on both grounds, or those of other differences."""
    if like is not None and names is not None:
        wanted = {(names.drives[d].name, int(r)) for d, r in zip(like.drive, like.row, strict=True)}
        able = np.ones(len(here), bool)
    else:
        snapped = np.flatnonzero(there.maps.snapped)
        wanted = set(_keys(there, snapped))
        able = here.maps.snapped
    keys = _keys(here, np.arange(len(here)))
    return np.flatnonzero(able & np.array([key in wanted for key in keys]))


def _keys(windows: Windows, index: Int[np.ndarray, " n"]) -> list[tuple[str, int]]:
    rows = windows.row_in_drive(index).tolist()
    return [(windows.drive_names[d], row) for d, row in zip(windows.drive[index], rows, strict=True)]


def _simulated(
    windows: Windows, index: Int[np.ndarray, " n"], dataset: Dataset, folder: Path
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """What the simulator says of windows, in the world frame, and for which of them it says something.

    Raises:
        RunError: the drive was not the one that was recorded.
    """
    result = np.full((len(index), 2), np.nan)
    row = windows.row_in_drive(index)
    for number in np.unique(windows.drive[index]):
        mine = np.flatnonzero(windows.drive[index] == number)
        branches = load_branches(folder / f"{windows.drive_names[number]}.safetensors")
        rows = dataset.drives[number].rows
        driven = rows.state[row[mine], :2] + rows.origin
        off = np.hypot(*(driven - branches.path[row[mine]]).T)
        if np.median(off) > 0.2:
            raise RunError(
                f"drive '{windows.drive_names[number]}' takes another path now ({np.median(off):.1f} m apart)",
                where=dataset.path,
                how=f"delete {folder.parent}, or else simulate and extract the reproduction again with this version",
            )
        place = np.searchsorted(branches.step, row[mine]).clip(max=len(branches.step) - 1)
        exact = branches.step[place] == row[mine]
        result[mine[exact]] = branches.difference()[place[exact]]
    return result, np.isfinite(result).all(axis=1)


def _mean(runs: list[Differences]) -> Differences:
    first = runs[0]
    return Differences(first.drive, first.row, first.simulated, np.mean([run.predicted for run in runs], axis=0))
