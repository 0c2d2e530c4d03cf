"""Known message types and their hashes: those of ROS 2, and others from their definition files."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

from offpiste.core.errors import TransportError
from offpiste.logs.ros.writer import new_typestore

_LONGEST: Final = 1 << 20
"""Maximum size of a definition file [bytes]."""


class MessageTypes:
    """Known message types, by names such as `nav_msgs/msg/Odometry`.

    Args:
        definitions: files `PACKAGE/msg/NAME.msg` of types that rosbags lacks; each after the types that it contains.

    Raises:
        TransportError: a file is unreadable or no definition.
    """

    def __init__(self, definitions: Sequence[str | Path] = ()) -> None:
        self.store = new_typestore()
        for file in definitions:
            self._register(Path(file))
        self.hash_of = cache(self._hash_of)

    def __contains__(self, msgtype: str) -> bool:
        return msgtype in self.store.types

    def _hash_of(self, msgtype: str) -> str:
        """Return a type's hash by REP 2011 (`RIHS01_` and the SHA-256 of its description).

        Raises:
            TransportError: the type, or one that it contains, is unknown.
        """
        try:
            return str(self.store.hash_rihs01(msgtype))
        except KeyError as error:
            how = "give the file of its definition in the rig: live.definitions"
            raise TransportError(f"message type {msgtype} is unknown", where=str(error.args[0]), how=how) from error

    def empty(self, msgtype: str) -> Any:
        """Return a message of zeros, empty strings and empty sequences."""
        fields = self.store.get_msgdef(msgtype).fields
        return self.store.types[msgtype](**{name: self._empty_field(*kind) for name, kind in fields})

    def _empty_field(self, kind: Any, detail: Any) -> Any:
        if kind == Nodetype.NAME:
            return self.empty(detail)
        if kind == Nodetype.BASE:
            name = detail[0]
            return "" if name == "string" else False if name == "bool" else 0.0 if name.startswith("float") else 0
        (inner, element), size = detail
        length = size if kind == Nodetype.ARRAY else 0
        if inner == Nodetype.BASE and element[0] != "string":
            return np.zeros(length, np.dtype({"byte": "u1", "char": "u1", "octet": "u1"}.get(element[0], element[0])))
        return [self._empty_field(inner, element) for _ in range(length)]

    def definition(self, msgtype: str) -> str:
        """Return a type's definition with its dependencies, in the format of MCAP files ("ros2msg")."""
        return str(self.store.generate_msgdef(msgtype, ros_version=2)[0])

    def decoded(self, msgtype: str, data: bytes) -> Any:
        """Decode a message; return None if that fails."""
        try:
            return self.store.deserialize_cdr(data, msgtype)
        except Exception:  # noqa: BLE001 - damaged bytes from outside make rosbags raise anything
            return None

    def _register(self, file: Path) -> None:
        how = "give a file PACKAGE/msg/NAME.msg of its package"
        try:
            text = file.read_bytes()[:_LONGEST].decode()
        except (OSError, UnicodeDecodeError) as error:
            raise TransportError(f"cannot read a message definition: {error}", where=file, how=how) from error
        if file.suffix != ".msg" or file.parent.name != "msg":
            raise TransportError("its path does not name the message type", where=file, how=how)
        name = f"{file.parent.parent.name}/msg/{file.stem}"
        try:
            self.store.register(get_types_from_msg(text, name))
            self.store.hash_rihs01(name)
        except Exception as error:  # rosbags parses and compiles it
            reason = " ".join(str(error).split())[:100]
            how = "list the definitions that it contains before it"
            raise TransportError(f"not a message definition: {reason}", where=file, how=how) from error
