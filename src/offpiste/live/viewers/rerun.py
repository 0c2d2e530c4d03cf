"""Rerun (rerun-sdk): a server for its viewer, by default on the loopback interface, or a recording file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from offpiste.closed_loop.recording import LEVEL, PLOTS
from offpiste.core.errors import LiveError, extra
from offpiste.core.geometry import rotation_of_one
from offpiste.live.viewers import NUMBERS, VIEWERS, ShownGround, ShownPlan, jpeg_of, listening_at
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading
from offpiste.visualization.rerun_recording import EPOCH, following_eye

TIMELINE: Final = "robot"
"""Name of the timeline, the robot's clock."""
_MEMORY: Final = "256MiB"
"""Memory of the data sent to viewers that connect later; older data are dropped."""


@VIEWERS.register("rerun")
class RerunViewer:
    """Server for Rerun's viewer, or recording (a `Viewer`).

    Positions are relative to the first one, because viewers use float32.
    """

    package: ClassVar[str] = "rerun"

    def __init__(self, place: str, wheels: Float[np.ndarray, "4 2"], cameras: tuple[str, ...]) -> None:
        with extra("view"):
            import rerun as rr
        self._rr, self._origin = rr, np.zeros(3)
        self._placed = False
        if place.endswith(".rrd"):
            if Path(place).exists():
                raise LiveError("already exists", where=place, how="remove it, or give another name")
            sink: Any = rr.FileSink(place)
            self.where = f"Rerun: {place}"
        else:
            host, port = listening_at(place or "127.0.0.1:9876")
            sink = rr.GrpcServerSink(host, port, server_memory_limit=_MEMORY)
            self.where = f"Rerun: rerun {sink.uri}"
        self._stream = rr.RecordingStream("offpiste live")
        self._stream.set_sinks(sink, default_blueprint=_blueprint(cameras))
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._show_vehicle(wheels)

    def pose(self, reading: VehicleReading) -> None:
        """Log the vehicle's pose."""
        if not self._placed:
            self._origin, self._placed = reading.position.copy(), True
        self._at(reading.time)
        place = reading.position - self._origin
        turned = self._rr.Transform3D(translation=place, mat3x3=rotation_of_one(reading.orientation))
        self._stream.log("world/vehicle", turned)

    def course(self, time: float, places: Float[np.ndarray, "P 3"]) -> None:
        """Log the course as a line."""
        self._lines("world/course", time, [places], radii=0.06, colors=[255, 255, 255])

    def plan(self, plan: ShownPlan) -> None:
        """Log the predicted path, coloured by speed, and the regions of the vehicle's position."""
        pieces, shade = [], plan.colours[:-1]
        if len(plan.places) > 1:
            pieces = list(np.stack((plan.places[:-1], plan.places[1:]), axis=1))
        self._lines("world/plan", plan.time, pieces, radii=0.08, colors=shade)
        self._lines("world/plan_regions", plan.time, list(plan.regions), radii=0.025, colors=[20, 90, 200])

    def ground(self, ground: ShownGround) -> None:
        """Log known cells as points."""
        self._at(ground.time)
        places = (ground.places - self._origin).astype(np.float32)
        self._stream.log("world/map", self._rr.Points3D(places, colors=ground.colours, radii=0.1))

    def image(self, image: Image) -> None:
        """Log an image."""
        self._at(image.time)
        encoded = self._rr.EncodedImage(contents=jpeg_of(image), media_type="image/jpeg")
        self._stream.log(f"images/{image.camera}", encoded)

    def mode(self, time: float, mode: str, why: str) -> None:
        """Log a line of text, and the mode as a number."""
        self._at(time)
        self._stream.log("events", self._rr.TextLog(f"{mode}: {why}" if why else mode))
        if mode in LEVEL:
            self._stream.log("mode/mode", self._rr.Scalars([LEVEL[mode]]))  # type: ignore[index]

    def numbers(self, time: float, kind: str, values: Mapping[str, float]) -> None:
        """Log numbers as plots."""
        self._at(time)
        for name, value in values.items():
            self._stream.log(f"{kind}/{name}", self._rr.Scalars([value]))

    def close(self) -> None:
        """Write remaining data and disconnect."""
        self._stream.flush()
        self._stream.disconnect()

    def _show_vehicle(self, wheels: Float[np.ndarray, "4 2"]) -> None:
        rr, outline = self._rr, np.pad(wheels[[0, 1, 3, 2, 0]], ((0, 0), (0, 1)))
        frame = rr.LineStrips3D([outline], radii=0.06, colors=[230, 80, 30])
        self._stream.log("world/vehicle/frame", frame, static=True)

    def _lines(self, name: str, time: float, lines: list[np.ndarray], **look: Any) -> None:
        self._at(time)
        moved = [(line - self._origin).astype(np.float32) for line in lines]
        self._stream.log(name, self._rr.LineStrips3D(moved, **look))

    def _at(self, time: float) -> None:
        if time > EPOCH:
            self._stream.set_time(TIMELINE, timestamp=time)
        else:
            self._stream.set_time(TIMELINE, duration=time)


def _blueprint(cameras: tuple[str, ...]) -> Any:
    """Return the layout: the world from above the vehicle; beside it images, plots and changes of mode."""
    import rerun.blueprint as rrb

    eye = following_eye("/world/vehicle", np.zeros(3))
    world = rrb.Spatial3DView(origin="/world", name="world", eye_controls=eye, line_grid=False)
    images = [rrb.Spatial2DView(origin=f"/images/{name}", name=name) for name in cameras]
    titles = NUMBERS | {"mode": PLOTS["mode"]}
    plots = [rrb.TimeSeriesView(origin=f"/{kind}", name=title) for kind, title in titles.items()]
    events = rrb.TextLogView(origin="/events", name="changes of mode")
    whole = rrb.Horizontal(world, rrb.Vertical(*images, *plots, events), column_shares=[2, 1])
    return rrb.Blueprint(whole, rrb.TimePanel(timeline=TIMELINE, state="collapsed"), collapse_panels=True)
