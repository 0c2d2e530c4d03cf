"""Pictures of a log or a dataset: `offpiste view`."""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.core.conventions import DT
from offpiste.core.errors import LogError, RigError
from offpiste.core.files import check_folder, unfinished
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, StoredDrive, open_dataset
from offpiste.logs.log import Log, open_log
from offpiste.perception.feature_extractor import load_feature_extractor
from offpiste.report.figure import BLUE, INK, ORANGE, PURPLE, SOFT, coloured_path, plain
from offpiste.report.page import Page, Section, picture, write_page
from offpiste.rig.channels import Clock
from offpiste.rig.rig import load_rig
from offpiste.visualization.coverage import (
    FeatureCoverage,
    coverage_sections,
    headline,
    measure_coverage,
    tables,
)
from offpiste.visualization.predicted_regions import view_regions
from offpiste.visualization.view_log import view_log

logger = logging.getLogger(__name__)

PART_COLOURS = {-1: SOFT, 0: BLUE, 1: ORANGE, 2: PURPLE}
"""Colours of the split's parts, by label; -1: no part."""

FASTEST = 0.995
"""Quantile of the speeds at the end of the colour scale; smoothed speeds beside gaps may be far off."""

_UNFINISHED = ".offpiste-view"
"""Hidden file that marks an unfinished folder of pictures."""

DRIVES_A_PAGE = 6
"""Number of drives in one picture."""


def draw_paths(drives: Sequence[StoredDrive]) -> Figure:
    """Draw the paths of drives, a row of panels each: by part of the split, and by speed."""
    figure = Figure(figsize=(11, 0.4 + 4.6 * len(drives)), dpi=120, layout="constrained")
    panels = figure.subplots(len(drives), 2, squeeze=False)
    for drive, (left, right) in zip(drives, panels, strict=True):
        path, valid = drive.rows.world_xy, drive.rows.valid
        _draw_parts(left, drive)
        speed = np.hypot(*drive.rows.state[:, 3:5].T).astype(np.float64)
        pieces = coloured_path(right, path, speed)
        if (known := speed[valid & np.isfinite(speed)]).size:
            pieces.set_clim(known.min(), np.quantile(known, FASTEST))
        figure.colorbar(pieces, ax=right, shrink=0.8, extend="max", label="speed [m/s]")
        plain(right, f"median {np.nanmedian(speed):.1f} m/s")
        placed = path[np.isfinite(path).all(axis=1)][:1]
        for axes in (left, right):
            axes.plot(*placed.T, marker="o", markersize=6, color="white", markeredgecolor=INK, zorder=5)
            axes.set_aspect("equal", adjustable="datalim")
            axes.autoscale_view()
            axes.set(xlabel="x [m]", ylabel="y [m]")
    return figure


def _draw_parts(axes: Axes, drive: StoredDrive) -> None:
    path, part, missing = drive.rows.world_xy, drive.part, ~drive.rows.valid
    plain(axes, f"{drive.name}: {len(part) * DT:.0f} s, {drive.rows.distance / 1000:.2f} km")
    for label, colour in PART_COLOURS.items():
        if (mine := part == label).any():
            name = f"{PARTS[label] if label >= 0 else 'gap'} {mine.mean():.0%}"
            axes.plot(*np.where(mine[:, None], path, np.nan).T, color=colour, linewidth=2.0, label=name)
    if missing.any():
        name = f"incomplete {missing.mean():.1%}"
        axes.plot(*np.where(missing[:, None], path, np.nan).T, ".", color="#cc0000", markersize=2, label=name)
    axes.legend(frameon=False, fontsize=8)


def view_dataset(dataset: Dataset, out: Path) -> list[Path]:
    """Write paths*.png, for visual features rates.png and distances.png, and report.html.

    Returns:
        Paths of the files, each written whole or not at all.
    """
    result = measure_coverage(dataset)
    if result is not None:
        for table in tables(result):
            logger.info(table.text())
        logger.info(headline(result))
    return write_page(dataset_page(dataset, result), out)


