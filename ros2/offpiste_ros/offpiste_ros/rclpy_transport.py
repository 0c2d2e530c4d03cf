"""ROS 2 by rclpy: a `Transport` of offpiste (`offpiste.transport.interface`).

Messages stay CDR on both sides: rclpy hands them over as bytes (`raw=True`) and publishes bytes as they are, so nothing
is converted, and offpiste decodes what it needs. Every process of a drive has a node of its own.
"""

import os
import threading
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any, Final

from offpiste.core.errors import MissingExtra, TransportError, is_installed
from offpiste.transport.interface import Deliver, Publish, Received, Tally
from offpiste.transport.message_types import MessageTypes

LARGEST: Final = 64 << 20
"""Messages above are refused [bytes]."""
LOOK: Final = 0.5
"""Time between two looks for the types of topics [s]."""


@dataclass(frozen=True)
class RclpySettings:
    """How a robot is reached by rclpy (`RobotSettings`).

    Attributes:
        run: what the names of all nodes of a drive begin with, so that its processes know each other's publishers.
    """

    run: str = field(default_factory=lambda: f"offpiste_{os.urandom(4).hex()}")

    @property
    def says_types(self) -> bool:
        """Whether publishers have it: always."""
        return True

    def require(self) -> None:
        """Check that the workspace is sourced."""
        if not is_installed("rclpy"):
            how = "source ROS's setup.bash, and run it with ROS's Python"
            raise MissingExtra("rclpy cannot be imported", how=how)

    def connect(self, definitions: Sequence[Path] = ()) -> "RclpyTransport":
        """A new node."""
        return RclpyTransport(self, definitions)

    def hosted(self) -> AbstractContextManager["RclpySettings"]:
        """The same: DDS has no router."""
        return nullcontext(self)


