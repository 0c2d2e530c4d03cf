"""Foxglove: a WebSocket server for the app (foxglove-sdk), by default on the loopback interface.

Clients cannot publish. Images are encoded only for subscribers. The server drops the oldest messages for a slow client.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Final, cast

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LiveError, extra
from offpiste.live.viewers import NUMBERS, VIEWERS, ShownGround, ShownPlan, jpeg_of, listening_at
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading

WORLD, BODY = "map", "base_link"
"""Frames."""
_WAITING: Final = 64
"""Maximum number of messages that wait for a client."""
_HEIGHT: Final = 1.0
"""Height of the box that represents the vehicle [m]."""
WHITE, BLUE, ORANGE = (255, 255, 255), (20, 90, 200), (230, 80, 30)
_MODE: Final = {"type": "object", "properties": {"mode": {"type": "string"}, "why": {"type": "string"}}}
_NUMBERS: Final = {"type": "object", "additionalProperties": {"type": "number"}}


@VIEWERS.register("foxglove")
class FoxgloveViewer:
    """Server for the Foxglove app (a `Viewer`)."""

    package: ClassVar[str] = "foxglove"

    def __init__(self, place: str, wheels: Float[np.ndarray, "4 2"], cameras: tuple[str, ...]) -> None:
        with extra("view"):
            import foxglove
            from foxglove import channels, messages
        # Channels are closed when their context is collected.
        self._messages, self._context = messages, foxglove.Context()
        self._channels: dict[str, Any] = {
            "/tf": channels.FrameTransformChannel("/tf", context=self._context),
            "/pose": channels.PoseInFrameChannel("/pose", context=self._context),
            "/map": channels.PointCloudChannel("/map", context=self._context),
            "/mode": foxglove.Channel("/mode", schema=_MODE, context=self._context),
        }
        for topic in (f"/{kind}" for kind in NUMBERS):
            self._channels[topic] = foxglove.Channel(topic, schema=_NUMBERS, context=self._context)
        for topic in ("/course", "/plan", "/vehicle"):
            self._channels[topic] = channels.SceneUpdateChannel(topic, context=self._context)
        for topic in (f"/images/{name}" for name in cameras):
            self._channels[topic] = channels.CompressedImageChannel(topic, context=self._context)
        self._kept = _Kept(self._channels)
        host, port = listening_at(place or "127.0.0.1:8765")
        try:
            self._server = foxglove.start_server(
                name="offpiste", host=host, port=port, context=self._context, message_backlog_size=_WAITING,
                server_listener=cast(Any, self._kept),
            )  # fmt: skip
        except RuntimeError as error:
            raise LiveError(f"cannot listen: {error}", where=place, how="give another --view-at HOST:PORT") from error
        self.where = f"Foxglove on ws://{host}:{port} ({self._server.app_url()})"
        self._show_vehicle(wheels)

    def pose(self, reading: VehicleReading) -> None:
        """Publish the transform from map to base_link, and the pose."""
        made = self._messages
        stamp, place = _stamp(made, reading.time), _vector(made, reading.position)
        x, y, z, w = (float(value) for value in reading.orientation)
        turn = made.Quaternion(x=x, y=y, z=z, w=w)
        transform = made.FrameTransform(
            timestamp=stamp, parent_frame_id=WORLD, child_frame_id=BODY, translation=place, rotation=turn
        )
        self._log("/tf", reading.time, transform)
        pose = made.Pose(position=place, orientation=turn)
        self._log("/pose", reading.time, made.PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=pose))

    def course(self, time: float, places: Float[np.ndarray, "P 3"]) -> None:
        """Publish the course as a line."""
        self._scene("/course", time, [self._line(places, 0.12, WHITE)])

    def plan(self, plan: ShownPlan) -> None:
        """Publish the predicted path, coloured by speed, and the regions of the vehicle's position."""
        lines = [self._line(plan.places, 0.16, plan.colours)]
        lines += [self._line(region, 0.05, BLUE) for region in plan.regions]
        self._scene("/plan", plan.time, lines)

    def ground(self, ground: ShownGround) -> None:
        """Publish the cells as points with the layers' values, relative to the first cell."""
        made, kind = self._messages, self._messages.PackedElementFieldNumericType
        origin = np.floor(ground.places[0]) if len(ground.places) else np.zeros(3)
        names = ("x", "y", "z", *ground.layers)
        shades = ("red", "green", "blue", "alpha")
        points = np.zeros(len(ground.places), [(name, "<f4") for name in names] + [(name, "u1") for name in shades])
        for name, values in zip(names, (*(ground.places - origin).T, *ground.layers.values()), strict=True):
            points[name] = values
        for name, values in zip(shades, (*ground.colours.T, 255), strict=True):
            points[name] = values
        kinds = dict.fromkeys(names, kind.Float32) | dict.fromkeys(shades, kind.Uint8)
        fields = [
            made.PackedElementField(name=name, offset=int(offset), type=kinds[name])
            for name, (_, offset, *_) in (points.dtype.fields or {}).items()
        ]
        cloud = made.PointCloud(
            timestamp=_stamp(made, ground.time), frame_id=WORLD, pose=self._upright(origin),
            point_stride=points.dtype.itemsize, fields=fields, data=points.tobytes(),
        )  # fmt: skip
        self._log("/map", ground.time, cloud)

    def image(self, image: Image) -> None:
        """Publish an image if a client has subscribed to it."""
        topic = f"/images/{image.camera}"
        if topic in self._channels and self._channels[topic].has_sinks():
            made = self._messages
            stamp = _stamp(made, image.time)
            data = made.CompressedImage(timestamp=stamp, frame_id=image.camera, data=jpeg_of(image), format="jpeg")
            self._log(topic, image.time, data)

    def mode(self, time: float, mode: str, why: str) -> None:
        """Publish mode and reason as JSON, for a panel of state transitions."""
        self._log("/mode", time, {"mode": mode, "why": why})

    def numbers(self, time: float, kind: str, values: Mapping[str, float]) -> None:
        """Publish numbers as JSON, for plots."""
        self._log(f"/{kind}", time, dict(values))

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def _show_vehicle(self, wheels: Float[np.ndarray, "4 2"]) -> None:
        made = self._messages
        length, width = np.ptp(wheels, axis=0)
        pose = self._upright(np.append(wheels.mean(axis=0), _HEIGHT / 2))
        size = made.Vector3(x=float(length), y=float(width), z=_HEIGHT)
        box = made.CubePrimitive(pose=pose, size=size, color=_colour(made, ORANGE))
        entity = made.SceneEntity(frame_id=BODY, id="/vehicle", frame_locked=True, cubes=[box])
        self._log("/vehicle", 0.0, made.SceneUpdate(entities=[entity]))

    def _upright(self, position: Float[np.ndarray, " 3"]) -> Any:
        turn = self._messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        return self._messages.Pose(position=_vector(self._messages, position), orientation=turn)

    def _scene(self, topic: str, time: float, lines: list[Any]) -> None:
        """Publish lines that replace the topic's previous ones."""
        made = self._messages
        entity = made.SceneEntity(timestamp=_stamp(made, time), frame_id=WORLD, id=topic, lines=lines)
        self._log(topic, time, made.SceneUpdate(entities=[entity]))

    def _line(self, places: Float[np.ndarray, "P 3"], thickness: float, colour: Any) -> Any:
        """Return a line of one colour, or of a colour per point."""
        made = self._messages
        points = [made.Point3(x=x, y=y, z=z) for x, y, z in places.tolist()]
        if isinstance(colour, tuple):
            return made.LinePrimitive(points=points, thickness=thickness, color=_colour(made, colour))
        return made.LinePrimitive(points=points, thickness=thickness, colors=[_colour(made, one) for one in colour])

    def _log(self, topic: str, time: float, message: Any) -> None:
        self._kept.log(topic, max(round(time * 1e9), 0), message)


class _Kept:
    """Listener that sends the last message of a topic to later subscribers; called in a thread of foxglove."""

    def __init__(self, channels: Mapping[str, Any]) -> None:
        self._channels, self._last = channels, dict[str, tuple[Any, int]]()

    def log(self, topic: str, nanoseconds: int, message: Any) -> None:
        self._last[topic] = message, nanoseconds
        self._channels[topic].log(message, log_time=nanoseconds)

    def on_subscribe(self, client: Any, channel: Any) -> None:
        if channel.topic in self._last:
            message, nanoseconds = self._last[channel.topic]
            self._channels[channel.topic].log(message, log_time=nanoseconds)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        pass


def _stamp(made: Any, time: float) -> Any:
    seconds, rest = divmod(max(round(time * 1e9), 0), 10**9)
    return made.Timestamp(seconds, rest)


def _vector(made: Any, xyz: Float[np.ndarray, " 3"]) -> Any:
    x, y, z = (float(value) for value in xyz)
    return made.Vector3(x=x, y=y, z=z)


def _colour(made: Any, rgb: Any) -> Any:
    red, green, blue = (int(value) / 255 for value in rgb)
    return made.Color(r=red, g=green, b=blue, a=1.0)
