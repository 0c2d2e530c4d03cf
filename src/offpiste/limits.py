"""Limits on what a file may ask for: a few bytes of it must not fill the memory of the machine."""

from pathlib import Path
from typing import Final

from offpiste.errors import TooLarge

LARGEST: Final = 1 << 28
"""Most memory for one piece of a file, decompressed: a chunk, a message, an image [bytes]."""

LARGEST_TABLE: Final = 1 << 30
"""Most memory for what is held as a whole: the columns of a Parquet file, an array of a dataset [bytes]."""

LARGEST_TEXT: Final = 1 << 25
"""Longest JSON, TOML or YAML document [bytes]: parsers need many times as much memory."""


def refuse_larger(size: int, what: str, limit: int = LARGEST, *, where: str | Path = "", how: str = "") -> None:
    """Raise if something asks for more memory than the limit [bytes].

    Raises:
        TooLarge: it does.
    """
    if size > limit:
        raise TooLarge(f"{what} takes more than {limit >> 20} MB", where=where, how=how or "copy or record it again")


def read_small(path: Path) -> bytes:
    """Content of a JSON, TOML or YAML file.

    Raises:
        TooLarge: it is longer than `LARGEST_TEXT`.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST_TEXT + 1)
    refuse_larger(len(content), "a text of settings", LARGEST_TEXT, where=path, how="give the file that was written")
    return content
