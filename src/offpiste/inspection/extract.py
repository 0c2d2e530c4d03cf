"""Extraction of datasets from inspected logs."""

from collections.abc import Sequence
from pathlib import Path

from offpiste.dataset.extract import ExtractSettings, extract_drives
from offpiste.dataset.ground_truth_features import FeatureSource
from offpiste.dataset.log_findings import LogFinding
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset
from offpiste.dataset.window_starts import MIN_HINDSIGHT
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.log import Log
from offpiste.mapping.replay import MapperSettings
from offpiste.rig.rig import Rig


def findings_on(log: Log, rig: Rig) -> tuple[LogFinding, ...]:
    """Return the fatal findings and warnings on a log's channels; cameras and LiDARs are not examined."""
    found = inspect_log(log, rig).findings
    return tuple(LogFinding(f.severity, f.where, f.what, f.evidence, f.remedy) for f in found if f.severity != "note")


def extract(
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
    """Inspect logs and extract the usable ones into a dataset; existing drives are kept.

    Args:
        features: true ground properties of a simulated log (`dataset.ground_truth_features.LAYERS`).
        pca: `fit-pca` file for visual features instead; it names its backbone.
        device: of the backbone.
        min_hindsight: minimum share of a window's ground with hindsight features.
        snapshots, replay: map settings for visual features.
        shard: (K, N) extracts every Nth log in order of names, starting with the Kth.
        processes: number of drives extracted in parallel; 0: one per core, or one if the backbone runs on a GPU.
        cluster: address of a Ray cluster for the extraction (`parallel.run_all`); "" for none.
        force: extract logs with fatal findings, too.

    Raises:
        UnusableLog: a log has a fatal finding; the others are extracted.
        LogError, RigError: a log cannot be read with this rig, or has no ground truth; the others are extracted.
        DatasetError: two logs share a name, `out` is another dataset, or several logs failed.
    """
    settings = ExtractSettings(
        parse_split(split),
        features,
        pca,
        device,
        min_hindsight,
        snapshots or SnapshotSettings(),
        replay or MapperSettings(),
        findings_on,
        force,
    )
    return extract_drives(logs, rig, out, settings, shard=shard, processes=processes, cluster=cluster)
