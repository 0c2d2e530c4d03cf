"""Logs in, dataset out: read, bring to 50 Hz, split, write, one drive at a time."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from offpiste.conventions import MIN_JUDGED_SPEED
from offpiste.dataset.extract import extract_rows
from offpiste.dataset.ground_truth import LAYERS, FeatureSource, truth_map, with_ground_truth
from offpiste.dataset.splits import PARTS, Split, parse_split, window_starts
from offpiste.dataset.store import Dataset, StoredDrive, add_drive, create, drive_names, open_dataset
from offpiste.errors import DatasetError
from offpiste.logs import read_drive
from offpiste.logs.drive import drive_name
from offpiste.progress import track
from offpiste.rig import Rig


def make_dataset(
    logs: Sequence[str | Path],
    rig: Rig,
    out: Path,
    *,
    split: str = "blocks:0.7,0.1,0.2",
    features: FeatureSource = "none",
    tell: Callable[[str], None] = lambda line: None,
) -> Dataset:
    """Extract drives into a dataset; drives that are in it already are left as they are.

    Args:
        features: what the dataset says of the ground under the wheels (`dataset.ground_truth.LAYERS`).

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
    create(out, rig, parts, LAYERS[features])
    done = set(drive_names(out))
    for log, name in track(list(zip(logs, names, strict=True)), "extract"):
        if name in done:
            tell(f"{name}: already there")
            continue
        drive = read_drive(log, rig)
        rows, terrain = extract_rows(drive), None
        if features != "none":
            rows, terrain = with_ground_truth(rows, truth_map(log, LAYERS[features]), rig)
        tell(_described(add_drive(out, name, rows, parts, drive.notes, terrain), parts))
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
    return "\n".join(lines + [f"  {note}" for note in drive.notes])
