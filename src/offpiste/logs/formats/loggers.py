"""Texts of loggers of cars, which say names and units in ways of their own, as tables with one line of names."""

import codecs
import re
from collections.abc import Callable, Sequence
from typing import Final

UTF_16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
"""What texts in UTF-16 begin with, as spreadsheets write them."""
MARKS: Final = (b"[column names]", b'"|"')
"""What texts of known loggers have near their beginning, and others hardly."""
DATE_AND_TIME: Final = re.compile(
    r"(?<!\S)(\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4}) +(\d\d?:\d\d:\d\d[.\d]*)(?!\S)"
)
"""A stamp that is one cell although it has a space in it."""
_SECTION: Final = re.compile(r"^\[([\w ]+)\]\s*$", re.MULTILINE)
"""Heading of a section of a .vbo file."""
_RACELOGIC: Final = {
    "lat": "latitude (deg)",
    "long": "longitude (deg)",
    "velocity": "velocity (km/h)",
    "heading": "heading (deg)",
    "height": "height (m)",
    "vert-vel": "vertical velocity (m/s)",
}
"""What Racelogic calls the columns that all its files have."""
_MINUTES: Final = {"lat": 1 / 60, "long": -1 / 60}
"""Degrees of a minute of arc; longitudes count to the west."""
_QUOTED: Final = re.compile(r'"([^"|]*)"\|"([^"|]*)"(\|[^,|]*)*')
"""A column of RaceCapture: its name, its unit, then its range and rate."""


def in_one_space(text: bytes) -> bytes:
    """A text separated by spaces, with one between cells and none within stamps."""
    lines = (" ".join(line.split()) for line in text.decode("utf-8", "surrogateescape").split("\n"))
    return "\n".join(DATE_AND_TIME.sub(r"\1T\2", line) for line in lines if line).encode("utf-8", "surrogateescape")


def with_one_header(read: bytes) -> bytes:
    """A file's text in UTF-8, with one line of names above its rows if it is of a known logger; else as it was read."""
    if read.startswith(UTF_16):
        text = read.decode("utf-16", "replace")
        return (as_table(text) or text).encode()
    try:
        table = as_table(read.decode("utf-8-sig"))
    except UnicodeDecodeError:
        table = as_table(read.decode("latin-1"))  # in which older loggers write degrees
    return read if table is None else table.encode()


def as_table(text: str) -> str | None:
    """A text of a known logger with one line of names above its rows; None for any other.

    Args:
        text: the whole file.
    """
    return next((table for reads in _LOGGERS if (table := reads(text)) is not None), None)


def _of_racelogic(text: str) -> str | None:
    """A .vbo file of Racelogic: sections, of which two are the columns' names and their rows, separated by spaces."""
    parts = _SECTION.split(text)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    if not {"column names", "data"} <= set(sections):
        return None
    names = sections["column names"].split()
    units = [line.strip() for line in sections.get("channel units", "").splitlines() if line.strip()]
    # Some list the units of all columns, others those of the columns behind the usual ones.
    unit_of = dict(zip(reversed(names), reversed(units), strict=False))
    header = [_RACELOGIC.get(name.lower()) or _with_unit(name, unit_of.get(name, "")) for name in names]
    factors = [_MINUTES.get(name.lower()) for name in names]
    rows = (_scaled(line.split(), factors) for line in sections["data"].splitlines() if line.strip())
    return "\n".join(",".join(cells) for cells in (header, *rows)) + "\n"


def _scaled(cells: Sequence[str], factors: Sequence[float | None]) -> list[str]:
    """Cells, of which some are multiplied; those that are no numbers, or too many, stay for the reader of tables."""
    scaled = list(cells)
    for place, factor in enumerate(factors[: len(cells)]):
        if factor is not None and re.fullmatch(r"[+-]?[\d.]+", cells[place]):
            scaled[place] = repr(factor * float(cells[place]))
    return scaled


def _with_unit(name: str, unit: str) -> str:
    return name if unit in ("", "(null)") else f"{name} ({unit})"


def _of_racecapture(text: str) -> str | None:
    """A .csv file of RaceCapture, whose names have units, ranges and rates behind bars."""
    header, _, rows = text.partition("\n")
    if not _QUOTED.match(header) or "," not in header or "|" in rows.partition("\n")[0]:
        return None
    return _QUOTED.sub(lambda column: _with_unit(column[1], column[2]), header) + "\n" + rows


_LOGGERS: Final[tuple[Callable[[str], str | None], ...]] = (_of_racelogic, _of_racecapture)
