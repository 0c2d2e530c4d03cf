"""Texts of loggers of cars, which say names, units and times in ways of their own, as tables of numbers."""

import codecs
import csv
import io
import re
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from offpiste.rig.labels import unit_of

UTF_16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
"""What texts in UTF-16 begin with, as spreadsheets write them."""
MARKS: Final = (b"[column names]", b'"|"', b"Format,3")
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
_SOURCE: Final = re.compile(r"\d+: .+")
"""Where RaceChrono has a column from, `103: obd`."""
_MOST_PREAMBLE: Final = 64
"""Lines before its names, at most."""
_CLOCK: Final = re.compile(
    r"(?:(?P<date>.*?)[T ,_-]+|)(?P<hours>\d{1,2}):(?P<minutes>\d\d):(?P<seconds>\d\d(?:[.,:]\d+)?)"
    r"\s*(?P<half>[ap])?\.?(?:m\.?)?\s*(?:z|utc|gmt|[+-]\d\d:?\d\d)?",
    re.IGNORECASE,
)
_COMPACT: Final = re.compile(
    r"(?P<date>\d{8})[T _-](?P<hours>\d\d)(?P<minutes>\d\d)(?P<seconds>\d\d(?:[.,]\d+)?)(?P<half>)Z?", re.IGNORECASE
)
"""Times of the day, with or without a date before them."""
_DAY: Final = 86_400.0


def clock_times(cells: pa.ChunkedArray) -> Float[np.ndarray, " n"] | None:
    """Times of the day, such as `05/03/2024 1:02:03.4 PM`, as seconds from midnight; None where a cell is none.

    Each further text of a date is the next day. Where there is no such text, steps beyond half a day cross midnight,
    also those of a row that comes late.
    """
    times = np.full(len(cells), np.nan)
    days: dict[str, int] = {}
    for row, cell in enumerate(cells.to_pylist()):
        if cell is None or not cell.strip():
            continue
        match = _CLOCK.fullmatch(cell.strip()) or _COMPACT.fullmatch(cell.strip())
        if match is None:
            return None
        hours, date = int(match["hours"]), match["date"] or ""
        if half := (match["half"] or "").lower():
            hours = hours % 12 + (12 if half == "p" else 0)
        seconds = float(re.sub("[,:]", ".", match["seconds"]))
        times[row] = _DAY * days.setdefault(date, len(days)) + 3600 * hours + 60 * int(match["minutes"]) + seconds
    return past_midnight(times) if len(days) == 1 else times


def past_midnight(times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Unwrap seconds of the day; a step of more than half a day is a crossing of midnight."""
    known, result = np.isfinite(times), times.copy()
    result[known] = np.unwrap(times[known], period=_DAY)
    return result


def shows_clock_face(stamps: Float[np.ndarray, " n"]) -> bool:
    """Whether stamps are digits of hours, minutes and seconds, HHMMSS.sss: each minute leaves out 60 to 99."""
    known = stamps[np.isfinite(stamps)]
    if not len(known) or known.min() < 0 or known.max() >= 240_000:
        return False
    if (known % 100).max() >= 60 or (known // 100 % 100).max() >= 60:
        return False
    steps = np.diff(known)
    minutes = np.diff(known // 100) != 0
    usual = float(np.median(steps)) if len(steps) else 0.0
    return bool(minutes.any() and usual > 0 and abs(float(np.median(steps[minutes] % 100)) - 40 - usual) < 2 * usual)


def seconds_of_the_day(stamps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Seconds from midnight of stamps that show a clock's face."""
    hours, minutes = stamps // 10_000, stamps // 100 % 100
    return past_midnight(3600 * hours + 60 * minutes + stamps % 100)


def in_one_space(text: bytes) -> bytes:
    """A text separated by spaces, with one between cells and none within stamps."""
    lines = (" ".join(line.split()) for line in text.decode("utf-8", "surrogateescape").split("\n"))
    return "\n".join(DATE_AND_TIME.sub(r"\1T\2", line) for line in lines if line).encode("utf-8", "surrogateescape")


def with_one_header(read: bytes) -> bytes:
    """A file's text in UTF-8, with one line of names above its rows if it is of a known logger."""
    if read.startswith(UTF_16):
        text = read.decode("utf-16", "replace")
        return (as_table(text) or text).encode()
    try:
        table = as_table(read.decode("utf-8-sig"))
    except UnicodeDecodeError:
        table = as_table(read.decode("latin-1")) or read.decode("cp1252")  # as older loggers write degrees
    return read if table is None else table.encode()


def is_utf_8(file: io.BufferedIOBase) -> bool:
    """Whether a file's bytes, from where it stands, are a text in UTF-8."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        while block := file.read(1 << 20):
            decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return False
    return True


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


def _of_racechrono(text: str) -> str | None:
    """A .csv file of RaceChrono, below whose names are units and then sources, which tell columns of one name apart."""
    lines = text.splitlines()
    try:
        rows = list(csv.reader(lines[:_MOST_PREAMBLE]))
    except csv.Error:  # a cell that is too long
        return None
    sources = (at for at, cells in enumerate(rows) if any(cells) and all(map(_SOURCE.fullmatch, filter(None, cells))))
    if (at := next(sources, 0)) < 2:
        return None
    names, units, source = rows[at - 2 : at + 1]
    named = [
        f"{name} ({of})" if name in names[:k] else name for k, (name, of) in enumerate(zip(names, source, strict=False))
    ]
    known = ["s" if unit == "unix time" else unit if unit_of(unit) else "" for unit in units]
    header = io.StringIO(newline="")
    csv.writer(header, lineterminator="\n").writerows([named, known] if any(known) else [named])
    return header.getvalue() + "\n".join(lines[at + 1 :]) + "\n"


_LOGGERS: Final[tuple[Callable[[str], str | None], ...]] = (_of_racelogic, _of_racecapture, _of_racechrono)
