"""ROS 2 over zenoh.

A router must run (`rmw_zenohd`, `zenohd`, or a session of mode "router"). Multicast is off. Only a router listens, on
the loopback interface unless another endpoint is given.
"""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any, Final, Literal

from offpiste.core.errors import extra
from offpiste.transport.keys import NO_HASH, Address, Attachment, BridgeKeys, Keys, RmwZenohKeys, attachment_of
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.received import Deliver, Publish, Received, Tally
from offpiste.transport.zenoh_session import Mode, opened_session, router_process

_GID: Final = 16
"""Length of a publisher's GID [bytes]."""


@dataclass(frozen=True)
class ZenohSettings:
    """Settings of the connection to a robot. They can be pickled: each process of a drive connects by itself."""

    endpoint: str = ""  # of the router to connect to, or to be
    mode: Mode = "client"  # or "router" to run the router as well, or "part": a client whatever `config` states
    keys: Literal["rmw_zenoh", "bridge"] = "rmw_zenoh"  # bridge: zenoh-bridge-ros2dds, whose keys state no types
    domain: int = 0  # ROS_DOMAIN_ID in rmw_zenoh's keys
    namespace: str = ""  # of the bridge
    config: str = ""  # zenoh's configuration (JSON5), e.g. with certificates; a given endpoint and mode override it
    largest: float = 64.0  # of messages [MiB]
    patient: bool = False  # whether publishers wait while a link is full instead of dropping the message
    identity: bytes = field(default_factory=lambda: os.urandom(_GID // 2))  # first 8 bytes of GIDs, equal in a drive

    @contextmanager
    def hosted(self) -> Iterator["ZenohSettings"]:
        """Return settings of clients; in mode "router" the router runs in its own process, which outlives this one."""
        is_router = self.mode == "router"
        with router_process(self.endpoint, self.config) if is_router else nullcontext(self.endpoint) as endpoint:
            yield replace(self, mode="part", endpoint=endpoint)


class ZenohTransport:
    """Connection to a robot: a zenoh session.

    Args:
        definitions: files of message types that rosbags lacks.

    Attributes:
        refused: number of messages that were not delivered, by topic and reason.
        types: known message types.
        identity: prefix of `Received.publisher` for messages from any process of this drive.

    Raises:
        MissingExtra: the extra `live` is not installed.
        TransportError: no router answers, or the configuration is invalid.
    """

    def __init__(self, settings: ZenohSettings | None = None, definitions: Sequence[str | Path] = ()) -> None:
        with extra("live"):
            import zenoh

        self.settings, self._zenoh = settings or ZenohSettings(), zenoh
        self.types, self.refused, self.identity = MessageTypes(definitions), Tally(), self.settings.identity
        given = self.settings
        self.keys: Keys = RmwZenohKeys(given.domain) if given.keys == "rmw_zenoh" else BridgeKeys(given.namespace)
        self._held, self._numbers = list[Any](), count(1)
        self._session = opened_session(given.endpoint, given.mode, given.config)
        self._session_id = str(self._session.info.zid())
        self._known: dict[str, str] = {}
        if given.keys == "bridge":  # its keys lack the type, which is announced once the robot's node runs
            token: Any = zenoh.handlers.Callback(lambda sample: self._learn(str(sample.key_expr)), indirect=False)
            tokens = self._session.liveliness().declare_subscriber(self.keys.publishers, token, history=True)
            self._held.append(tokens)

    def publisher(self, topic: str, msgtype: str, *, keep: bool = False) -> Publish:
        """Return a function that publishes on a topic.

        Args:
            msgtype: for example `nav_msgs/msg/Path`.
            keep: send the last message to later subscribers (durability "transient local").

        Raises:
            TransportError: the type is unknown.
        """
        send, store = self.raw_publisher(topic, msgtype, keep=keep), self.types.store

        def publish(message: Any) -> None:
            send(bytes(store.serialize_cdr(message, msgtype, little_endian=True)))

        return publish

    def raw_publisher(self, topic: str, msgtype: str, *, keep: bool = False) -> Publish:
        """Return a function that publishes serialised messages."""
        zenoh, number = self._zenoh, next(self._numbers)
        address = Address(topic, msgtype, self.types.hash_of(msgtype))
        key, gid = self.keys.publication(address), self.identity + os.urandom(4) + number.to_bytes(4, "little")
        if keep:
            cache = zenoh.ext.CacheConfig(1)
            publisher: Any = zenoh.ext.declare_advanced_publisher(
                self._session, key, cache=cache, publisher_detection=True
            )
        else:
            control = zenoh.CongestionControl
            full = control.BLOCK if self.settings.patient else control.DROP
            publisher = self._session.declare_publisher(key, congestion_control=full, express=True)
        self._announce(number, address, publishes=True, keep=keep)
        self._held.append(publisher)
        sequence, encoding = count(), zenoh.Encoding("application/cdr")

        def publish(data: bytes) -> None:
            attachment = Attachment(next(sequence), time.time_ns(), gid).packed()
            publisher.put(data, encoding=encoding, attachment=attachment)

        return publish

    def subscribe(
        self, topic: str, deliver: Deliver, *, msgtype: str = "", history: bool = False, unchecked: bool = False
    ) -> None:
        """Deliver the messages of a topic in their order.

        Args:
            msgtype: the only type that is accepted; "" accepts every known type.
            history: also request the last message kept by each publisher.
            unchecked: deliver messages of any type, without their data, to detect other publishers.
        """
        zenoh = self._zenoh

        def heard(sample: Any) -> None:
            received = time.time()
            try:
                if sample.kind == zenoh.SampleKind.PUT:
                    kind = "" if unchecked else self._accepted(topic, msgtype, sample)
                    if kind is not None:
                        attached = attachment_of(sample.attachment)
                        data = b"" if unchecked else bytes(sample.payload)
                        deliver(Received(topic, kind, data, received, attached.sequence, attached.publisher))
            except Exception as error:  # noqa: BLE001 - outside data must not end zenoh's thread
                self._refuse(topic, f"cannot be taken ({type(error).__name__})")

        # Called one after the other in zenoh's thread: the order across topics is that of arrival.
        handler = zenoh.handlers.Callback(heard, indirect=False)
        key, elsewhere = self.keys.subscription(topic), zenoh.Locality.REMOTE
        if history:
            past = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            subscriber: Any = zenoh.ext.declare_advanced_subscriber(
                self._session, key, handler, history=past, allowed_origin=elsewhere
            )
        else:
            subscriber = self._session.declare_subscriber(key, handler, allowed_origin=elsewhere)
        if msgtype:
            address = Address(topic, msgtype, self.types.hash_of(msgtype))
            self._announce(next(self._numbers), address, publishes=False)
        self._held.append(subscriber)

    def topics(self) -> dict[str, str]:
        """Return topics published by others, with their types, by their liveliness tokens."""
        replies = self._session.liveliness().get(self.keys.publishers, timeout=2.0)
        tokens = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
        found = [self.keys.announced(token) for token in tokens if self._session_id not in token]
        return {address.topic: address.type for address in found if address is not None}

    def routers(self) -> int:
        """Return the number of connected routers; 0 while the connection is lost."""
        return len(self._session.info.routers_zid())

    def decode(self, message: Received) -> Any:
        """Decode a message; return None and count it as refused if that fails."""
        decoded = self.types.decoded(message.type, message.data)
        if decoded is None:
            self._refuse(message.topic, "cannot be decoded")
        return decoded

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def _learn(self, token: str) -> None:
        if (address := self.keys.announced(token)) is not None:
            self._known[address.topic] = address.type

    def _accepted(self, topic: str, wanted: str, sample: Any) -> str | None:
        """Return the type of a message; None if it is refused."""
        address = self.keys.parsed(str(sample.key_expr))
        if address is None:
            return None
        msgtype = address.type or wanted or self._known.get(topic, "")
        if len(sample.payload) > self.settings.largest * 2**20:
            self._refuse(topic, "too large")
        elif (wanted and msgtype != wanted) or msgtype not in self.types:
            self._refuse(topic, f"{'of' if wanted else 'unknown'} type {msgtype[:80] or '(unknown)'}")
        elif address.hash not in ("", NO_HASH, self.types.hash_of(msgtype)):
            self._refuse(topic, "another definition of its type (its hash differs)")
        else:
            return msgtype
        return None

    def _refuse(self, topic: str, why: str) -> None:
        self.refused.add(f"{topic}: {why}")

    def _announce(self, number: int, address: Address, *, publishes: bool, keep: bool = False) -> None:
        tokens = self.keys.tokens(self._session_id, "offpiste", number, address, publishes=publishes, keep=keep)
        self._held += [self._session.liveliness().declare_token(token) for token in tokens]
