"""Extraction of drives into a dataset: each is read, resampled, given its ground, and written whole or not at all."""

import logging
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from offpiste.core.conventions import DT, FEATURE_SETS, MIN_EVALUATION_SPEED, min_evaluation_speed
from offpiste.core.errors import DatasetError, OffpisteError
from offpiste.core.files import remove_partials, temporary_folder
from offpiste.core.object_store import brought, expanded
from offpiste.core.parallel import Report, at_a_time, run_all
from offpiste.dataset.ground_truth_features import LAYERS, FeatureSource, truth_map, with_ground_truth
from offpiste.dataset.log_findings import LogFinding, UnusableLog, refuse_unusable
from offpiste.dataset.map_snapshots import SNAPSHOT_PARTS, SnapshotSchedule, SnapshotSettings, SnapshotWriter
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.split_balance import fitting_split, split_warning
from offpiste.dataset.splits import PARTS, Split, empty_parts, refuse_places_without_origin, stored_split
from offpiste.dataset.store import Dataset, StoredDrive, add_drive, create, drive_names, open_dataset
from offpiste.dataset.visual_features import SnapshotKeeper, with_visual_features
from offpiste.dataset.window_starts import MIN_HINDSIGHT, evaluation_starts
from offpiste.logs.drive import drive_from_log, drive_name
from offpiste.logs.log import Log, open_log
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.replay import MapperSettings
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.rig.rig import Rig

logger = logging.getLogger(__name__)


def no_findings(log: Log, rig: Rig) -> tuple[LogFinding, ...]:
    """Accept a log without inspection."""
    return ()


@dataclass(frozen=True)
class ExtractSettings:
    """Settings shared by all drives of an extraction (`inspection.extract.extract`)."""

    split: Split
    features: FeatureSource = "none"
    pca: Path | None = None
    device: str = "cpu"
    min_hindsight: float = MIN_HINDSIGHT
    snapshots: SnapshotSettings = field(default_factory=SnapshotSettings)
    replay: MapperSettings = field(default_factory=MapperSettings)
    examine: Callable[[Log, Rig], tuple[LogFinding, ...]] = no_findings
    force: bool = False  # extract logs with fatal findings, too

    def __post_init__(self) -> None:
        if self.pca is not None and self.features != "none":
            raise DatasetError(f"both a PCA and '{self.features}' features are given", how="leave out one of them")
        if not 0 <= self.min_hindsight <= 1:
            raise DatasetError(f"invalid --min-hindsight {self.min_hindsight:g}", how="give a share from 0 to 1")


class Job(NamedTuple):
    """One drive to extract into the dataset `out`."""

    log: Path
    name: str
    rig: Rig
    out: Path
    settings: ExtractSettings

    @property
    def min_speed(self) -> float:
        """Speed above which windows start [m/s]."""
        return min_evaluation_speed(self.rig.vehicle.wheelbase)


def extract_drives(
    logs: Sequence[str | Path],
    rig: Rig,
    out: Path,
    settings: ExtractSettings,
    *,
    shard: tuple[int, int] = (1, 1),
    processes: int = 1,
    cluster: str = "",
) -> Dataset:
    """Extract drives into a dataset (`inspection.extract.extract`)."""
    logs, split = expanded(logs), settings.split
    names = names_of(logs)
    mine = sorted(names)[shard[0] - 1 :: shard[1]]
    if not mine:
        raise DatasetError(f"{len(names)} logs have no shard {shard[0]}/{shard[1]}", how="give fewer shards")
    refuse_places_without_origin(split, rig)
    if empty := empty_parts(split):
        logger.warning(f"the split {split.text} leaves nothing for {' and '.join(empty)}")
    if settings.pca is None:
        create(out, rig, split, LAYERS[settings.features])
    else:
        extractor = load_feature_extractor(settings.pca, settings.device)
        made_by = extractor.names, extractor.identity, settings.min_hindsight, settings.snapshots, settings.replay
        create(out, rig, split, *made_by)
    done = drive_names(out)
    if strangers := sorted({name for name, _ in split.drives} - {*names, *done}):
        named = f"the split {split.text} names {_some(strangers)}"
        logger.warning(f"{named}, but no log and no drive of {out} has that name")
    jobs = []
    for name, log in zip(names, logs, strict=True):
        if name in mine and name in done:
            logger.info(_already_there(name))
        elif name in mine:
            jobs.append(Job(Path(log), name, rig, out, settings))
    try:
        failed = run_all(extract_drive, jobs, at_a_time(processes, settings.device), "extract", cluster=cluster).failed
        remove_partials(out)  # of workers that were lost
    finally:
        if not drive_names(out):  # all logs failed
            shutil.rmtree(out)
    _refuse_failed(failed, out)
    dataset = open_dataset(out)
    if shard[1] == 1 and (line := split_warning(dataset)) is not None:
        logger.warning(line)
    return dataset


