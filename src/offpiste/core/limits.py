"""Memory limits for reading files, so that a small crafted file cannot exhaust memory."""

import json
import re
import sys
import tomllib
from collections.abc import Callable
from importlib import resources
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
"""Largest decompressed chunk, message or image [bytes]."""

MOST_PIXELS: Final = LARGEST // 8
"""Largest image [pixels], with up to four channels of 16 bits; 8K video has fewer."""

LARGEST_TABLE: Final = 1 << 30
"""Largest data held as a whole, such as the columns of a Parquet file [bytes]."""

LARGEST_TEXT: Final = 1 << 25
"""Longest JSON, TOML or YAML document [bytes]; parsers need many times as much memory."""

_DOTTED: Final = re.compile(r"""(?<![\w"'-])(?:["']?[\w-]++["']?[ \t]*+\.[ \t]*+){100}""")
"""Dotted keys of a length for which tomllib needs hours."""


def refuse_larger(size: int, what: str, limit: int = LARGEST, *, where: str | Path = "", how: str = "") -> None:
    """Raise `TooLarge` if a size exceeds the limit [bytes]; `what` is its subject in the message."""
    if size > limit:
        raise TooLarge(f"{what} takes more than {limit >> 20} MB", where=where, how=how or "copy or record it again")


def read_small(path: Path | Traversable) -> str:
    """Read a text file of at most `LARGEST_TEXT` bytes; raises `TooLarge` for a longer one."""
    with path.open("rb") as file:
        content = file.read(LARGEST_TEXT + 1)
    refuse_larger(len(content), "it", LARGEST_TEXT, where=str(path), how="give a file of settings")
    return content.decode("utf-8")


def parsed(text: str, parse: Callable[[str], Any] = json.loads) -> Any:
    """Parse a JSON or TOML text; raises `ValueError` if it is invalid or nested too deeply."""
    if _DOTTED.search(text):
        raise ValueError("a key has a hundred parts")
    try:
        return parse(text)
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None


def packaged_table(package: str, name: str) -> dict[str, Any]:
    """Read a TOML file that ships with a package."""
    return tomllib.loads((resources.files(package) / name).read_text("utf-8"))


def open_tensors(path: Path, framework: str) -> Any:
    """Open a safetensors file (`safetensors.safe_open`); raises `TooLarge` if its JSON header is too long."""
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
    if length < path.stat().st_size:
        refuse_larger(length, "its header", LARGEST_TEXT, where=path, how="give the file that was written")
    return safe_open(path, framework=framework)
