"""Logs in, dataset out: read, bring to 50 Hz, split, write, one drive at a time."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from offpiste.conventions import FEATURE_SETS, MIN_JUDGED_SPEED
from offpiste.dataset.extract import extract_rows
from offpiste.dataset.ground_truth import LAYERS, FeatureSource, truth_map, with_ground_truth
from offpiste.dataset.splits import PARTS, Split, parse_split, window_starts
from offpiste.dataset.store import Dataset, StoredDrive, add_drive, create, drive_names, open_dataset
from offpiste.dataset.visual import with_visual_features
from offpiste.errors import DatasetError
from offpiste.logs import read_drive
from offpiste.logs.drive import drive_name
from offpiste.logs.open import open_log
from offpiste.logs.sensors import open_sensors
from offpiste.perception.looking import load_looking
from offpiste.progress import track
from offpiste.rig import Rig


def make_dataset(
    logs: Sequence[str | Path],
    rig: Rig,
    out: Path,
    *,
    split: str = "blocks:0.7,0.1,0.2",
    features: FeatureSource = "none",
    pca: Path | None = None,
    device: str = "cpu",
    tell: Callable[[str], None] = lambda line: None,
) -> Dataset:
    """Extract drives into a dataset; drives that are in it already are left as they are.

    Args:
        features: what a simulator says of the ground under the wheels (`dataset.ground_truth.LAYERS`).
        pca: instead, visual features: a file of `fit-pca`, which names its backbone.
        device: that the backbone runs on.

    Raises:
        LogError, RigError: a log cannot be read with this rig, or has no ground truth; drives extracted before stay.
        DatasetError: two logs of one name, or another dataset at `out`.
    """
    if not logs:
        raise DatasetError("no log is given", how="name one or more logs")
    names = [drive_name(log) for log in logs]
    for name in names:
        if names.count(name) > 1:
            raise DatasetError(f"two logs are called '{name}'", how="rename one of them")
    parts = parse_split(split)
    if pca is not None and features != "none":
        raise DatasetError(f"both a PCA and '{features}' features are asked for", how="leave out one of them")
    looking = load_looking(pca, device) if pca is not None else None
    create(out, rig, parts, looking.names if looking else LAYERS[features], looking.identity if looking else None)
    done = set(drive_names(out))
    for log, name in track(list(zip(logs, names, strict=True)), "extract"):
        if name in done:
            tell(f"{name}: already there")
            continue
        drive = read_drive(log, rig)
        rows, terrain, notes = extract_rows(drive), None, drive.notes
        if looking is not None:
            sensors = open_sensors(open_log(log, clock_column=rig.clock.column, clock_unit=rig.clock.unit), rig)
            rows = with_visual_features(rows, sensors, rig, looking)
            notes += sensors.notes
        if features != "none":
            rows, terrain = with_ground_truth(rows, truth_map(log, LAYERS[features]), rig)
        tell(_described(add_drive(out, name, rows, parts, notes, terrain), parts))
    return open_dataset(out)


def _described(drive: StoredDrive, split: Split) -> str:
    rows = drive.rows
    fast = np.hypot(rows.state_causal[:, 3], rows.state_causal[:, 4]) > MIN_JUDGED_SPEED
    starts = [window_starts(rows.valid & (drive.part == number)) for number in range(len(PARTS))]
    windows = [int(fast[found].sum()) for found in starts]
    share = ", ".join(f"{count} {part}" for count, part in zip(windows, PARTS, strict=True))
    lines = [
        f"{drive.name}: {len(rows.time) / 50:.0f} s, {rows.distance / 1000:.2f} km, "
        f"{rows.valid.mean():.1%} of the rows complete; windows above {MIN_JUDGED_SPEED} m/s: {share}"
    ]
    if split.kind in ("blocks", "fold") and min(windows) == 0:
        lines.append(
            f"  warning: too short or slow for {split.text}: a part has no window; split by drives (drives:FILE)"
        )
    if rows.cells is not None and len(rows.cells.valid) == len(FEATURE_SETS):
        rates = zip(FEATURE_SETS, rows.cells.valid.mean(axis=1), strict=True)
        lines.append("  valid by distance: " + ", ".join(f"{name} {rate:.2f}" for name, rate in rates))
    return "\n".join(lines + [f"  {note}" for note in drive.notes])