class RclpyTransport:
    """A node (a `Transport`).

    Args:
        definitions: files of message types that rosbags does not know; ROS has to know them, too.
    """

    def __init__(self, settings: RclpySettings, definitions: Sequence[Path] = ()) -> None:
        settings.require()
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self.refused = Tally()
        self.types, self._settings = MessageTypes(definitions), settings
        self._context = rclpy.Context()
        # Signals are offpiste's own business: Ctrl-C stops the vehicle before anything ends.
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(f"{settings.run}_{os.getpid()}", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._waiting: list[tuple[str, Deliver, str, bool]] = []
        self._names: dict[str, list[str]] = {}
        self._numbers = count()
        self._lock = threading.RLock()  # of both: they are used here and in the node's thread
        self._node.create_timer(LOOK, self._look)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    @property
    def identity(self) -> bytes:
        """What `Received.publisher` begins with for messages of this drive."""
        return self._settings.run.encode()[-8:]

    def publisher(self, topic: str, msgtype: str, *, keep: bool = False) -> Publish:
        """Function that publishes on a topic (see `Transport`)."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        if msgtype not in self.types:
            how = "give the file of its definition in the rig: live.definitions"
            raise TransportError(f"message type {msgtype} is unknown", where=topic, how=how)
        durability = DurabilityPolicy.TRANSIENT_LOCAL if keep else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=1 if keep else 10, durability=durability)
        publisher, store = self._node.create_publisher(_class_of(msgtype), topic, quality), self.types.store

        def publish(message: Any) -> None:
            publisher.publish(bytes(store.serialize_cdr(message, msgtype, little_endian=True)))

        return publish

    def subscribe(
        self, topic: str, deliver: Deliver, *, msgtype: str = "", history: bool = False, unchecked: bool = False
    ) -> None:
        """Have the messages of a topic delivered (see `Transport`).

        Where the type is not given, or messages before ours are asked for, this waits until a publisher is there: the
        type and the quality of service are its.
        """
        if msgtype and not history and not unchecked:
            self._subscribe(topic, deliver, msgtype, history=False)
            return
        wanted = (topic, deliver, msgtype, history)
        if unchecked:
            wanted = (topic, lambda one: deliver(replace(one, type="", data=b"")), "", False)
        with self._lock:
            self._waiting.append(wanted)

    def topics(self) -> dict[str, str]:
        """Topics that others publish, with their types."""
        found = {topic: kinds[0] for topic, kinds in self._node.get_topic_names_and_types() if kinds}
        return {topic: kind for topic, kind in found.items() if not self._ours(self._publishers(topic))}

    def routers(self) -> int:
        """1: DDS has no router that could be lost."""
        return 1

    def decode(self, message: Received) -> Any:
        """Decode a message; return None and count it if that fails."""
        decoded = self.types.decoded(message.type, message.data)
        if decoded is None:
            self.refused.add(f"{message.topic}: cannot be decoded")
        return decoded

    def close(self) -> None:
        """End the node."""
        self._executor.shutdown()
        self._thread.join(1.0)
        self._node.destroy_node()
        self._context.try_shutdown()

    def _look(self) -> None:
        """Subscribe to the topics whose publishers have come, and see who publishes what is heard."""
        with self._lock:
            self._names = {topic: self._publishers(topic) for topic in self._names}
            known, waiting, self._waiting = dict(self._node.get_topic_names_and_types()), self._waiting, []
            for wanted in waiting:
                topic, deliver, msgtype, history = wanted
                if not known.get(topic) or not self._publishers(topic):
                    self._waiting.append(wanted)
                    continue
                try:
                    self._subscribe(topic, deliver, msgtype or known[topic][0], history=history)
                except TransportError as error:  # from here it would end the node's thread
                    self.refused.add(f"{topic}: {error}")

    def _subscribe(self, topic: str, deliver: Deliver, msgtype: str, *, history: bool) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        if msgtype not in self.types:
            self.refused.add(f"{topic}: unknown type {msgtype}")
            return
        # Best effort hears every publisher, also one that comes later; what was kept only reliable ones are given.
        quality = QoSProfile(depth=10, durability=DurabilityPolicy.VOLATILE, reliability=ReliabilityPolicy.BEST_EFFORT)
        if history:
            durability, reliability = DurabilityPolicy.BEST_AVAILABLE, ReliabilityPolicy.BEST_AVAILABLE
            quality = QoSProfile(depth=10, durability=durability, reliability=reliability)

        def heard(data: bytes) -> None:
            if len(data) > LARGEST:
                self.refused.add(f"{topic}: too large")
                return
            names = self._names[topic] or self._publishers(topic)
            unknown = b"?%d" % next(self._numbers) if len(names) > 1 else b""
            publisher = self.identity if self._ours(names) else unknown
            deliver(Received(topic, msgtype, bytes(data), time.time(), publisher=publisher))

        kind = _class_of(msgtype)
        with self._lock:
            self._names[topic] = self._publishers(topic)
        self._node.create_subscription(kind, topic, heard, quality, raw=True)

    def _ours(self, names: list[str]) -> bool:
        """Whether a topic's publishers, of which there are some, are all of this drive.

        rclpy does not say who published a message; so with another publisher on the topic, or none that was found yet,
        all its messages count as another's. Where there are several, each message counts as one of another publisher.
        """
        return bool(names) and all(name.startswith(self._settings.run) for name in names)

    def _publishers(self, topic: str) -> list[str]:
        """Names of the nodes that publish a topic."""
        return [publisher.node_name for publisher in self._node.get_publishers_info_by_topic(topic)]


def _class_of(msgtype: str) -> Any:
    from rosidl_runtime_py.utilities import get_message

    try:
        return get_message(msgtype)
    except (AttributeError, ModuleNotFoundError, ValueError) as error:
        how = f"install its package: apt install ros-$ROS_DISTRO-{msgtype.split('/')[0].replace('_', '-')}"
        raise TransportError(f"ROS does not know message type {msgtype}", where="rclpy", how=how) from error