def dataset_page(dataset: Dataset, result: FeatureCoverage | None) -> Page:
    """Return the report of a dataset, with the coverage of its visual features if it has any."""
    drives, features = dataset.drives, dataset.features
    without = "no visual features by distance; extract with --pca to report on them"
    caption = "Left: parts of the split. Right: speed. Drives start at the white dot."
    sheets = [drives[first : first + DRIVES_A_PAGE] for first in range(0, len(drives), DRIVES_A_PAGE)]
    names = [f"paths-{number}" for number in range(1, len(sheets) + 1)] if len(sheets) > 1 else ["paths"]
    paths = [picture(name, draw_paths(sheet), caption) for name, sheet in zip(names, sheets, strict=True)]
    sections = [*(coverage_sections(result) if result else []), Section("Drives from above", pictures=paths)]
    if notes := [f"{drive.name}: {note}" for drive in drives for note in drive.notes]:
        sections.append(Section("Notes", notes=notes))
    seconds, metres = (sum(each) for each in zip(*((len(d.part) * DT, d.rows.distance) for d in drives), strict=True))
    facts = {
        "dataset": str(dataset.path),
        "rig": dataset.rig.name,
        "split": dataset.split.text,
        "drives": f"{len(drives)}, {seconds:.0f} s, {metres / 1000:.2f} km",
        "features": f"{len(features)}: {', '.join(features)}" if features else "none",
    }
    title = f"dataset {dataset.path.resolve().name}"
    return Page(title, [headline(result) if result else without], facts, sections)


def parse_stretch(text: str) -> tuple[float, float]:
    """Parse an interval "A:B", "A:", ":B" or "" (the whole log) in seconds after the first pose.

    Raises:
        LogError: the text has another form, or the interval is empty.
    """
    first, colon, last = (text or ":").partition(":")
    try:
        start, end = float(first or 0.0), float(last or np.inf)
        if colon and 0 <= start < end:
            return start, end
    except ValueError:
        pass
    raise LogError(f"not an interval: '{text}'", how="give --seconds A:B, A: or :B in seconds after the first pose")


def view(
    path: Path,
    out: Path,
    *,
    rig: str | None = None,
    pca: Path | None = None,
    run: Path | None = None,
    seconds: str = "",
    rrd: bool = True,
    device: str = "cpu",
) -> list[Path]:
    """Write pictures of a log or a dataset into a folder that is new, empty or of an earlier view.

    Args:
        rig: preset or file, for logs.
        pca: file of `fit-pca`, for logs; None: no features.
        run: trained run with a spread, for datasets; its predicted regions are drawn.
        seconds: interval "A:B", for logs (`parse_stretch`).
        rrd: whether to write a Rerun recording, for logs.
        device: of the backbone.

    Returns:
        Paths of the files, each written whole.

    Raises:
        LogError, RigError, PerceptionError, DatasetError, RunError: the path is neither, or cannot be viewed.
    """
    check_folder(out, own=(_UNFINISHED, "sensors.png", "paths*.png"))
    if (path / "zarr.json").exists():
        if rig or pca or seconds:
            logger.info("--rig, --pca and --seconds are ignored: a dataset is viewed as a whole, with its own rig")
        dataset = open_dataset(path)
        with unfinished(out, _UNFINISHED):
            return view_dataset(dataset, out) + ([] if run is None else [view_regions(run, dataset, out)])
    stretch = parse_stretch(seconds)
    if rig is None:
        _open(path)
        raise RigError("a log requires a rig", where=path, how="give --rig; `offpiste inspect` drafts one")
    vehicle = load_rig(rig)
    extractor = load_feature_extractor(pca, device) if pca is not None else None
    log = _open(path, vehicle.clock)
    with unfinished(out, _UNFINISHED):
        return view_log(log, vehicle, out, extractor=extractor, stretch=stretch, rrd=rrd)


def _open(path: Path, clock: Clock | None = None) -> Log:
    if path.is_dir() and not any(path.iterdir()):
        raise LogError("an empty folder", where=path, how="give a log or a dataset")
    try:
        return open_log(path, clock=clock)
    except LogError as error:
        if error.what != "no known log format":
            raise
        how = f"{error.how}, or a dataset that `offpiste extract` wrote"
        if (path / "report.html").exists():
            how = "open its report.html in a browser"
        raise LogError("neither a log of a known format nor a dataset", where=path, how=how) from error
