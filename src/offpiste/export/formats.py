"""Formats of exports: each writes its files into a folder, and registers where it is defined."""

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from offpiste._version import __version__
from offpiste.core.checksums import sha256_of
from offpiste.core.conventions import DT, WHEELS
from offpiste.core.errors import OffpisteError, RunError
from offpiste.core.files import check_folder, write_folder
from offpiste.core.registry import Registry
from offpiste.dynamics.header.step_text import absent_actuators
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.coverage import uncovered, uncovered_encoder
from offpiste.training.checkpoint import WEIGHTS, save_json
from offpiste.training.run import Run, load_run


@dataclass(frozen=True)
class ImageOptions:
    """What a user says of a format's images.

    Attributes:
        folder: of rectified pictures, which formats with less precision are calibrated with.
        size: width and height of rectified images [px]; None: the format's own.
    """

    folder: Path | None = None
    size: tuple[int, int] | None = None


Format = Callable[[Run, Path, ImageOptions], None]
"""Writes an export of a run into a folder that is there."""

FORMATS: Final[Registry[Format]] = Registry("export format", package=__package__)


def export_run(run: str | Path, to: Path, kind: str, images: ImageOptions = ImageOptions()) -> None:
    """Export a run; the folder is written whole or not at all.

    Args:
        run: folder that `offpiste train` wrote, or `pretrained:NAME`.
        to: folder to write, which is not there yet, or empty.
        kind: name of a format.
        images: of formats that read any.

    Raises:
        OffpisteError: no such format, no such run, a folder with files, or a model that the format cannot hold.
    """
    write = FORMATS[kind]
    check_folder(to, option="--to")
    if to.exists() and any(to.iterdir()):
        raise OffpisteError("has files already", where=to, how="give a folder that is empty or not there yet")
    loaded = load_run(run)
    loaded.dynamics.requires_grad_(False)
    to.parent.mkdir(parents=True, exist_ok=True)
    write_folder(to, lambda folder: write(loaded, folder, images))


def refuse_images(images: ImageOptions) -> None:
    """Raise where something is said of images to a format that reads none.

    Raises:
        OffpisteError: names the option.
    """
    if images.folder is not None:
        raise OffpisteError("--images is for --format onnx", where=images.folder, how="leave it out")
    if images.size is not None:
        raise OffpisteError("--size is for --format onnx", how="leave it out")


def size_of(text: str) -> tuple[int, int]:
    """Width and height [px] of "WIDTHxHEIGHT".

    Raises:
        OffpisteError: it is none.
    """
    numbers = re.fullmatch(r"([1-9]\d{0,3})x([1-9]\d{0,3})", text)
    if numbers is None:
        raise OffpisteError(f"--size is '{text}'", how="give width and height in pixels, 1 to 9999, as 640x360")
    return int(numbers[1]), int(numbers[2])


def refuse_without_kernels(run: Run) -> None:
    """Raise unless the model can be printed.

    Raises:
        RunError: no kernels can step it, or its encoder cannot be printed.
    """
    if reason := uncovered(run.dynamics) or uncovered_encoder(run.dynamics.encoder):
        how = "export a model with a bicycle, as b or dc, or call `predict` from Python"
        raise RunError(f"'{run.model}' has no kernels: {reason}", where=run.folder, how=how)


def write_about(run: Run, folder: Path, **more: Any) -> dict[str, Any]:
    """Write model.json: which run this is, and in which frames, units and order its numbers are."""
    dynamics = run.dynamics
    absent = [layout.STEPPED[row] for row in absent_actuators(dynamics)]
    about = {
        "offpiste": __version__,
        "model": run.model,
        "weights_sha256": sha256_of(run.folder / WEIGHTS),
        "vehicle": asdict(dynamics.vehicle),
        "features": list(run.features[: dynamics.vehicle.read]),
        "pca": run.pca,
        "step": DT,
        "state": list(layout.STEPPED),
        "absent_actuators": absent,
        "recurrent_units": dynamics.recurrent_size,
        "controls": list(dynamics.vehicle.control_columns),
        "wheels": list(WHEELS),
        "codes_per_wheel": dynamics.codes,
        "frames": "world: right-handed, z up; body: x forward, y left, z up; vx, vy: horizontal world velocity turned "
        "by minus yaw",
        "units": "SI units and radians; engine in 1000 rev/min; throttle, brake and brake pressure 0 to 1, steering "
        "command -1 to 1, + left; gear -1 (reverse), 0 (neutral) or 1 (forward)",
        **more,
    }
    save_json(folder / "model.json", about)
    return about
