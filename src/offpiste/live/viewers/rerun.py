"""Rerun (rerun-sdk): a server for its viewer, by default on the loopback interface, or a recording file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LiveError, extra
from offpiste.core.geometry import rotation_of_one
from offpiste.live.viewers import NUMBERS, VIEWERS, Ground, Line, Viewer, jpeg_of, listening_at
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading
from offpiste.visualization.rerun_recording import EPOCH, following_eye

LEVEL: Final = {"stopped": 0, "stopping": 1, "degraded": 2, "driving": 3}
"""Mode as a number to plot."""
TIMELINE: Final = "robot"
"""Name of the timeline, the robot's clock."""
_MEMORY: Final = "256MiB"
"""Memory of the data sent to viewers that connect later; older data are dropped."""


@VIEWERS.register("rerun")
class RerunViewer(Viewer):
    """Server for Rerun's viewer, or recording. Positions are relative to the first one: viewers use float32."""

    package: ClassVar[str] = "rerun"

    def __init__(self, place: str, wheels: Float[np.ndarray, "4 2"], cameras: tuple[str, ...]) -> None:
        with extra("view"):
            import rerun as rr
        self._rr = rr
        self._origin: Float[np.ndarray, " 3"] | None = None
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
        outline = np.pad(wheels[[0, 1, 3, 2, 0]], ((0, 0), (0, 1)))
        frame = rr.LineStrips3D([outline], radii=0.06, colors=[230, 80, 30])
        self._stream.log("world/vehicle/frame", frame, static=True)

    def pose(self, reading: VehicleReading) -> None:
        """Log the vehicle's pose."""
        place = self._placed(reading.position)
        turned = self._rr.Transform3D(translation=place, mat3x3=rotation_of_one(reading.orientation))
        self._log("world/vehicle", reading.time, turned)

    def line(self, name: str, time: float, line: Line) -> None:
        """Log a line of one colour, or pieces with the colour of their first point; they replace the previous ones."""
        places, one = self._placed(line.places).astype(np.float32), line.has_one_colour
        strips = places[None] if one else np.stack((places[:-1], places[1:]), axis=1)
        colours = line.colours[:1] if one else line.colours[:-1]
        self._log(f"world/{name}", time, self._rr.LineStrips3D(strips, colors=colours, radii=line.width / 2))

    def ground(self, ground: Ground) -> None:
        """Log known cells as points."""
        places = self._placed(ground.places).astype(np.float32)
        self._log("world/map", ground.time, self._rr.Points3D(places, colors=ground.colours, radii=0.1))

    def image(self, image: Image) -> None:
        """Log an image."""
        encoded = self._rr.EncodedImage(contents=jpeg_of(image), media_type="image/jpeg")
        self._log(f"images/{image.camera}", image.time, encoded)

    def mode(self, time: float, mode: str, why: str) -> None:
        """Log a line of text, and the mode as a number."""
        self._log("events", time, self._rr.TextLog(f"{mode}: {why}" if why else mode))
        if mode in LEVEL:
            self._log("mode/mode", time, self._rr.Scalars([LEVEL[mode]]))

    def numbers(self, time: float, kind: str, values: Mapping[str, float]) -> None:
        """Log numbers as plots."""
        for name, value in values.items():
            self._log(f"{kind}/{name}", time, self._rr.Scalars([value]))

    def close(self) -> None:
        """Write remaining data and disconnect."""
        self._stream.flush()
        self._stream.disconnect()

    def _placed(self, places: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Return positions relative to the first one."""
        if self._origin is None:
            self._origin = places.reshape(-1, 3)[0].copy()
        return places - self._origin

    def _log(self, name: str, time: float, data: Any) -> None:
        given = {"timestamp": time} if time > EPOCH else {"duration": time}
        self._stream.set_time(TIMELINE, **given)
        self._stream.log(name, data)


def _blueprint(cameras: tuple[str, ...]) -> Any:
    """Return the layout: the world from above the vehicle; beside it images, plots and changes of mode."""
    import rerun.blueprint as rrb

    eye = following_eye("/world/vehicle", np.zeros(3))
    world = rrb.Spatial3DView(origin="/world", name="world", eye_controls=eye, line_grid=False)
    images = [rrb.Spatial2DView(origin=f"/images/{name}", name=name) for name in cameras]
    titles = NUMBERS | {"mode": "mode: 3 driving, 2 degraded, 1 stopping, 0 stopped"}
    plots = [rrb.TimeSeriesView(origin=f"/{kind}", name=title) for kind, title in titles.items()]
    events = rrb.TextLogView(origin="/events", name="changes of mode")
    whole = rrb.Horizontal(world, rrb.Vertical(*images, *plots, events), column_shares=[2, 1])
    return rrb.Blueprint(whole, rrb.TimePanel(timeline=TIMELINE, state="collapsed"), collapse_panels=True)
