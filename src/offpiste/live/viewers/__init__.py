"""Viewers of a drive for `offpiste live --view NAME`, one module each."""

import socket
from collections.abc import Mapping
from typing import Any, ClassVar, Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from offpiste.core.errors import LiveError
from offpiste.core.registry import Registry
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading

WIDEST: Final = 640
"""Maximum width of shown images [px]."""
_QUALITY: Final = 80
"""JPEG quality of images."""
NUMBERS: Final = {"latencies": "latencies [ms]", "command": "command", "speed": "speed [m/s]"}
"""Kinds of plotted numbers, and titles of their plots."""


class Line(NamedTuple):
    """Line slightly above the ground [m], with a colour for each point, and its width [m]."""

    places: Float[np.ndarray, "P 3"]
    colours: UInt8[np.ndarray, "P 3"]
    width: float

    @property
    def has_one_colour(self) -> bool:
        """Whether all points have the same colour."""
        return bool((self.colours == self.colours[:1]).all())


class Ground(NamedTuple):
    """Known cells of the map at the time of the newest scan [s]: centres [m], values by name, and colours."""

    time: float
    places: Float[np.ndarray, "C 3"]
    layers: Mapping[str, Float[np.ndarray, " C"]]
    colours: UInt8[np.ndarray, "C 3"]


class Viewer:
    """Viewer of a drive, registered in `VIEWERS`. Its methods may block: they run in a process of their own.

    Args:
        place: where it listens or writes; "" for its default.
        wheels: positions in the body frame [m].
        cameras: names of the cameras whose images are shown.

    Attributes:
        package: module that the extra `view` installs for it; "" for none.
        where: instructions for opening it.
    """

    package: ClassVar[str] = ""
    where: str

    def __init__(self, place: str, wheels: Float[np.ndarray, "4 2"], cameras: tuple[str, ...]) -> None:
        raise NotImplementedError

    def pose(self, reading: VehicleReading) -> None:
        """Show the vehicle's pose."""

    def line(self, name: str, time: float, line: Line) -> None:
        """Replace the line of the "course" or the "plan"."""

    def ground(self, ground: Ground) -> None:
        """Replace the shown map."""

    def image(self, image: Image) -> None:
        """Show the newest image of a camera."""

    def mode(self, time: float, mode: str, why: str) -> None:
        """Show a change of the mode or its reason."""

    def numbers(self, time: float, kind: str, values: Mapping[str, float]) -> None:
        """Plot numbers of a kind in `NUMBERS`."""

    def close(self) -> None:
        """Close the viewer."""


VIEWERS: Final[Registry[type[Viewer]]] = Registry("viewer", package=__name__, error=LiveError)


def listening_at(place: str) -> tuple[str, int]:
    """Return the free host and port of a place; port 0 selects a free one. Raises `LiveError`."""
    host, _, port = place.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise LiveError("not a host and port", where=f"--view-at {place}", how="give e.g. 127.0.0.1:8765")
    try:
        with socket.create_server((host, int(port))) as probe:
            return host, int(probe.getsockname()[1])
    except OSError as error:
        how = "end the other program, or give another --view-at HOST:PORT"
        reason = str(error.strerror).partition(" (")[0]  # without the address that Python adds
        raise LiveError(f"cannot listen there: {reason}", where=place, how=how) from error


def jpeg_of(image: Image) -> bytes:
    """Encode an image as JPEG, scaled down to `WIDEST`."""
    scale, pixels = min(1.0, WIDEST / image.pixels.shape[1]), image.pixels
    if scale < 1:
        pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    data: Any = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return bytes(data.tobytes())
