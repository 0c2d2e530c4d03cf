"""What goes with each message of rmw_zenoh: its number, the time it was sent, and the identity of its publisher."""

import struct
from typing import Final, NamedTuple

_LAYOUT: Final = struct.Struct("<qqB16s")
"""A zenoh serialisation of two numbers and 16 bytes, which have their length before them: 33 bytes."""
ATTACHMENT_SIZE: Final = _LAYOUT.size


class Attachment(NamedTuple):
    """Number of a message since its publisher began, time it was sent [ns since 1970], and its publisher's GID."""

    sequence: int
    sent: int
    publisher: bytes

    def packed(self) -> bytes:
        """As 33 bytes."""
        return _LAYOUT.pack(self.sequence, self.sent, len(self.publisher), self.publisher)


def unpacked(data: bytes) -> Attachment | None:
    """Of 33 bytes; None for anything else, as messages of the bridge have none."""
    if len(data) != _LAYOUT.size:
        return None
    sequence, sent, length, publisher = _LAYOUT.unpack(data)
    return Attachment(sequence, sent, publisher) if length == len(publisher) else None
