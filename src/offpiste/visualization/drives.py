"""Drives of a dataset from above: which part of the split each stretch belongs to, and how fast it was driven.

A dataset as people look at it: its drives from above, and the report of its visual features.
"""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.files import write_bytes, write_text
from offpiste.visualization.coverage import covered, headline, path_of, seconds_of, tables
from offpiste.visualization.coverage_figures import draw_differences, draw_distances, draw_rates
from offpiste.visualization.figure import BLUE, INK, ORANGE, PURPLE, SOFT, coloured_path, plain, png
from offpiste.visualization.page import render_page

logger = logging.getLogger(__name__)

PART_COLOURS = {-1: SOFT, 0: BLUE, 1: ORANGE, 2: PURPLE}
"""By label; -1 is in no part."""

DRIVES_A_PAGE = 6


def pages(drives: Sequence[StoredDrive]) -> list[list[StoredDrive]]:
    """As many drives together as one picture can show."""
    return [list(drives[first : first + DRIVES_A_PAGE]) for first in range(0, len(drives), DRIVES_A_PAGE)]


def draw_paths(drives: Sequence[StoredDrive]) -> Figure:
    """A line a drive: its path by split part, and by speed."""
    figure = Figure(figsize=(11, 0.4 + 4.6 * len(drives)), dpi=120, layout="constrained")
    panels = figure.subplots(len(drives), 2, squeeze=False)
    for drive, (left, right) in zip(drives, panels, strict=True):
        path = path_of(drive)
        _draw_parts(left, drive)
        speed = np.hypot(*drive.rows.state[:, 3:5].T).astype(np.float64)
        pieces = coloured_path(right, path, speed, "plasma")
        figure.colorbar(pieces, ax=right, shrink=0.8, label="speed [m/s]")
        right.set_title(f"median {np.nanmedian(speed):.1f} m/s", loc="left", fontsize=10)
        known = path[np.isfinite(path).all(axis=1)]
        for axes in (left, right):
            if len(known):
                axes.plot(*known[0], marker="o", markersize=6, color="white", markeredgecolor=INK, zorder=5)
            axes.set_aspect("equal", adjustable="datalim")
            axes.autoscale_view()
            axes.set(xlabel="x [m]", ylabel="y [m]")
            axes.grid(color="#eeeeee", linewidth=0.6)
    return figure


def _draw_parts(axes: Axes, drive: StoredDrive) -> None:
    path, part = path_of(drive), drive.part
    plain(axes, f"{drive.name}: {seconds_of(drive):.0f} s, {drive.rows.distance / 1000:.2f} km")
    present = [label for label in PART_COLOURS if (part == label).any()]
    for label in present:
        mine = np.where((part == label)[:, None], path, np.nan)
        axes.plot(*mine.T, color=PART_COLOURS[label], linewidth=2.0 if label >= 0 else 1.2)
    missing = np.where(drive.rows.valid[:, None], np.nan, path)
    axes.plot(*missing.T, ".", color="#cc0000", markersize=2)
    shares = [f"{PARTS[k] if k >= 0 else 'gap'} {np.mean(part == k):.0%}" for k in present]
    handles = [Line2D([], [], color=PART_COLOURS[k], linewidth=2) for k in present]
    if not drive.rows.valid.all():
        handles.append(Line2D([], [], color="#cc0000", marker=".", linestyle=""))
        shares.append(f"incomplete {np.mean(~drive.rows.valid):.1%}")
    axes.legend(handles, shares, frameon=False, fontsize=8)


def view_dataset(dataset: Dataset, out: Path) -> list[Path]:
    """Write paths*.png, and for visual features rates.png, distances.png, differences.png, and report.html.

    Returns:
        what was written, each whole.
    """
    found = covered(dataset)
    sheets = pages(dataset.drives)
    names = [f"paths-{number}" for number in range(1, len(sheets) + 1)] if len(sheets) > 1 else ["paths"]
    pictures = {name: png(draw_paths(drives)) for name, drives in zip(names, sheets, strict=True)}
    if found is not None:
        pictures["rates"] = png(draw_rates(found))
        pictures["distances"] = png(draw_distances(found))
        pictures["differences"] = png(draw_differences(found))
        for table in tables(found):
            logger.info(table.rich())
        logger.info(headline(found))
    written = []
    for name, content in pictures.items():
        written.append(out / f"{name}.png")
        write_bytes(written[-1], content)
    written.append(out / "report.html")
    write_text(written[-1], render_page(dataset, found, pictures))
    return written
