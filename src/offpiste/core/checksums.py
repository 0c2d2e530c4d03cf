"""Checksums of files: one that was damaged is refused, and never read as other numbers."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from offpiste.core.files import write_text
from offpiste.core.limits import parsed, read_small

CHECKSUMS = "checksums.json"
"""File of SHA-256 digests beside the files that it names."""


class DamagedFile(ValueError):
    """A file does not have the content that was written."""

    def __init__(self, file: Path, what: str = "is damaged: its checksum differs") -> None:
        super().__init__(f"{file} {what}")


def sha256_of(file: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def sha256_of_json(content: Any) -> str:
    """SHA-256 of what a JSON document says, however it is laid out."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def sha256_of_arrays(arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> str:
    """SHA-256 of named arrays and of JSON values about them, wherever they lie in a file."""
    digest = hashlib.sha256(sha256_of_json(about).encode())
    for name in sorted(arrays):
        values = arrays[name]
        digest.update(json.dumps([name, str(values.dtype), values.shape]).encode())
        digest.update(values.tobytes())
    return digest.hexdigest()


def write_checksums(folder: Path, files: Iterable[Path]) -> None:
    """Write the digests of some files below a folder into it."""
    digests = {str(file.relative_to(folder)): sha256_of(file) for file in sorted(files)}
    content = {"sha256": digests, "sha256_of_these": sha256_of_json(digests)}
    write_text(folder / CHECKSUMS, json.dumps(content, indent=1) + "\n")


def sha256_of_folders(folder: Path) -> str:
    """SHA-256 of what `write_checksums` left in the folders below: of their content, wherever all of it lies."""
    files = sorted(folder.glob(f"*/{CHECKSUMS}"))
    return sha256_of_json([[file.parent.name, sha256_of(file)] for file in files])


def check_files(folder: Path) -> None:
    """Compare files below a folder with the digests that `write_checksums` left in it.

    Raises:
        DamagedFile: a file is missing or differs, or the digests themselves do.
    """
    for damaged in damaged_files(folder):
        raise damaged


def damaged_files(folder: Path) -> Iterator[DamagedFile]:
    """Yield files that are missing or do not match their digest; only the list of digests if that is damaged."""
    list_file = folder / CHECKSUMS
    if not list_file.is_file():
        yield DamagedFile(list_file, "is missing")
        return
    try:
        content = parsed(read_small(list_file))
        digests: dict[str, str] = content["sha256"]
        intact = sha256_of_json(digests) == content["sha256_of_these"]
    except (ValueError, KeyError, TypeError):
        intact = False
    if not intact:
        yield DamagedFile(list_file)
        return
    for name, digest in digests.items():
        file = folder / name
        if not file.is_file():
            yield DamagedFile(file, "is missing")
        elif sha256_of(file) != digest:
            yield DamagedFile(file)