def extract_drive(job: Job, report: Report) -> str:
    """Extract a drive and return its description.

    Raises `UnusableLog` for a fatal finding without `force`, `LogError` or `RigError` if the log cannot be read.
    """
    if job.name in drive_names(job.out):
        return _already_there(job.name)  # a lost worker had finished it
    settings, rig, terrain = job.settings, job.rig, None
    with brought(job.log) as path, temporary_folder(job.out / job.name) as folder:
        log = open_log(path, clock=rig.clock)
        findings = settings.examine(log, rig)
        if not settings.force:
            refuse_unusable(findings, path)
        drive = drive_from_log(log, rig)
        rows, notes = extract_rows(drive), drive.notes
        snapshots: Path | None = None
        if settings.features != "none":
            rows, terrain = with_ground_truth(rows, truth_map(path, LAYERS[settings.features]), rig)
        if settings.pca is not None:
            extractor = load_feature_extractor(settings.pca, settings.device)
            snapshots = folder / "snapshots"
            rows, more = _with_visual_features(rows, log, job, extractor, snapshots, report)
            notes += more
        stored = add_drive(job.out, job.name, rows, settings.split, notes, terrain, snapshots, findings)
    return described(stored, settings.split, settings.min_hindsight if settings.pca else 0.0, job.min_speed)


def _with_visual_features(
    rows: Rows, log: Log, job: Job, extractor: FeatureExtractor, snapshots: Path, report: Report
) -> tuple[Rows, tuple[str, ...]]:
    """Return rows with visual features, and notes; write the map at window starts into the folder `snapshots`."""
    settings = job.settings
    sensors = open_sensors(log, job.rig)
    before = sensors.coverage() + pca_overlap(extractor, rows, job)
    size = settings.replay.map.voxels.size
    writer = SnapshotWriter(snapshots, size, extractor.channels, settings.snapshots.latency)
    schedule = SnapshotSchedule(snapshot_starts(rows, job), settings.snapshots)
    keeper = SnapshotKeeper(writer, schedule, settings.snapshots, rows, sensors.poses)
    rows = with_visual_features(rows, sensors, job.rig, extractor, settings.replay, snapshots=keeper, report=report)
    keeper.close()
    return rows, before + sensors.notes


def pca_overlap(extractor: FeatureExtractor, rows: Rows, job: Job) -> tuple[str, ...]:
    """Return a warning if the PCA was fitted on rows of the validation or test part."""
    about = extractor.pca.fitted_on
    if job.name not in about.get("logs", ()):
        return ()
    position = rows.world_xy
    try:
        # Parts as they were at that time: the file of a split by drives may have changed.
        fitted = stored_split(str(about.get("split")), about.get("split_drives", ())).label(job.name, position) == 0
    except DatasetError:
        fitted = np.ones(len(position), bool)
    seen = float((fitted & (job.settings.split.label(job.name, position) > 0)).sum() * DT)
    if not seen:
        return ()
    return (f"warning: the PCA may have seen {seen:.0f} s of validation or test; give fit-pca the same --split",)


def snapshot_starts(rows: Rows, job: Job) -> list[Bool[np.ndarray, " N"]]:
    """Return the rows at which windows start, for each part that gets snapshots."""
    speed = job.settings.snapshots.min_speed
    part = job.settings.split.label(job.name, rows.world_xy)
    result = []
    for name in SNAPSHOT_PARTS:
        starts = np.zeros(len(part), bool)
        mine = part == PARTS.index(name)
        starts[evaluation_starts(rows, mine, min_speed=job.min_speed if speed is None else speed)] = True
        result.append(starts)
    return result


def described(
    drive: StoredDrive, split: Split, min_hindsight: float = 0.0, min_speed: float = MIN_EVALUATION_SPEED
) -> str:
    """Describe a stored drive in a few lines."""
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
        lines.append(f"  {count} snapshots of the map, measured at least {latency:g} s before their windows start")
    for finding in drive.findings:
        level = "FATAL, extracted by --force" if finding.severity == "fatal" else "warning"
        lines.append(f"  {level}: {finding.line}")
    return "\n".join(lines + [f"  {note}" for note in drive.notes])


def names_of(logs: Sequence[str | Path]) -> list[str]:
    """Return the name of each log's drive; raise `DatasetError` without logs, or if two have the same name."""
    if not logs:
        raise DatasetError("no log is given", how="name one or more logs")
    names = [drive_name(log) for log in logs]
    for name in names:
        if names.count(name) > 1:
            raise DatasetError(f"two logs are called '{name}'", how="rename one of them")
    return names


def _already_there(name: str) -> str:
    return f"{name}: already there"


def _some(names: Sequence[str]) -> str:
    """Return the first three of many names."""
    return ", ".join(f"'{name}'" for name in names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _refuse_failed(failed: Sequence[OffpisteError], out: Path) -> None:
    for error in failed:
        if isinstance(error, UnusableLog) and (len(error.findings) > 1 or len(failed) > 1):
            for finding in error.findings:
                logger.error(f"{error.where}: {finding.line}")
    if len(failed) == 1:
        raise failed[0]
    if failed:
        logs = _some([Path(error.where).name or error.what for error in failed])
        raise DatasetError(
            f"{len(failed)} logs could not be extracted (see above); the others were",
            where=out,
            how=f"fix or leave out {logs} and run it again: it resumes where it stopped",
        )
