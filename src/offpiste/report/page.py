"""Self-contained HTML pages of reports."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from matplotlib.figure import Figure

from offpiste.core.files import write_bytes, write_text
from offpiste.report.chart import Chart, draw
from offpiste.report.figure import png
from offpiste.report.plotly_charts import charts_json, plotly_base64
from offpiste.report.text_table import TextTable


@dataclass(frozen=True)
class Picture:
    """Picture of a page.

    Attributes:
        name: of its file beside the page, without the ending.
        png: content of that file.
        caption: text below the picture.
        chart: shown instead in browsers that run scripts.
    """

    name: str
    png: bytes
    caption: str
    chart: Chart | None = None

    @property
    def base64(self) -> str:
        """Content of the file as text for the page."""
        return base64.b64encode(self.png).decode("ascii")

    @property
    def json(self) -> str:
        """Chart as text for the page."""
        return "" if self.chart is None else charts_json(self.chart)


def picture(name: str, drawn: Chart | Figure, caption: str) -> Picture:
    """Return a picture of a chart, or of a static figure."""
    if isinstance(drawn, Figure):
        return Picture(name, png(drawn), caption)
    return Picture(name, png(draw(drawn)), caption, drawn)


@dataclass(frozen=True)
class Card:
    """Box with a main result.

    Attributes:
        name: for example of a model.
        value: result with its unit, in large letters.
        about: description of the value.
        comparison: with another result.
        tone: of the comparison: "better", "worse" or "".
        note: conditions of the result.
        colour: as in figures.
    """

    name: str
    value: str
    about: str
    comparison: str = ""
    tone: str = ""
    note: str = ""
    colour: str = "var(--op-accent)"


@dataclass(frozen=True)
class Section:
    """Section of a page: tables, then pictures, then notes."""

    heading: str
    tables: Sequence[TextTable] = ()
    pictures: Sequence[Picture] = ()
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Page:
    """Page of a report.

    Attributes:
        title: heading of the page.
        headlines: main results, the first in large letters.
        facts: conditions of the results, by name.
        cards: results side by side below the headlines.
    """

    title: str
    headlines: Sequence[str]
    facts: Mapping[str, str]
    sections: Sequence[Section] = field(default=())
    cards: Sequence[Card] = ()

    @property
    def interactive(self) -> bool:
        """Whether the page has charts."""
        return any(picture.chart for section in self.sections for picture in section.pictures)


def table_section(table: TextTable, *pictures: Picture) -> Section:
    """Return a section of one table with the table's title as heading."""
    return Section(table.title, (table,), pictures)


def render(page: Page) -> str:
    """Return the page as HTML."""
    return _template().render(page=page, plotly=plotly_base64)


def write_page(page: Page, folder: Path) -> list[Path]:
    """Write report.html, and its pictures as PNG files beside it, each file whole or not at all.

    Returns:
        Paths of the files.
    """
    written = []
    for picture in (picture for section in page.sections for picture in section.pictures):
        written.append(folder / f"{picture.name}.png")
        write_bytes(written[-1], picture.png)
    written.append(folder / "report.html")
    write_text(written[-1], render(page))
    return written


@cache
def _template() -> Template:
    loader = PackageLoader("offpiste.report", ".")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html")
