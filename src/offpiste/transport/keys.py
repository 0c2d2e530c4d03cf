"""Where messages of ROS 2 are found on zenoh, and what goes with them: conventions of rmw_zenoh and of its bridge.

`rmw_zenoh` (ros2/rmw_zenoh): `DOMAIN/TOPIC/TYPE/HASH`; who is there is said by liveliness tokens under
`@ros2_lv`. The bridge (eclipse-zenoh/zenoh-plugin-ros2dds): `NAMESPACE/TOPIC`, types by tokens of the bridge alone.
With each message of rmw_zenoh go its number, the time it was sent, and the identity of its publisher.
"""

import struct
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, runtime_checkable

NO_HASH: Final = "TypeHashNotSupported"
"""What stands for the hash where the robot's ROS has none (Humble)."""


@dataclass(frozen=True)
class Address:
    """What a key says of a message; "" where it does not."""

    topic: str
    type: str = ""
    hash: str = ""


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscription of ours, as others list it.

    Attributes:
        number: of it in the session.
        publishes: whether it is a publisher.
        keep: whether it keeps its last message for those who come later.
    """

    number: int
    topic: str
    type: str
    hash: str
    publishes: bool
    keep: bool = False


@runtime_checkable
class Keys(Protocol):
    """A convention of keys."""

    def publication(self, address: Address) -> str:
        """Key on which a topic is published."""
        ...

    def subscription(self, topic: str) -> str:
        """Key expression of a topic, whatever type and hash it has."""
        ...

    def parsed(self, key: str) -> Address | None:
        """What a key says; None for one of another convention."""
        ...

    def tokens(self, session: str, node: str, endpoint: Endpoint) -> list[str]:
        """Liveliness tokens by which others list us."""
        ...

    @property
    def publishers(self) -> str:
        """Key expression of the tokens of all publishers."""
        ...

    def announced(self, token: str) -> Address | None:
        """Topic and type of a publisher's token."""
        ...


@dataclass(frozen=True)
class RmwZenohKeys:
    """Keys of rmw_zenoh.

    Attributes:
        domain: ROS_DOMAIN_ID.
    """

    domain: int = 0

    def publication(self, address: Address) -> str:
        """`DOMAIN/TOPIC/TYPE/HASH`."""
        return f"{self.domain}/{address.topic.strip('/')}/{dds_type(address.type)}/{address.hash}"

    def subscription(self, topic: str) -> str:
        """`DOMAIN/TOPIC/*/*`: what comes is compared with what is known, so that it can be said why it is refused."""
        return f"{self.domain}/{topic.strip('/')}/*/*"

    def parsed(self, key: str) -> Address | None:
        """Topic, type and hash."""
        domain, _, rest = key.partition("/")
        parts = rest.rsplit("/", 2)
        if domain != str(self.domain) or len(parts) != 3:
            return None
        return Address(f"/{parts[0]}", ros_type(parts[1]), parts[2])

    def tokens(self, session: str, node: str, endpoint: Endpoint) -> list[str]:
        """One of the node, and one of the endpoint."""
        begin, named = f"@ros2_lv/{self.domain}/{session}/0", f"%/%/{node}"
        kind = "MP" if endpoint.publishes else "MS"
        quality = f":{1 if endpoint.keep else ''}:,{1 if endpoint.keep else 10}:,:,:,,"
        what = f"{endpoint.topic.replace('/', '%')}/{dds_type(endpoint.type)}/{endpoint.hash}"
        return [f"{begin}/0/NN/{named}", f"{begin}/{endpoint.number}/{kind}/{named}/{what}/{quality}"]

    @property
    def publishers(self) -> str:
        """All tokens with the kind MP."""
        return f"@ros2_lv/{self.domain}/*/*/*/MP/**"

    def announced(self, token: str) -> Address | None:
        """From the token's last four parts: topic, type, hash, quality of service."""
        parts = token.split("/")
        if len(parts) != 13:
            return None
        return Address(parts[9].replace("%", "/"), ros_type(parts[10]), parts[11])


@dataclass(frozen=True)
class BridgeKeys:
    """Keys of zenoh-bridge-ros2dds, which carries the topics of a robot on Fast DDS or Cyclone DDS.

    Attributes:
        namespace: that the bridge is configured with.
    """

    namespace: str = ""

    def publication(self, address: Address) -> str:
        """The topic's name."""
        return self.subscription(address.topic)

    def subscription(self, topic: str) -> str:
        """The topic's name."""
        return "/".join(part for part in (self.namespace.strip("/"), topic.strip("/")) if part)

    def parsed(self, key: str) -> Address | None:
        """The topic alone."""
        begin = f"{self.namespace.strip('/')}/" if self.namespace.strip("/") else ""
        return Address(f"/{key.removeprefix(begin)}") if key.startswith(begin) else None

    def tokens(self, session: str, node: str, endpoint: Endpoint) -> list[str]:
        """None: the bridge declares tokens of what it finds on DDS, and carries what has its key."""
        return []

    @property
    def publishers(self) -> str:
        """Tokens of the publishers that bridges found on DDS."""
        return "@/*/@ros2_lv/MP/**"

    def announced(self, token: str) -> Address | None:
        """`@/BRIDGE/@ros2_lv/MP/TOPIC/TYPE/QUALITY`, with § for / in names."""
        parts = token.split("/")
        if len(parts) != 7:
            return None
        topic = self.parsed(parts[4].replace("§", "/"))
        return topic and Address(topic.topic, parts[5].replace("§", "/"))


def dds_type(msgtype: str) -> str:
    """`nav_msgs::msg::dds_::Odometry_` of `nav_msgs/msg/Odometry`."""
    package, kind, name = msgtype.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(dds: str) -> str:
    """`nav_msgs/msg/Odometry` of `nav_msgs::msg::dds_::Odometry_`."""
    return dds.replace("::dds_::", "::").removesuffix("_").replace("::", "/")


_ATTACHMENT: Final = struct.Struct("<qqB16s")
"""A zenoh serialisation of two numbers and 16 bytes, which have their length before them: 33 bytes."""
ATTACHMENT_SIZE: Final = _ATTACHMENT.size


class Attachment(NamedTuple):
    """Number of a message since its publisher began, time it was sent [ns since 1970], and its publisher's GID."""

    sequence: int
    sent: int
    publisher: bytes

    def packed(self) -> bytes:
        """As 33 bytes."""
        return _ATTACHMENT.pack(self.sequence, self.sent, len(self.publisher), self.publisher)


def attachment_of(data: bytes) -> Attachment | None:
    """The attachment in 33 bytes; None for anything else, as messages of the bridge have none."""
    if len(data) != ATTACHMENT_SIZE:
        return None
    sequence, sent, length, publisher = _ATTACHMENT.unpack(data)
    return Attachment(sequence, sent, publisher) if length == len(publisher) else None
