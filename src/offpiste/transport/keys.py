"""Keys and attachments of ROS 2 messages on zenoh, by the conventions of rmw_zenoh and of zenoh-bridge-ros2dds.

rmw_zenoh (ros2/rmw_zenoh) publishes on `DOMAIN/TOPIC/TYPE/HASH` and lists endpoints by liveliness tokens under
`@ros2_lv`. The bridge (eclipse-zenoh/zenoh-plugin-ros2dds) publishes on `NAMESPACE/TOPIC`; only its tokens state types.
"""

import struct
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

NO_HASH: Final = "TypeHashNotSupported"
"""Hash in the keys of ROS distributions that compute none (Humble)."""


@dataclass(frozen=True)
class Address:
    """Topic, type and hash of a key; "" for parts that the key lacks."""

    topic: str
    type: str = ""
    hash: str = ""


@dataclass(frozen=True)
class RmwZenohKeys:
    """Keys of rmw_zenoh in a ROS_DOMAIN_ID; `parsed` and `announced` return None for other keys and tokens."""

    domain: int = 0

    def publication(self, address: Address) -> str:
        """Return the key of a publisher: `DOMAIN/TOPIC/TYPE/HASH`."""
        return f"{self.domain}/{address.topic.strip('/')}/{dds_type(address.type)}/{address.hash}"

    def subscription(self, topic: str) -> str:
        """Return the key expression of a topic with any type and hash, so that a mismatch is refused with a reason."""
        return f"{self.domain}/{topic.strip('/')}/*/*"

    def parsed(self, key: str) -> Address | None:
        """Return topic, type and hash."""
        domain, _, rest = key.partition("/")
        parts = rest.rsplit("/", 2)
        if domain != str(self.domain) or len(parts) != 3:
            return None
        return Address(f"/{parts[0]}", ros_type(parts[1]), parts[2])

    def tokens(
        self, session: str, node: str, number: int, address: Address, *, publishes: bool, keep: bool = False
    ) -> list[str]:
        """Return the liveliness tokens of a node and one of its endpoints.

        Args:
            number: of the endpoint, unique in the session.
            publishes: whether it is a publisher.
            keep: whether it keeps its last message for later subscribers.
        """
        begin, named, kind = f"@ros2_lv/{self.domain}/{session}/0", f"%/%/{node}", "MP" if publishes else "MS"
        quality = f":{1 if keep else ''}:,{1 if keep else 10}:,:,:,,"
        what = f"{address.topic.replace('/', '%')}/{dds_type(address.type)}/{address.hash}"
        return [f"{begin}/0/NN/{named}", f"{begin}/{number}/{kind}/{named}/{what}/{quality}"]

    @property
    def publishers(self) -> str:
        """Key expression of the tokens of all publishers (kind MP)."""
        return f"@ros2_lv/{self.domain}/*/*/*/MP/**"

    def announced(self, token: str) -> Address | None:
        """Return topic, type and hash from a publisher's token."""
        parts = token.split("/")
        if len(parts) != 13:
            return None
        return Address(parts[9].replace("%", "/"), ros_type(parts[10]), parts[11])


@dataclass(frozen=True)
class BridgeKeys:
    """Keys of zenoh-bridge-ros2dds with its namespace, for robots on Fast DDS or Cyclone DDS."""

    namespace: str = ""

    def publication(self, address: Address) -> str:
        """Return the key of a publisher: namespace and topic."""
        return self.subscription(address.topic)

    def subscription(self, topic: str) -> str:
        """Return the key expression of a topic: namespace and topic."""
        return "/".join(part for part in (self.namespace.strip("/"), topic.strip("/")) if part)

    def parsed(self, key: str) -> Address | None:
        """Return the topic."""
        begin = self.subscription("") + "/" if self.namespace.strip("/") else ""
        return Address(f"/{key.removeprefix(begin)}") if key.startswith(begin) else None

    def tokens(
        self, session: str, node: str, number: int, address: Address, *, publishes: bool, keep: bool = False
    ) -> list[str]:
        """Return no tokens: the bridge declares those of the endpoints on DDS."""
        return []

    @property
    def publishers(self) -> str:
        """Key expression of the tokens of publishers on DDS."""
        return "@/*/@ros2_lv/MP/**"

    def announced(self, token: str) -> Address | None:
        """Return topic and type from `@/BRIDGE/@ros2_lv/MP/TOPIC/TYPE/QUALITY`, with § for / in names."""
        parts = [part.replace("§", "/") for part in token.split("/")]
        topic = self.parsed(parts[4]) if len(parts) == 7 else None
        return topic and Address(topic.topic, parts[5])


Keys = RmwZenohKeys | BridgeKeys


def dds_type(msgtype: str) -> str:
    """Convert `nav_msgs/msg/Odometry` to `nav_msgs::msg::dds_::Odometry_`."""
    package, kind, name = msgtype.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(dds: str) -> str:
    """Convert `nav_msgs::msg::dds_::Odometry_` to `nav_msgs/msg/Odometry`."""
    return dds.replace("::dds_::", "::").removesuffix("_").replace("::", "/")


_ATTACHMENT: Final = struct.Struct("<qqB16s")
"""Serialisation of two integers and 16 bytes after their length (33 bytes)."""


class Attachment(NamedTuple):
    """Sequence number of a message, sending time [ns since 1970], and GID of its publisher."""

    sequence: int
    sent: int
    publisher: bytes

    def packed(self) -> bytes:
        """Serialise it to 33 bytes."""
        return _ATTACHMENT.pack(self.sequence, self.sent, len(self.publisher), self.publisher)


def attachment_of(data: Any) -> Attachment:
    """Parse an attachment (bytes or zenoh's); return the number -1 for others (messages of the bridge have none)."""
    if data is not None and len(data) == _ATTACHMENT.size:
        sequence, sent, length, publisher = _ATTACHMENT.unpack(bytes(data))
        if length == len(publisher):
            return Attachment(sequence, sent, publisher)
    return Attachment(-1, 0, b"")
