"""A dataset as people look at it: its drives from above, and the report of its visual features."""

from collections.abc import Callable
from pathlib import Path

from offpiste.dataset.store import Dataset
from offpiste.files import write_bytes, write_text
from offpiste.viewing.cover_figures import draw_differences, draw_distances, draw_rates
from offpiste.viewing.cover_table import headline, tables
from offpiste.viewing.covered import covered
from offpiste.viewing.drawing import png
from offpiste.viewing.page import render_page
from offpiste.viewing.paths import draw_paths, pages


def view_dataset(dataset: Dataset, out: Path, *, tell: Callable[[object], None] = lambda said: None) -> list[Path]:
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
            tell(table.rich())
        tell(headline(found))
    written = []
    for name, content in pictures.items():
        written.append(out / f"{name}.png")
        write_bytes(written[-1], content)
    written.append(out / "report.html")
    write_text(written[-1], render_page(dataset, found, pictures))
    return written
