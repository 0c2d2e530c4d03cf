"""Foxglove: a WebSocket server for the app (foxglove-sdk), by default on the loopback interface.

Clients cannot publish. Images are encoded only for subscribers. The server drops the oldest messages for a slow client.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final, cast

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LiveError, extra
from offpiste.live.viewers import NUMBERS, VIEWERS, Ground, Line, Viewer, jpeg_of, listening_at
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading

WORLD, BODY = "map", "base_link"
"""Frames."""
_WAITING: Final = 64
"""Maximum number of messages that wait for a client."""
_HEIGHT: Final = 1.0
"""Height of the box that represents the vehicle [m]."""
_ORANGE: Final = (230, 80, 30)
_MODE: Final = {"type": "object", "properties": {"mode": {"type": "string"}, "why": {"type": "string"}}}
_NUMBERS: Final = {"type": "object", "additionalProperties": {"type": "number"}}


@VIEWERS.register("foxglove")
class FoxgloveViewer(Viewer):
    """Server for the Foxglove app."""

    package: ClassVar[str] = "foxglove"

    def __init__(self, place: str, wheels: Float[np.ndarray, "4 2"], cameras: tuple[str, ...]) -> None:
        with extra("view"):
            import foxglove
            from foxglove import channels, messages
        # Channels are closed when their context is collected.
        self._made, self._context = messages, foxglove.Context()
        kinds = {"/tf": channels.FrameTransformChannel, "/pose": channels.PoseInFrameChannel}
        kinds |= {"/map": channels.PointCloudChannel}
        kinds |= dict.fromkeys(("/course", "/plan", "/vehicle"), channels.SceneUpdateChannel)
        kinds |= dict.fromkeys((f"/images/{name}" for name in cameras), channels.CompressedImageChannel)
        self._channels: dict[str, Any] = {topic: kind(topic, context=self._context) for topic, kind in kinds.items()}
        schemas = {"/mode": _MODE} | dict.fromkeys((f"/{kind}" for kind in NUMBERS), _NUMBERS)
        for topic, schema in schemas.items():
            self._channels[topic] = foxglove.Channel(topic, schema=schema, context=self._context)
        self._last: dict[str, tuple[Any, int]] = {}
        host, port = listening_at(place or "127.0.0.1:8765")
        try:
            self._server = foxglove.start_server(
                name="offpiste", host=host, port=port, context=self._context, message_backlog_size=_WAITING,
                server_listener=cast(Any, self),
            )  # fmt: skip
        except RuntimeError as error:
            raise LiveError(f"cannot listen: {error}", where=place, how="give another --view-at HOST:PORT") from error
        self.where = f"Foxglove on ws://{host}:{port} ({self._server.app_url()})"
        pose = self._upright(np.append(wheels.mean(axis=0), _HEIGHT / 2))
        length, width = np.ptp(wheels, axis=0)
        size = messages.Vector3(x=float(length), y=float(width), z=_HEIGHT)
        box = messages.CubePrimitive(pose=pose, size=size, color=self._colour(_ORANGE))
        entity = messages.SceneEntity(frame_id=BODY, id="/vehicle", frame_locked=True, cubes=[box])
        self._log("/vehicle", 0.0, messages.SceneUpdate(entities=[entity]))

    def pose(self, reading: VehicleReading) -> None:
        """Publish the transform from map to base_link, and the pose."""
        made, stamp = self._made, self._stamp(reading.time)
        place, turn = self._placed(reading.position, reading.orientation)
        transform = made.FrameTransform(
            timestamp=stamp, parent_frame_id=WORLD, child_frame_id=BODY, translation=place, rotation=turn
        )
        self._log("/tf", reading.time, transform)
        pose = made.Pose(position=place, orientation=turn)
        self._log("/pose", reading.time, made.PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=pose))

    def lines(self, name: str, time: float, lines: Sequence[Line]) -> None:
        """Publish lines that replace the previous ones."""
        made, drawn = self._made, []
        for line in lines:
            points = [made.Point3(x=x, y=y, z=z) for x, y, z in line.places.tolist()]
            colours = [self._colour(one) for one in line.colours]
            drawn.append(made.LinePrimitive(points=points, thickness=line.width, colors=colours))
        entity = made.SceneEntity(timestamp=self._stamp(time), frame_id=WORLD, id=f"/{name}", lines=drawn)
        self._log(f"/{name}", time, made.SceneUpdate(entities=[entity]))

    def ground(self, ground: Ground) -> None:
        """Publish the cells as points with the layers' values, relative to the first cell."""
        made, kind = self._made, self._made.PackedElementFieldNumericType
        origin = np.floor(ground.places[0]) if len(ground.places) else np.zeros(3)
        values = {**dict(zip("xyz", (ground.places - origin).T, strict=True)), **ground.layers}
        shades = dict(zip(("red", "green", "blue", "alpha"), (*ground.colours.T, 255), strict=True))
        points = np.zeros(len(ground.places), [(name, "<f4") for name in values] + [(name, "u1") for name in shades])
        for name, column in (values | shades).items():
            points[name] = column
        fields = [
            made.PackedElementField(name=name, offset=int(offset), type=kind.Float32 if name in values else kind.Uint8)
            for name, (_, offset, *_) in (points.dtype.fields or {}).items()
        ]
        cloud = made.PointCloud(
            timestamp=self._stamp(ground.time), frame_id=WORLD, pose=self._upright(origin),
            point_stride=points.dtype.itemsize, fields=fields, data=points.tobytes(),
        )  # fmt: skip
        self._log("/map", ground.time, cloud)

    def image(self, image: Image) -> None:
        """Publish an image if a client has subscribed to it."""
        topic = f"/images/{image.camera}"
        if topic in self._channels and self._channels[topic].has_sinks():
            stamp, data = self._stamp(image.time), jpeg_of(image)
            shown = self._made.CompressedImage(timestamp=stamp, frame_id=image.camera, data=data, format="jpeg")
            self._log(topic, image.time, shown)

    def mode(self, time: float, mode: str, why: str) -> None:
        """Publish mode and reason as JSON, for a panel of state transitions."""
        self._log("/mode", time, {"mode": mode, "why": why})

    def numbers(self, time: float, kind: str, values: Mapping[str, float]) -> None:
        """Publish numbers as JSON, for plots."""
        self._log(f"/{kind}", time, dict(values))

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Send the last message of a topic to a later subscriber; called in a thread of foxglove."""
        if channel.topic in self._last:
            message, nanoseconds = self._last[channel.topic]
            self._channels[channel.topic].log(message, log_time=nanoseconds)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Do nothing; foxglove requires it."""

    def _log(self, topic: str, time: float, message: Any) -> None:
        nanoseconds = max(round(time * 1e9), 0)
        self._last[topic] = message, nanoseconds
        self._channels[topic].log(message, log_time=nanoseconds)

    def _upright(self, position: Float[np.ndarray, " 3"]) -> Any:
        place, turn = self._placed(position, (0.0, 0.0, 0.0, 1.0))
        return self._made.Pose(position=place, orientation=turn)

    def _placed(self, position: Float[np.ndarray, " 3"], orientation: Any) -> tuple[Any, Any]:
        """Return a position and an orientation xyzw as messages."""
        place = self._made.Vector3(**{name: float(value) for name, value in zip("xyz", position, strict=True)})
        turn = self._made.Quaternion(**{name: float(value) for name, value in zip("xyzw", orientation, strict=True)})
        return place, turn

    def _stamp(self, time: float) -> Any:
        return self._made.Timestamp(*divmod(max(round(time * 1e9), 0), 10**9))

    def _colour(self, rgb: Any) -> Any:
        red, green, blue = (int(value) / 255 for value in rgb)
        return self._made.Color(r=red, g=green, b=blue, a=1.0)
