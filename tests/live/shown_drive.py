"""Calls of a viewer during a drive far from the world's origin, and listening addresses."""

from pathlib import Path

import numpy as np

from offpiste.live.viewers import Ground, Line
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading

WHEELS = np.array([[1.03, 0.66], [1.03, -0.66], [-1.03, 0.66], [-1.03, -0.66]])
CAMERAS = ("front",)
ORIGIN = np.array((400_000.0, 5_000_000.0, 30.0))
LOOPBACK = "0100007F"


def show(viewer):
    """Show each element of a drive."""
    turned = np.array((0, 0, np.sin(0.5), np.cos(0.5)))
    viewer.pose(VehicleReading(1000.5, ORIGIN, turned, np.zeros(3), 0.0, np.zeros(4)))
    places = ORIGIN + np.column_stack((np.arange(50.0), np.zeros((50, 2))))
    shade = np.tile(np.array((1, 2, 3), np.uint8), (50, 1))
    viewer.line("course", 1000.5, Line(places, shade, 0.12))
    colours = np.arange(150, dtype=np.uint8).reshape(50, 3)
    viewer.line("plan", 1000.6, Line(places, colours, 0.16))
    viewer.ground(Ground(1000.4, places, {"slope": np.arange(50, dtype=np.float32)}, shade))
    viewer.image(Image(1000.3, "front", np.full((480, 960, 3), (200, 100, 50), np.uint8)))
    viewer.mode(1000.5, "stopping", "no plan")
    viewer.numbers(1000.5, "latencies", {"plan_ms": 80.0})
    viewer.numbers(1000.5, "speed", {"speed": 1.5})


def addresses_of(port):
    """Return the hexadecimal addresses on which a port is open."""
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return {row[1].split(":")[0] for row in rows if row[3] == "0A" and int(row[1].split(":")[1], 16) == port}
