"""The report of a dataset: one page that needs nothing but itself, in the look of `offpiste.evaluation`'s."""

import base64
import html
from collections.abc import Mapping, Sequence
from importlib import resources
from string import Template

from offpiste.dataset.store import Dataset
from offpiste.visualization.coverage import FeatureCoverage, TextTable, headline, seconds_of, tables

PICTURE_OF = {
    "Valid rates": "rates",
    "Achieved observation distances": "distances",
    "Differences between sets": "differences",
}
"""Which picture stands below which table."""

_CAPTIONS = {
    "rates": "Valid rates by distance; negative distances lie behind the vehicle.",
    "distances": "Achieved observation distances; grey: how far the vehicle was from the cell.",
    "differences": "Left: between all sets. Right: a dot a feature, between distances next to each other.",
}


def render_page(dataset: Dataset, found: FeatureCoverage | None, pictures: Mapping[str, bytes]) -> str:
    """The page.

    Args:
        found: None for a dataset without visual features.
        pictures: PNG files by name.
    """
    none = "no visual features by distance: extract with --pca for a report on them"
    sections = [] if found is None else [_section(table, pictures) for table in tables(found)]
    paths = [name for name in pictures if name.startswith("paths")]
    about = "Left: parts of the split. Right: speed. Drives start at the white dot."
    sections.append("<h2>Drives from above</h2>" + "".join(picture_html(pictures[name], about) for name in paths))
    notes = [f"{drive.name}: {note}" for drive in dataset.drives for note in drive.notes]
    if notes:
        sections.append(f"<h2>Notes</h2><ul>{''.join(f'<li>{safe(note)}</li>' for note in notes)}</ul>")
    return page_html(
        f"dataset {dataset.path.resolve().name}", [headline(found) if found else none], _facts(dataset), sections
    )


def page_html(title: str, headlines: Sequence[str], facts: Mapping[str, str], sections: Sequence[str]) -> str:
    """A page in the house's style.

    Args:
        headlines: the first one is the largest.
        facts: by name.
        sections: HTML.
    """
    page = Template(resources.files("offpiste.visualization").joinpath("report.html").read_text("utf-8"))
    return page.substitute(
        title=safe(title),
        style=house_style(),
        headline="".join(f"<p>{safe(line)}</p>" for line in headlines),
        facts=f"<dl>{''.join(f'<dt>{safe(key)}</dt><dd>{safe(value)}</dd>' for key, value in facts.items())}</dl>",
        sections="\n".join(sections),
    )


def house_style() -> str:
    """The style sheet of all of offpiste's pages."""
    page = resources.files("offpiste.evaluation").joinpath("report.html").read_text("utf-8")
    return page.partition("<style>")[2].partition("</style>")[0]


def _facts(dataset: Dataset) -> dict[str, str]:
    drives = dataset.drives
    return {
        "dataset": str(dataset.path),
        "rig": dataset.rig.name,
        "split": dataset.split.text,
        "drives": f"{len(drives)}, {sum(map(seconds_of, drives)):.0f} s, "
        f"{sum(drive.rows.distance for drive in drives) / 1000:.2f} km",
        "features": f"{len(dataset.features)}: {', '.join(dataset.features)}" if dataset.features else "none",
    }


def _section(table: TextTable, pictures: Mapping[str, bytes]) -> str:
    name = PICTURE_OF.get(table.title, "")
    return section_html(table) + (picture_html(pictures[name], _CAPTIONS[name]) if name in pictures else "")


def section_html(table: TextTable) -> str:
    """A table under its title."""
    return f'<h2>{safe(table.title)}</h2><p class="about">{safe(table.about)}</p>{table_html(table)}'


def table_html(table: TextTable) -> str:
    """A table of text."""

    def cells(tag: str, values: Sequence[str]) -> str:
        kinds = (' class="name"' if column == 0 else "" for column in range(len(values)))
        return "".join(f"<{tag}{kind}>{safe(v)}</{tag}>" for kind, v in zip(kinds, values, strict=True))

    body = "".join(f"<tr>{cells('td', line)}</tr>" for line in table.lines)
    return (
        f'<div class="scroll"><table><thead><tr>{cells("th", table.names)}</tr></thead><tbody>{body}</tbody></table>'
        "</div>"
    )


def picture_html(content: bytes, caption: str) -> str:
    """A PNG file inside of the page."""
    data = base64.b64encode(content).decode("ascii")
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{safe(caption)}">'
        f"<figcaption>{safe(caption)}</figcaption></figure>"
    )


def safe(text: str) -> str:
    """Text as HTML."""
    return html.escape(text, quote=True)
