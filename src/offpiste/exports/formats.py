"""Registry of export formats, and the parts that all of them share."""

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
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.coverage import uncovered, uncovered_encoder
from offpiste.dynamics.kernels.networks import absent_actuators, units
from offpiste.training.checkpoint import WEIGHTS, save_json
from offpiste.training.run import Run, load_run


@dataclass(frozen=True)
class ImageOptions:
    """Options of formats that read images.

    Attributes:
        folder: rectified images for the calibration of int8 graphs.
        size: width and height of rectified images [px]; None for the default of the format.
    """

    folder: Path | None = None
    size: tuple[int, int] | None = None


Format = Callable[[Run, Path, ImageOptions], None]
"""Function that writes the export of a run into an existing folder."""

FORMATS: Final[Registry[Format]] = Registry("export format", package=__package__)


def export(run: str | Path, to: str | Path, kind: str = "c", images: ImageOptions = ImageOptions()) -> None:
    """Export a run; the folder is written whole or not at all.

        offpiste.export("pretrained:proving-ground/dc", "model-c")

    Args:
        run: folder of the run, or `pretrained:NAME`.
        to: folder to write; absent or empty.
        kind: "c", "cuda", "mppi-generic" or "onnx".

    Raises:
        OffpisteError: unknown format or run, a folder with files, or a model that the format does not support.
    """
    write, to = FORMATS[kind], Path(to)
    check_folder(to, option="--to")
    if to.exists() and any(to.iterdir()):
        raise OffpisteError("is not empty", where=to, how="give an empty or new folder")
    loaded = load_run(run)
    loaded.dynamics.requires_grad_(False)
    to.parent.mkdir(parents=True, exist_ok=True)
    write_folder(to, lambda folder: write(loaded, folder, images))


def refuse_images(images: ImageOptions) -> None:
    """Raise `OffpisteError` if image options were given to a format without images."""
    for option, value in (("--images", images.folder), ("--size", images.size)):
        if value is not None:
            raise OffpisteError(f"{option} is for --format onnx", how="leave it out")


def size_of(text: str) -> tuple[int, int]:
    """Parse "WIDTHxHEIGHT" [px].

    Raises:
        OffpisteError: the text has another form.
    """
    numbers = re.fullmatch(r"([1-9]\d{0,3})x([1-9]\d{0,3})", text)
    if numbers is None:
        raise OffpisteError(f"invalid --size '{text}'", how="give width and height in pixels, 1 to 9999, as 640x360")
    return int(numbers[1]), int(numbers[2])


def refuse_without_kernels(run: Run) -> None:
    """Raise `RunError` if no C code can be generated for the model or its encoder."""
    if reason := uncovered(run.dynamics) or uncovered_encoder(run.dynamics.encoder):
        how = "export a model with a bicycle, as b or dc, or call `predict` from Python"
        raise RunError(f"'{run.model}' has no kernels: {reason}", where=run.folder, how=how)


def write_about(run: Run, folder: Path, **more: Any) -> dict[str, Any]:
    """Write model.json with the run's identity and the units, frames and order of its numbers."""
    dynamics = run.dynamics
    about = {
        "offpiste": __version__,
        "model": run.model,
        "weights_sha256": sha256_of(run.folder / WEIGHTS),
        "vehicle": asdict(dynamics.vehicle),
        "features": list(run.features[: dynamics.vehicle.read]),
        "pca": run.pca,
        "step": DT,
        "state": list(layout.STEPPED),
        "absent_actuators": [layout.STEPPED[row] for row in absent_actuators(dynamics.vehicle)],
        "recurrent_units": units(dynamics),
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
