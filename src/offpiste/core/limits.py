"""Limits on what a file may ask for: a few bytes of it must not fill the memory of the machine."""

import json
import re
import sys
from collections.abc import Callable
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Final

from safetensors import safe_open

from offpiste.core.errors import TooLarge

if sys.version_info >= (3, 14):
    from compression import zstd as zstd
else:
    from backports import zstd as zstd

LARGEST: Final = 1 << 28
"""Most memory for one piece of a file, decompressed: a chunk, a message, an image [bytes]."""

MOST_PIXELS: Final = LARGEST // 8
"""Most pixels of an image, which may have four channels of 16 bits: 8K video has fewer."""

LARGEST_TABLE: Final = 1 << 30
"""Most memory for what is held as a whole: the columns of a Parquet file, an array of a dataset [bytes]."""

LARGEST_TEXT: Final = 1 << 25
"""Longest JSON, TOML or YAML document [bytes]: parsers need many times as much memory."""


_DOTTED: Final = re.compile(r"""(?<![\w"'-])(?:["']?[\w-]++["']?[ \t]*+\.[ \t]*+){100}""")
"""Dotted keys that are so long that tomllib needs hours."""


def refuse_larger(size: int, what: str, limit: int = LARGEST, *, where: str | Path = "", how: str = "") -> None:
    """Raise if something asks for more memory than the limit [bytes].

    Raises:
        TooLarge: it does.
    """
    if size > limit:
        raise TooLarge(f"{what} takes more than {limit >> 20} MB", where=where, how=how or "copy or record it again")


def read_small(path: Path | Traversable) -> str:
    """Text of a file of settings.

    Raises:
        TooLarge: it is longer than `LARGEST_TEXT`.
        OSError, UnicodeDecodeError: it cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST_TEXT + 1)
    refuse_larger(len(content), "it", LARGEST_TEXT, where=str(path), how="give a file of settings")
    return content.decode("utf-8")


def parsed(text: str, parse: Callable[[str], Any] = json.loads) -> Any:
    """What a JSON or TOML text says.

    Raises:
        ValueError: it is damaged, or nested deeper than Python can follow.
    """
    if _DOTTED.search(text):
        raise ValueError("a key of a hundred parts")
    try:
        return parse(text)
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None


def open_tensors(path: Path, framework: str) -> Any:
    """A safetensors file, as `safetensors.safe_open` opens it.

    Raises:
        TooLarge: its header, which is JSON, is longer than `LARGEST_TEXT`.
        OSError, SafetensorError: it cannot be read.
    """
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
    if length < path.stat().st_size:
        refuse_larger(length, "its header", LARGEST_TEXT, where=path, how="give the file that was written")
    return safe_open(path, framework=framework)
