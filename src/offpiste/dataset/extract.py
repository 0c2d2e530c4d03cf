"""Extract a dataset from logs: the split is made once, every drive is extracted by itself, several at a time.

A drive is read, brought to 50 Hz, given its ground, and written whole or not at all.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from offpiste.core.conventions import DT, FEATURE_SETS, MIN_EVALUATION_SPEED, min_evaluation_speed
from offpiste.core.errors import DatasetError, OffpisteError
from offpiste.core.files import remove_partials, temporary_folder
from offpiste.core.object_store import brought, expanded
from offpiste.core.parallel import Report, at_a_time, run_all
from offpiste.dataset.ground_truth_features import LAYERS, FeatureSource, truth_map, with_ground_truth
from offpiste.dataset.log_findings import LogFinding, UnusableLog, findings_on, refuse_unusable
from offpiste.dataset.map_snapshots import SnapshotSchedule, SnapshotSettings, SnapshotWriter
from offpiste.dataset.place import drive_names, remove_if_empty, working_copy
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.split_balance import fitting_split, split_warning
from offpiste.dataset.splits import PARTS, Split, empty_parts, parse_split, refuse_places_without_origin, stored_split
from offpiste.dataset.store import Dataset, StoredDrive, add_drive, create, open_dataset
from offpiste.dataset.visual_features import SnapshotKeeper, with_visual_features
from offpiste.dataset.window_starts import MIN_HINDSIGHT, evaluation_starts
from offpiste.logs.drive import drive_from_log, drive_name
from offpiste.logs.log import open_log
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.replay import MapperSettings
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.rig.rig import Rig

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Job:
    """What a process needs to extract one drive (`make_dataset`)."""

    log: Path
    name: str
    rig: Rig
    out: Path
    split: Split
    features: FeatureSource = "none"
    pca: Path | None = None
    device: str = "cpu"
    min_hindsight: float = 0.0
    snapshots: SnapshotSettings | None = None
    replay: MapperSettings | None = None
    force: bool = False


def extract_drive(job: Job, report: Report) -> str:
    """Extract a drive; returns its description.

    Raises:
        UnusableLog: `inspect` finds something fatal in it, and `force` is not given.
        LogError, RigError: the log cannot be read with this rig, or has no ground truth or sensors.
    """
    if job.name in drive_names(job.out):
        return f"{job.name}: already there"  # a worker that was lost had finished it
    with brought(job.log) as log, working_copy(job.out) as out:
        return _extract_here(replace(job, log=log, out=out), report)


def _extract_here(job: Job, report: Report) -> str:
    log = open_log(job.log, clock=job.rig.clock)
    findings = findings_on(log, job.rig)
    if not job.force:
        refuse_unusable(findings, job.log)
    drive = drive_from_log(log, job.rig)
    rows, notes = extract_rows(drive), drive.notes
    if job.pca is not None:
        sensors = open_sensors(log, job.rig)
        notes += sensors.coverage()
        extractor = load_feature_extractor(job.pca, job.device)
        notes += _seen_by_pca(extractor, rows, job)
        replay = job.replay or MapperSettings()
        with temporary_folder(job.out / job.name) as folder:
            settings, size = job.snapshots or SnapshotSettings(), replay.map.voxels.size
            writer = SnapshotWriter(folder / "snapshots", size, extractor.channels, settings.latency)
            schedule = SnapshotSchedule(_starts(rows, job, settings), settings)
            keeper = SnapshotKeeper(writer, schedule, settings, rows, sensors.poses)
            rows = with_visual_features(rows, sensors, job.rig, extractor, replay, snapshots=keeper, report=report)
            keeper.close()
            stored = add_drive(
                job.out,
                job.name,
                rows,
                job.split,
                notes + sensors.notes,
                snapshots=folder / "snapshots",
                findings=findings,
            )
        return described(stored, job.split, job.min_hindsight, min_evaluation_speed(job.rig.vehicle.wheelbase))
    terrain = None
    if job.features != "none":
        rows, terrain = with_ground_truth(rows, truth_map(job.log, LAYERS[job.features]), job.rig)
    stored = add_drive(job.out, job.name, rows, job.split, notes, terrain, findings=findings)
    return described(stored, job.split, min_speed=min_evaluation_speed(job.rig.vehicle.wheelbase))


def _seen_by_pca(extractor: FeatureExtractor, rows: Rows, job: Job) -> tuple[str, ...]:
    """A warning if the PCA was fitted on rows that are for validation or test here."""
    about = extractor.pca.fitted_on
    if job.name not in about.get("logs", ()):
        return ()
    position = rows.state[:, :2] + rows.origin
    try:
        # The parts of drives count as they were then: their file may say something else by now.
        fitted = stored_split(str(about.get("split")), about.get("split_drives", ())).label(job.name, position) == 0
    except DatasetError:
        fitted = np.ones(len(position), bool)
    seen = float((fitted & (job.split.label(job.name, position) > 0)).sum() * DT)
    if not seen:
        return ()
    return (f"warning: the PCA may have seen {seen:.0f} s that validate or test here; give fit-pca the same --split",)


def _starts(rows: Rows, job: Job, settings: SnapshotSettings) -> list[Bool[np.ndarray, " N"]]:
    """Rows at which windows start, for each part that gets snapshots."""
    usual = min_evaluation_speed(job.rig.vehicle.wheelbase)
    speed = usual if settings.min_speed is None else settings.min_speed
    part = job.split.label(job.name, rows.state[:, :2] + rows.origin)
    result = []
    for number in (PARTS.index(name) for name in settings.parts):
        starts = np.zeros(len(part), bool)
        starts[evaluation_starts(rows, part == number, min_speed=speed)] = True
        result.append(starts)
    return result


def described(
    drive: StoredDrive, split: Split, min_hindsight: float = 0.0, min_speed: float = MIN_EVALUATION_SPEED
) -> str:
    """A drive as stored, in a few lines."""
    rows = drive.rows
    mine = [drive.part == number for number in range(len(PARTS))]
    windows = [len(evaluation_starts(rows, part, min_hindsight, min_speed)) for part in mine]
    share = ", ".join(f"{count} {part}" for count, part in zip(windows, PARTS, strict=True))
    lines = [
        f"{drive.name}: {len(rows.time) / 50:.0f} s, {rows.distance / 1000:.2f} km, "
        f"{rows.valid.mean():.1%} of the rows complete; windows above {min_speed:.3g} m/s: {share}"
    ]
    wanted = [count for part, count in zip(PARTS, windows, strict=True) if part not in empty_parts(split)]
    if split.kind in ("blocks", "fold") and min(wanted) == 0:
        other = fitting_split([drive], min_hindsight, min_speed)
        how = f"extract again, into another --out, with --split {other.text}" if other else "record two minutes or more"
        lines.append(
            f"  warning: too short or slow for {split.text}: a part has no window, so `train` refuses it alone; {how},"
            " or several drives with --split drives:FILE"
        )
    if rows.cells is not None and len(rows.cells.valid) == len(FEATURE_SETS):
        rates = zip(FEATURE_SETS, rows.cells.valid.mean(axis=1), strict=True)
        lines.append("  valid by distance: " + ", ".join(f"{name} {rate:.2f}" for name, rate in rates))
        unseen = sum(len(evaluation_starts(rows, part, min_speed=min_speed)) for part in mine) - sum(windows)
        if unseen:
            lines.append(f"  {unseen} windows left out: less than {min_hindsight:.0%} of their ground was ever seen")
    if drive.snapshots is not None and len(drive.snapshots.row):
        count, latency = len(drive.snapshots.row), drive.snapshots.latency
        lines.append(f"  {count} snapshots of the map, of what was measured {latency:g} s before their windows start")
    lines += [f"  {_level(finding)}: {finding.line}" for finding in drive.findings]
    return "\n".join(lines + [f"  {note}" for note in drive.notes])


def _level(finding: LogFinding) -> str:
    return "FATAL, extracted by --force" if finding.severity == "fatal" else "warning"


def make_dataset(
    logs: Sequence[str | Path],
    rig: Rig,
    out: Path,
    *,
    split: str = "blocks:0.7,0.1,0.2",
    features: FeatureSource = "none",
    pca: Path | None = None,
    device: str = "cpu",
    min_hindsight: float = MIN_HINDSIGHT,
    snapshots: SnapshotSettings | None = None,
    replay: MapperSettings | None = None,
    shard: tuple[int, int] = (1, 1),
    processes: int = 1,
    cluster: str = "",
    force: bool = False,
) -> Dataset:
    """Extract drives into a dataset; drives that are in it already are left as they are.

    Args:
        features: true properties of simulated ground (`dataset.ground_truth_features.LAYERS`).
        pca: instead, visual features: a file of `fit-pca`, which names its backbone.
        device: that the backbone runs on.
        min_hindsight: least share of the ground seen in hindsight along a window (`window_starts.enough_hindsight`).
        snapshots, replay: of visual features.
        shard: (K, N): only every Nth of the logs, in the order of their names, beginning with the Kth.
        processes: drives that are extracted at a time; 0: one a core, or one where the backbone runs on a GPU.
        cluster: address of a Ray cluster that extracts instead (`parallel.run_all`); "" for none.
        force: extract logs with fatal findings of `inspect`, too.

    Raises:
        UnusableLog: `inspect` finds something fatal in a log; the others are extracted.
        LogError, RigError: a log cannot be read with this rig, or has no ground truth; the others are extracted.
        DatasetError: two logs of one name, another dataset at `out`, or several logs that cannot be extracted.
    """
    logs = expanded(logs)
    names = names_of(logs)
    mine = set(sorted(names)[shard[0] - 1 :: shard[1]])
    if not mine:
        raise DatasetError(f"{len(names)} logs have no shard {shard[0]}/{shard[1]}", how="give fewer shards")
    refuse_places_without_origin(parts := parse_split(split), rig)
    if empty := empty_parts(parts):
        logger.warning(f"the split {split} leaves nothing for {' and '.join(empty)}: {_useless(empty)}")
    if pca is not None and features != "none":
        raise DatasetError(f"both a PCA and '{features}' features are given", how="leave out one of them")
    if not 0 <= min_hindsight <= 1:
        raise DatasetError(f"min-hindsight is {min_hindsight:g}", how="give a share from 0 to 1")
    extractor = load_feature_extractor(pca, device) if pca is not None else None
    with working_copy(out) as place:
        if extractor is None:
            create(place, rig, parts, LAYERS[features])
        else:
            kept, mapper = snapshots or SnapshotSettings(), replay or MapperSettings()
            create(place, rig, parts, extractor.names, extractor.identity, min_hindsight, kept, mapper)
    done = set(drive_names(out))
    if strangers := sorted({name for name, _ in parts.drives} - {*names, *done}):
        logger.warning(f"the split {split} names {_some(strangers)}: no log and no drive of {out} is called so")
    for name in (name for name in names if name in done & mine):
        logger.info(f"{name}: already there")
    jobs = [
        Job(Path(log), name, rig, out, parts, features, pca, device, min_hindsight, snapshots, replay, force)
        for log, name in zip(logs, names, strict=True)
        if name not in done and name in mine
    ]
    try:
        failed = run_all(extract_drive, jobs, at_a_time(processes, device), "extract", cluster=cluster).failed
        remove_partials(out)  # of workers that were lost
    finally:
        remove_if_empty(out)  # all logs failed
    _refuse_failed(failed, out)
    dataset = open_dataset(out)
    if shard[1] == 1 and (line := split_warning(dataset)) is not None:
        logger.warning(line)
    return dataset


def names_of(logs: Sequence[str | Path]) -> list[str]:
    """Names of the drives; each has its own.

    Raises:
        DatasetError: no log, or two of one name.
    """
    if not logs:
        raise DatasetError("no log is given", how="name one or more logs")
    names = [drive_name(log) for log in logs]
    for name in names:
        if names.count(name) > 1:
            raise DatasetError(f"two logs are called '{name}'", how="rename one of them")
    return names


def _some(names: Sequence[str]) -> str:
    """The first of many names."""
    return ", ".join(f"'{name}'" for name in names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _log_of(error: OffpisteError) -> str:
    return Path(error.where).name or error.what


def _useless(empty: Sequence[str]) -> str:
    return "models cannot be " + " or ".join(
        [*(["trained"] if {"train", "validation"} & set(empty) else []), *(["evaluated"] if "test" in empty else [])]
    )


def _refuse_failed(failed: Sequence[OffpisteError], out: Path) -> None:
    unusable = [error for error in failed if isinstance(error, UnusableLog)]
    for error in unusable:
        if len(error.findings) > 1 or len(failed) > 1:
            for finding in error.findings:
                logger.error(f"{error.where}: {finding.line}")
    if len(failed) == 1:
        raise failed[0]
    if failed:
        raise DatasetError(
            f"{len(failed)} logs could not be extracted (see above); the others were",
            where=out,
            how=f"fix or leave out {_some([_log_of(e) for e in failed])} and run it again: it resumes where it stopped",
        )
