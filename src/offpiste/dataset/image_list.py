"""Which images a PCA is fitted on, as a file that a person can read and change: a line "DRIVE CAMERA SECONDS" each."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from offpiste.errors import PerceptionError
from offpiste.files import write_text


class ListedImage(NamedTuple):
    """An image of a log.

    Attributes:
        drive: name of the log.
        camera: in the rig.
        time: the image's stamp [s].
    """

    drive: str
    camera: str
    time: float


def read_image_list(path: Path) -> list[ListedImage]:
    """Images of a list; blank lines and lines that begin with # are passed over.

    Raises:
        PerceptionError: no such file, a line of another form, or no image.
    """
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise PerceptionError(
            "no list of images can be read", where=path, how="give --images a number, or a file"
        ) from error
    found = []
    for number, line in enumerate(lines, start=1):
        words = line.rsplit(maxsplit=2)
        if not words or line.startswith("#"):
            continue
        try:
            drive, camera, seconds = words
            found.append(ListedImage(drive.strip(), camera, float(seconds)))
        except ValueError as error:
            raise PerceptionError(
                f"line {number}: '{line}' names no image", where=path, how="write DRIVE CAMERA SECONDS"
            ) from error
    if not found:
        raise PerceptionError("lists no image", where=path, how="write DRIVE CAMERA SECONDS, a line an image")
    return found


def write_image_list(path: Path, images: Iterable[ListedImage]) -> None:
    """Write a list."""
    write_text(path, "".join(f"{image.drive} {image.camera} {image.time:.6f}\n" for image in images))
