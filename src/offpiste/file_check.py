"""Compares the checksums of all files of runs, datasets and PCAs with their content (`offpiste check`)."""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import zarr
from safetensors import SafetensorError

from offpiste.core.checksums import CHECKSUMS, damaged_files
from offpiste.core.errors import OffpisteError
from offpiste.core.limits import open_tensors, parsed, read_small
from offpiste.core.progress import track
from offpiste.core.shipped import run_folder
from offpiste.dataset.place import drive_names
from offpiste.dataset.store import open_dataset
from offpiste.dataset.stored_arrays import check_crc32c, refuse_foreign
from offpiste.perception.pca import PCA_HEADER, load_pca
from offpiste.training.checkpoint import load_json, load_tensors
from offpiste.training.run import load_run

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Piece:
    """A file or a folder, and what raises an error if it is damaged.

    Attributes:
        how: how to fix it, where the error does not say.
    """

    path: Path
    check: Callable[[Path], object]
    how: str = ""


def check_paths(paths: Sequence[Path]) -> list[str]:
    """What is damaged of runs, datasets and PCA files, one line each; it is logged, too.

    Raises:
        OffpisteError: a path is none of these, and holds none.
    """
    pieces = {path: list(pieces_of(path)) for path in map(run_folder, paths)}
    for path, found in pieces.items():
        if not found:
            raise OffpisteError("is no run, dataset or PCA, and holds none", where=path, how="name one of these")
    damaged: dict[Path, list[str]] = {path: [] for path in pieces}
    work = [(path, piece) for path, found in pieces.items() for piece in found]
    for path, piece in track(work, "check"):
        damaged[path] += _damage(piece)
    for path, lines in damaged.items():
        size = sum(file.stat().st_size for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file())
        # Several pieces may meet the same damaged file.
        for line in dict.fromkeys(lines):
            logger.info(line)
        if not lines:
            logger.info(f"{path}: {size / 1e6:.1f} MB are as they were written")
    return [line for lines in damaged.values() for line in dict.fromkeys(lines)]


def _damage(piece: Piece) -> list[str]:
    try:
        piece.check(piece.path)
    except OffpisteError as error:
        return [str(error)]
    except (OSError, ValueError) as error:
        return [f"{error}; {piece.how}" if piece.how else str(error)]
    return []


def pieces_of(path: Path) -> Iterator[Piece]:
    """What there is to check at a path.

    Raises:
        OffpisteError: there is nothing there.
    """
    if not path.exists():
        raise OffpisteError("is not there", where=path, how="name a run, a dataset or a PCA file")
    if path.is_file():
        yield from _pieces_of_tensors(path)
    elif (path / "zarr.json").exists() or (path / CHECKSUMS).exists():
        yield from _pieces_of_dataset(path)
    elif (path / "config.json").exists() or (path / "model.json").exists():
        yield from _pieces_of_run(path)
    else:
        for below in sorted(path.iterdir()):
            if (below.is_dir() and not below.name.startswith(".")) or below.suffix == ".safetensors":
                yield from pieces_of(below)


def _pieces_of_tensors(path: Path) -> Iterator[Piece]:
    try:
        with open_tensors(path, "numpy") as file:
            header = file.metadata() or {}
    except (OSError, SafetensorError):
        header = {PCA_HEADER: ""}
    if PCA_HEADER in header:
        yield Piece(path, load_pca)


def _pieces_of_run(path: Path) -> Iterator[Piece]:
    for file in sorted(path.glob("*.safetensors")):
        yield Piece(file, load_tensors)
    for name in ("config.json", "model.json"):
        if (path / name).exists():
            yield Piece(path / name, load_json)
    if (path / "model.json").exists():
        yield Piece(path, load_run)


def _pieces_of_dataset(path: Path) -> Iterator[Piece]:
    yield Piece(path, _check_metadata, "restore it from a copy, or extract the dataset again")
    for name in drive_names(path):
        drive = path / name
        how = f"delete {drive} and run `offpiste extract` again"
        yield Piece(drive, _check_metadata, how)
        yield from (Piece(file.parent, _check_chunks_are_there, how) for file in sorted(drive.rglob("zarr.json")))
        for file in sorted(drive.rglob("c/**/*")):
            if file.is_file():
                yield Piece(file, check_crc32c, how)
    yield Piece(path, open_dataset)


def _check_metadata(folder: Path) -> None:
    lines = [str(damaged) for damaged in damaged_files(folder)]
    if lines:
        raise ValueError("; ".join(lines))


def _check_chunks_are_there(folder: Path) -> None:
    try:
        refuse_foreign(parsed(read_small(folder / "zarr.json")))
        node = zarr.open(folder, mode="r", zarr_format=3)
    except (KeyError, TypeError, OSError, ValueError):
        return  # its metadata are damaged, and said to be
    if isinstance(node, zarr.Array) and node.nchunks_initialized < node.nchunks:
        raise ValueError(f"{folder} lacks {node.nchunks - node.nchunks_initialized} chunks")
