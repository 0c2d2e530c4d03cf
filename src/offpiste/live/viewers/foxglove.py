"""Foxglove (foxglove-sdk): a WebSocket server for the app, by default on the loopback interface.

Clients cannot publish. Images are encoded only for subscribers. The server drops the oldest messages for a slow client.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Final, cast

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import extra
from offpiste.live.viewers import NUMBERS, VIEWERS, Ground, Line, Viewer, jpeg_of, listening_at
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading

WORLD, BODY = "map", "base_link"
"""Frames."""
_WAITING: Final = 64
"""Maximum number of messages that wait for a client."""
_HEIGHT: Final = 1.0
"""Height of the box that represents the vehicle [m]."""
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
        self._made, self._context = messages, foxglove.Context()  # its channels close when it is collected
        kinds: dict[str, Any] = {"/tf": channels.FrameTransformChannel, "/pose": channels.PoseInFrameChannel}
        kinds |= {"/map": channels.PointCloudChannel}
        kinds |= dict.fromkeys(("/course", "/plan", "/vehicle"), channels.SceneUpdateChannel)
        kinds |= dict.fromkeys((f"/images/{name}" for name in cameras), channels.CompressedImageChannel)
        self._channels: dict[str, Any] = {topic: kind(topic, context=self._context) for topic, kind in kinds.items()}
        for topic, schema in {"/mode": _MODE, **{f"/{kind}": _NUMBERS for kind in NUMBERS}}.items():
            self._channels[topic] = foxglove.Channel(topic, schema=schema, context=self._context)
        self._last: dict[str, tuple[Any, int]] = {}
        host, port = listening_at(place or "127.0.0.1:8765")
        self._server = foxglove.start_server(
            name="offpiste", host=host, port=port, context=self._context, message_backlog_size=_WAITING,
            server_listener=cast(Any, self),
        )  # fmt: skip
        self.where = f"Foxglove on ws://{host}:{port} ({self._server.app_url()})"
        box = messages.CubePrimitive(
            pose=self._pose(np.append(wheels.mean(axis=0), _HEIGHT / 2)),
            size=_filled(messages.Vector3, np.append(np.ptp(wheels, axis=0), _HEIGHT)),
            color=messages.Color(r=0.9, g=0.3, b=0.1, a=1.0),
        )
        self._draw("/vehicle", 0.0, BODY, frame_locked=True, cubes=[box])

    def pose(self, reading: VehicleReading) -> None:
        """Publish the pose, also as the transform from map to base_link."""
        made, stamp = self._made, self._stamp(reading.time)
        transform = made.FrameTransform(
            timestamp=stamp, parent_frame_id=WORLD, child_frame_id=BODY,
            translation=_filled(made.Vector3, reading.position), rotation=_filled(made.Quaternion, reading.orientation),
        )  # fmt: skip
        self._log("/tf", reading.time, transform)
        pose = self._pose(reading.position, reading.orientation)
        self._log("/pose", reading.time, made.PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=pose))

    def line(self, name: str, time: float, line: Line) -> None:
        """Publish a line that replaces the previous one."""
        made = self._made
        points = [_filled(made.Point3, place) for place in line.places]
        shown = line.colours[:1] if line.has_one_colour else line.colours
        colours = [made.Color(r=r, g=g, b=b, a=1.0) for r, g, b in (shown / 255).tolist()]
        given = {"color": colours[0]} if line.has_one_colour else {"colors": colours}
        self._draw(f"/{name}", time, WORLD, lines=[made.LinePrimitive(points=points, thickness=line.width, **given)])

    def ground(self, ground: Ground) -> None:
        """Publish the cells as points with the layers' values, relative to the first cell."""
        made, kinds = self._made, self._made.PackedElementFieldNumericType
        origin = np.floor(ground.places[0]) if len(ground.places) else np.zeros(3)
        names = ("x", "y", "z", *ground.layers)
        values = np.column_stack((ground.places - origin, *ground.layers.values())).astype("<f4")
        colours = np.pad(ground.colours, ((0, 0), (0, 1)), constant_values=255)
        data = np.hstack((values.view(np.uint8), colours))
        parts = [(name, 4 * k, kinds.Float32) for k, name in enumerate(names)]
        parts += [(name, 4 * len(names) + k, kinds.Uint8) for k, name in enumerate(("red", "green", "blue", "alpha"))]
        cloud = made.PointCloud(
            timestamp=self._stamp(ground.time), frame_id=WORLD, pose=self._pose(origin), point_stride=data.shape[1],
            fields=[made.PackedElementField(name=name, offset=offset, type=kind) for name, offset, kind in parts],
            data=data.tobytes(),
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

    def _draw(self, topic: str, time: float, frame: str, **shapes: Any) -> None:
        entity = self._made.SceneEntity(timestamp=self._stamp(time), frame_id=frame, id=topic, **shapes)
        self._log(topic, time, self._made.SceneUpdate(entities=[entity]))

    def _log(self, topic: str, time: float, message: Any) -> None:
        nanoseconds = max(round(time * 1e9), 0)
        self._last[topic] = message, nanoseconds
        self._channels[topic].log(message, log_time=nanoseconds)

    def _pose(self, position: Float[np.ndarray, " 3"], orientation: Any = (0.0, 0.0, 0.0, 1.0)) -> Any:
        turn = _filled(self._made.Quaternion, orientation)
        return self._made.Pose(position=_filled(self._made.Vector3, position), orientation=turn)

    def _stamp(self, time: float) -> Any:
        return self._made.Timestamp(*divmod(max(round(time * 1e9), 0), 10**9))


def _filled(kind: Any, values: Any) -> Any:
    """Return a message with the fields x, y, z and, for four values, w."""
    return kind(**{name: float(value) for name, value in zip("xyzw", values, strict=False)})
