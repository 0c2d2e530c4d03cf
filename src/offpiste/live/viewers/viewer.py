"""What a viewer is given of a drive, and which viewers there are."""

import socket
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib import colormaps

from offpiste.core.errors import LiveError
from offpiste.core.registry import Registry
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading

QUALITY: Final = 80
"""Quality of images, as JPEG has it."""
WIDEST: Final = 640
"""Images are shown no wider [px]."""
FASTEST: Final = 10.0
"""Speed at the upper end of the colours of a plan [m/s]."""
NUMBERS: Final = {"latencies": "latencies [ms]", "command": "command", "speed": "speed [m/s]"}
"""Kinds of numbers that are plotted, and titles of their plots."""


@dataclass(frozen=True)
class ShownPlan:
    """A plan as it is drawn.

    Attributes:
        time: of its first control [s].
        places: predicted ones, a little above the ground [m].
        speed: predicted at each [m/s].
        regions: closed lines around where the vehicle will be with a probability (`plan_regions.WITHIN`) [m]; empty
            where the run has no spread.
    """

    time: float
    places: Float[np.ndarray, "P 3"]
    speed: Float[np.ndarray, " P"]
    regions: tuple[Float[np.ndarray, "_ 3"], ...] = ()

    @property
    def colours(self) -> UInt8[np.ndarray, "P 3"]:
        """Colours of the places, by speed."""
        return (255 * colormaps["plasma"](np.clip(self.speed / FASTEST, 0, 1))[:, :3]).astype(np.uint8)


@dataclass(frozen=True)
class ShownGround:
    """Cells of the map as they are drawn.

    Attributes:
        time: of the newest scan in it [s].
        places: centres of the known cells, on the ground [m].
        layers: values at each cell, by name.
        colours: of each cell: obstacles where there are any, else the slope.
    """

    time: float
    places: Float[np.ndarray, "C 3"]
    layers: Mapping[str, Float[np.ndarray, " C"]]
    colours: UInt8[np.ndarray, "C 3"]


@runtime_checkable
class Viewer(Protocol):
    """Shows a drive; registered in `VIEWERS` by its name. Its calls may take their time: a process of its own waits.

    Args:
        place: where it listens, or what it writes; "" for its default.
        wheels: positions in the body frame [m].
        cameras: names of the cameras whose images are shown.

    Attributes:
        package: module that the extra `view` installs for it; "" for none.
        where: how to open it, in words.

    Raises:
        MissingExtra: the extra is not installed.
        LiveError: it cannot listen there.
    """

    package: ClassVar[str]
    where: str

    def __init__(self, place: str, wheels: Float[np.ndarray, "4 2"], cameras: tuple[str, ...]) -> None: ...

    def pose(self, reading: VehicleReading) -> None:
        """Show where the vehicle is."""
        ...

    def course(self, time: float, places: Float[np.ndarray, "P 3"]) -> None:
        """Show the course.

        Args:
            places: a little above the ground [m].
        """
        ...

    def plan(self, plan: ShownPlan) -> None:
        """Show a new plan; the last one vanishes."""
        ...

    def ground(self, ground: ShownGround) -> None:
        """Show a new map; the last one vanishes."""
        ...

    def image(self, image: Image) -> None:
        """Show the newest image of a camera."""
        ...

    def mode(self, time: float, mode: str, why: str) -> None:
        """Show that the mode, or the reason for it, has changed."""
        ...

    def numbers(self, time: float, kind: str, values: Mapping[str, float]) -> None:
        """Plot numbers.

        Args:
            kind: a key of `NUMBERS`.
        """
        ...

    def close(self) -> None:
        """End."""
        ...


VIEWERS: Final[Registry[type[Viewer]]] = Registry("viewer", package=__package__, error=LiveError)


def listening_at(place: str) -> tuple[str, int]:
    """Host and port of a place, which is free; port 0 is any free one.

    Raises:
        LiveError: no such place, or another program has it.
    """
    host, _, port = place.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise LiveError("is no host and port", where=f"--view-at {place}", how="give e.g. 127.0.0.1:8765")
    try:
        with socket.create_server((host, int(port))) as probe:
            return host, int(probe.getsockname()[1])
    except OSError as error:
        how = "end the other program, or give another --view-at HOST:PORT"
        reason = str(error.strerror).partition(" (")[0]  # Python adds the address, which is said before
        raise LiveError(f"cannot listen there: {reason}", where=place, how=how) from error


def jpeg_of(image: Image) -> bytes:
    """An image as JPEG, made smaller where it is wider than `WIDEST`."""
    scale = min(1.0, WIDEST / image.pixels.shape[1])
    pixels = (
        cv2.resize(image.pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image.pixels
    )
    data: Any = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    return bytes(data.tobytes())
