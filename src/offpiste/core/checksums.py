"""Checksums of files, so that damage is an error and never other numbers."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from offpiste.core.files import write_text
from offpiste.core.limits import parsed, read_small

CHECKSUMS = "checksums.json"
"""Name of the file of SHA-256 digests in a folder."""


class DamagedFile(ValueError):
    """The content of a file differs from what was written."""

    def __init__(self, file: Path, what: str = "is damaged: its checksum differs") -> None:
        super().__init__(f"{file} {what}")


def sha256_of(file: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def sha256_of_json(content: Any) -> str:
    """Return the SHA-256 of the content of a JSON document, independent of its layout."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def sha256_of_arrays(arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> str:
    """Return the SHA-256 of named arrays and their JSON metadata, independent of their order in a file."""
    digest = hashlib.sha256(sha256_of_json(about).encode())
    for name in sorted(arrays):
        values = arrays[name]
        digest.update(json.dumps([name, str(values.dtype), values.shape]).encode())
        digest.update(values.tobytes())
    return digest.hexdigest()


def write_checksums(folder: Path, files: Iterable[Path]) -> None:
    """Write the digests of files below a folder into it."""
    digests = {str(file.relative_to(folder)): sha256_of(file) for file in sorted(files)}
    content = {"sha256": digests, "sha256_of_these": sha256_of_json(digests)}
    write_text(folder / CHECKSUMS, json.dumps(content, indent=1) + "\n")


def sha256_of_folders(folder: Path) -> str:
    """Return the SHA-256 of the digests in all subfolders, independent of the path of the folder."""
    files = sorted(folder.glob(f"*/{CHECKSUMS}"))
    return sha256_of_json([[file.parent.name, sha256_of(file)] for file in files])


def check_files(folder: Path) -> None:
    """Raise `DamagedFile` if a file below a folder, or the list of digests, is missing or damaged."""
    for damaged in damaged_files(folder):
        raise damaged


def damaged_files(folder: Path) -> Iterator[DamagedFile]:
    """Yield missing or damaged files; only the list of digests if that is damaged."""
    digests: dict[str, str | None] = {CHECKSUMS: None}
    try:
        content = parsed(read_small(folder / CHECKSUMS))
        if sha256_of_json(content["sha256"]) == content["sha256_of_these"]:
            digests = content["sha256"]
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError, ValueError, KeyError, TypeError):
        pass
    for name, digest in digests.items():
        file = folder / name
        if not file.is_file():
            yield DamagedFile(file, "is missing")
        elif digest is None or sha256_of(file) != digest:
            yield DamagedFile(file)
