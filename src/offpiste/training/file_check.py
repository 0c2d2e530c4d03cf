"""Checks of all files of runs, datasets and PCAs against their checksums (`offpiste check`)."""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

from safetensors import SafetensorError

from offpiste.core.checksums import CHECKSUMS
from offpiste.core.errors import OffpisteError
from offpiste.core.limits import open_tensors
from offpiste.core.progress import track
from offpiste.core.shipped import run_folder
from offpiste.dataset.integrity import Check, dataset_checks
from offpiste.perception.pca import PCA_HEADER, load_pca
from offpiste.training.checkpoint import load_json, load_tensors
from offpiste.training.run import load_run

logger = logging.getLogger(__name__)


def check_paths(paths: Sequence[Path]) -> list[str]:
    """Log and return the damage of runs, datasets and PCA files, one line each.

    Raises:
        OffpisteError: a path does not exist, or is and contains none of these.
    """
    checks = {path: list(_checks_of(path)) for path in map(run_folder, paths)}
    for path, found in checks.items():
        if not found:
            raise OffpisteError("is not a run, dataset or PCA, and contains none", where=path, how="name one of these")
    # Keys, as several checks may meet the same damaged file.
    damaged: dict[Path, dict[str, None]] = {path: {} for path in checks}
    for path, check in track([(path, check) for path, found in checks.items() for check in found], "check"):
        damaged[path] |= dict.fromkeys(check.damage())
    for path, lines in damaged.items():
        size = sum(file.stat().st_size for file in (path, *path.rglob("*")) if file.is_file())
        for line in lines or [f"{path}: {size / 1e6:.1f} MB are intact"]:
            logger.info(line)
    return [line for lines in damaged.values() for line in lines]


def _checks_of(path: Path) -> Iterator[Check]:
    if not path.exists():
        raise OffpisteError("does not exist", where=path, how="name a run, a dataset or a PCA file")
    about = [path / name for name in ("config.json", "model.json") if (path / name).exists()]
    if path.is_file():
        if _may_be_pca(path):
            yield Check(path, load_pca)
    elif (path / "zarr.json").exists() or (path / CHECKSUMS).exists():
        yield from dataset_checks(path)
    elif about:
        yield from (Check(file, load_tensors) for file in sorted(path.glob("*.safetensors")))
        yield from (Check(file, load_json) for file in about)
        if path / "model.json" in about:
            yield Check(path, load_run)
    else:
        for below in sorted(path.iterdir()):
            if (below.is_dir() and not below.name.startswith(".")) or below.suffix == ".safetensors":
                yield from _checks_of(below)


def _may_be_pca(path: Path) -> bool:
    try:
        with open_tensors(path, "numpy") as file:
            return PCA_HEADER in (file.metadata() or {})
    except (OSError, SafetensorError):
        return True  # `load_pca` reports the damage
