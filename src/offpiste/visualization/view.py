"""View a log or a dataset, whichever a path is."""

import logging
from pathlib import Path

import numpy as np

from offpiste.dataset.store import open_dataset
from offpiste.errors import DatasetError, LogError, RigError
from offpiste.logs.log import Log
from offpiste.logs.open import open_log
from offpiste.perception.feature_extractor import load_feature_extractor
from offpiste.rig.clock import Clock
from offpiste.rig.rig import load_rig
from offpiste.visualization.view_dataset import view_dataset
from offpiste.visualization.view_log import view_log

logger = logging.getLogger(__name__)


def parse_stretch(text: str) -> tuple[float, float]:
    """First and last second after the log's first pose, from "A:B", "A:" or ":B" [s]; all of it from "".

    Raises:
        LogError: not such a text, or nothing between.
    """
    first, colon, last = (text or ":").partition(":")
    try:
        start, end = float(first or 0.0), float(last or np.inf)
        if colon and 0 <= start < end:
            return start, end
    except ValueError:
        pass
    raise LogError(f"not a stretch: '{text}'", how="write --seconds A:B, A: or :B, seconds after the log's first pose")


def view(
    path: Path,
    out: Path,
    *,
    rig: str | None = None,
    pca: Path | None = None,
    seconds: str = "",
    rrd: bool = True,
    device: str = "cpu",
) -> list[Path]:
    """Write pictures of a log or a dataset into a folder; other files in it are left alone.

    Args:
        rig, pca, seconds, rrd, device: of a log: a preset's name or a file, a file of `fit-pca` (None: no features),
            a stretch "A:B", whether to write a Rerun recording, and where the backbone runs.

    Returns:
        what was written, each whole.

    Raises:
        LogError, RigError, PerceptionError, DatasetError: the path is neither, or cannot be viewed.
    """
    if out.exists() and not out.is_dir():
        raise DatasetError("is a file, not a folder for pictures", where=out, how="choose another --out")
    if (path / "zarr.json").exists():
        if rig or pca or seconds:
            logger.info(
                "a dataset is viewed whole, with the rig that it was made with: --rig, --pca and --seconds do nothing"
            )
        return view_dataset(open_dataset(path), out)
    stretch = parse_stretch(seconds)
    if rig is None:
        raise _without_rig(path)
    vehicle = load_rig(rig)
    extractor = load_feature_extractor(pca, device) if pca is not None else None
    log = _open(path, vehicle.clock)
    return view_log(log, vehicle, out, extractor=extractor, stretch=stretch, rrd=rrd)


def _without_rig(path: Path) -> RigError:
    _open(path)
    return RigError("a log is viewed through its rig", where=path, how="give --rig; `offpiste inspect` drafts one")


def _open(path: Path, clock: Clock | None = None) -> Log:
    if path.is_dir() and not any(path.iterdir()):
        raise LogError("an empty folder, neither a log nor a dataset", where=path)
    try:
        return open_log(path, clock=clock)
    except LogError as error:
        if error.what != "no known log format":
            raise
        raise LogError("neither a log of a known format nor a dataset", where=path, how=error.how) from error
