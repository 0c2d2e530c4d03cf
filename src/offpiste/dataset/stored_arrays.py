"""Arrays of a stored dataset: one uncompressed chunk each, followed by its CRC-32C (Zarr's codec `crc32c`).

Readers raise `ValueError` for missing or damaged chunks and for metadata that datasets do not have.
"""

import math
import os
from pathlib import Path
from typing import Any, Final

import google_crc32c
import numpy as np
import zarr
from zarr.codecs import Crc32cCodec

from offpiste.core.checksums import CHECKSUMS, DamagedFile, sha256_of_json
from offpiste.core.limits import LARGEST, parsed, read_small, zstd

ARRAYS = "arrays_sha256"  # attribute of a drive with the digest of its chunks (`digest_of_chunks`)

CODECS: Final = frozenset({"bytes", "zstd", "crc32c"})
"""Accepted codecs. Others may run code: numcodecs has one that unpickles."""

LARGEST_CHUNK: Final = 1 << 32  # largest size of an uncompressed chunk, which is as long on disk [bytes]
LARGEST_COMPRESSED: Final = LARGEST >> 4  # largest size of a chunk of a compressed array, which may have many [bytes]


def open_stored(folder: Path) -> zarr.Group:
    """Open a Zarr v3 group whose arrays use accepted codecs only, and have as many files as chunks."""
    for place, folders, files in os.walk(folder):
        if linked := [name for name in folders if Path(place, name).is_symlink()]:
            raise ValueError(f"{Path(place, linked[0])} is a link")  # its content would not be checked
        if "zarr.json" in files:
            file = Path(place, "zarr.json")
            try:
                metadata = parsed(read_small(file))
                refuse_foreign(metadata)
            except (ValueError, TypeError, KeyError) as error:
                raise ValueError(f"{file} has invalid metadata ({error})") from error
            # The shape may be huge, and Zarr would look for each chunk.
            if metadata["node_type"] == "array":
                chunks = zip(metadata["shape"], _chunk_shape(metadata), strict=True)
                lacking = math.prod(-(-size // max(chunk, 1)) for size, chunk in chunks)
                lacking -= sum(len(names) for _, _, names in os.walk(place)) - 1
                if lacking > 0:
                    raise ValueError(f"{place}: a chunk of '{Path(place).name}' is missing")
    return zarr.open_group(folder, mode="r", zarr_format=3, use_consolidated=False)


def _chunk_shape(metadata: dict[str, Any]) -> list[int]:
    result: list[int] = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    return result


def refuse_foreign(metadata: dict[str, Any]) -> None:
    """Raise an error unless metadata are those of a group or an array of a dataset."""
    if metadata["zarr_format"] != 3:
        raise ValueError(f"Zarr version {metadata['zarr_format']}, not 3")
    if metadata["node_type"] == "group":
        return
    codecs = {codec["name"] for codec in metadata["codecs"]}
    if foreign := sorted(codecs - CODECS):
        raise ValueError(f"codec '{foreign[0]}' is not one of {', '.join(sorted(CODECS))}")
    if metadata.get("storage_transformers"):
        raise ValueError("storage transformers, which datasets do not have")
    chunk = math.prod(_chunk_shape(metadata)) * np.dtype(metadata["data_type"]).itemsize
    most = LARGEST_COMPRESSED if "zstd" in codecs else LARGEST_CHUNK
    if chunk > most:
        raise ValueError(f"chunks of {chunk >> 20} MiB exceed the limit of {most >> 20} MiB")


def refuse_expanding(folder: Path, array: Any, begin: int, end: int) -> None:
    """Raise an error if a compressed chunk of rows begin ... end, in a group's folder, claims another size."""
    for number in range(begin // array.chunks[0], -(-end // array.chunks[0])):
        with folder.joinpath(array.basename, "c", str(number), *("0" for _ in array.shape[1:])).open("rb") as file:
            promised = zstd.get_frame_info(file.read(32)).decompressed_size
        if promised != math.prod(array.chunks) * array.dtype.itemsize:
            raise ValueError(f"chunk {number} of '{array.basename}' claims {promised} bytes")


def write_arrays(group: zarr.Group, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays into a group, each in one chunk, so that windows can be read at plain offsets."""
    for key, values in arrays.items():
        options: dict[str, Any] = {"compressors": Crc32cCodec(), "config": {"write_empty_chunks": True}}
        array = group.create_array(key, shape=values.shape, dtype=values.dtype, chunks=values.shape, **options)
        array[...] = values


def whole_array(group: zarr.Group, key: str) -> np.ndarray:
    """Read an array into memory."""
    array = group[key]
    if not isinstance(array, zarr.Array) or array.nchunks_initialized < array.nchunks:
        raise ValueError(f"a chunk of '{key}' is missing")  # Zarr would read zeros
    try:
        return np.asarray(array[...])
    except ValueError as error:
        raise ValueError(f"'{key}' is damaged: {error}") from error


def mapped_array(folder: Path, group: zarr.Group, key: str) -> np.ndarray:
    """Map an array of a group in `folder` into memory and verify its checksum."""
    array = group[key]
    if not isinstance(array, zarr.Array) or not array.size:
        return whole_array(group, key)
    file = folder.joinpath(key, "c", *("0" for _ in array.shape))
    if not file.exists() or file.stat().st_size != array.nbytes + 4:
        raise ValueError(f"a chunk of '{key}' is missing or cut short")
    check_crc32c(file)
    return np.memmap(file, dtype=array.dtype, mode="r", shape=array.shape)


def check_crc32c(file: Path) -> None:
    """Raise `DamagedFile` if a file differs from the CRC-32C in its last four bytes."""
    checksum, left = 0, file.stat().st_size - 4
    if left < 0:
        raise DamagedFile(file, "is cut short")
    with file.open("rb") as opened:
        while left:
            piece = opened.read(min(left, 1 << 22))
            checksum = google_crc32c.extend(checksum, piece)
            left -= len(piece)
        if opened.read() != checksum.to_bytes(4, "little"):
            raise DamagedFile(file)


def digest_of_chunks(folder: Path) -> str:
    """Return the SHA-256 of the CRC-32Cs of all chunks below a folder."""
    ends = []
    for file in sorted(folder.rglob("*")):
        if file.is_file() and file.name not in ("zarr.json", CHECKSUMS):
            with file.open("rb") as opened:
                opened.seek(-min(4, file.stat().st_size), os.SEEK_END)
                ends.append([file.relative_to(folder).as_posix(), opened.read().hex()])
    return sha256_of_json(ends)


def changed_arrays(drive: Path) -> str:
    """Return the `digest_of_chunks` of a drive whose arrays were changed since extraction, else an empty string."""
    found = digest_of_chunks(drive)
    return found if open_stored(drive).attrs.get(ARRAYS) != found else ""
