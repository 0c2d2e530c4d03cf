"""HTML pages of reports: each is one file that needs nothing but itself."""

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
    """A picture of a page.

    Attributes:
        name: of its file beside the page, without the ending.
        png: content of that file.
        caption: text below the picture.
        chart: shown instead by a browser that runs scripts.
    """

    name: str
    png: bytes
    caption: str
    chart: Chart | None = None

    @property
    def base64(self) -> str:
        """The file as text, which the page holds."""
        return base64.b64encode(self.png).decode("ascii")

    @property
    def json(self) -> str:
        """The chart as text, which the page holds."""
        return "" if self.chart is None else charts_json(self.chart)


def picture(name: str, drawn: Chart | Figure, caption: str) -> Picture:
    """A picture of a chart, or of a figure without interaction."""
    if isinstance(drawn, Figure):
        return Picture(name, png(drawn), caption)
    return Picture(name, png(draw(drawn)), caption, drawn)


@dataclass(frozen=True)
class Card:
    """A main result in a box of its own.

    Attributes:
        name: what the result is of.
        value: the result with its unit, in large letters.
        about: what the value is.
        comparison: the value beside another's.
        tone: of the comparison: "better", "worse" or neither.
        note: what else has to be known.
        colour: of what the result is of, as in figures.
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
    """A part of a page under a heading: tables, below them pictures, below them notes."""

    heading: str
    tables: Sequence[TextTable] = ()
    pictures: Sequence[Picture] = ()
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Page:
    """A report.

    Attributes:
        title: heading of the page.
        headlines: main results, the first one in large letters.
        facts: what the results stand on, by name.
        sections: parts of the page in reading order.
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
    """A section of one table, under the table's title."""
    return Section(table.title, (table,), pictures)


def render(page: Page) -> str:
    """The page as HTML."""
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
