"""Records what is received and what is sent, as a log that `inspect`, `extract` and `live --replay` read."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from offpiste.core.errors import LogError
from offpiste.live.backlog import Backlog
from offpiste.live.lockstep import CLOCK, COMMAND
from offpiste.live.part import Part, free_file
from offpiste.live.parts.control import MODE
from offpiste.live.reception import Reception
from offpiste.live.reports import DIAGNOSTICS, PLAN
from offpiste.live.session import Session
from offpiste.logs.ros.writer import McapWriter
from offpiste.rig.rig import load_rig
from offpiste.transport.interface import Received

_WAITING: Final = 10_000
"""Messages that may wait for the disk; where more do, the oldest are dropped, and counted."""
_SIZE: Final = 256 << 20
"""The same, of all of them [bytes]."""
_OURS: Final = {
    COMMAND: "sensor_msgs/msg/Joy",
    MODE: "std_msgs/msg/String",
    PLAN: "nav_msgs/msg/Path",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    CLOCK: "rosgraph_msgs/msg/Clock",
}
"""Types of what offpiste publishes, and of the clock, where keys do not say them."""


def record(session: Session, *, cameras: bool) -> None:
    """The process that records; a full disk ends it, and nothing else."""
    part = Part("record", session)
    given, rig = session.settings.record, load_rig(session.settings.rig)
    assert given is not None
    path = free_file(given)
    transport = session.settings.robot.connect([Path(name) for name in rig.live.definitions])
    reception = Reception(rig, session.settings.course, cameras=cameras)
    topics = dict(reception.topics)
    topics |= {camera.topic: False for camera in rig.cameras.values()}
    topics |= {camera.info: False for camera in rig.cameras.values() if camera.info}
    topics |= {output.topic: False for output in rig.outputs.values()}
    topics |= {COMMAND: False, MODE: True, PLAN: False, DIAGNOSTICS: False}
    if session.settings.clock == "clock":
        topics[CLOCK] = False
    waiting = Backlog(_WAITING, part.dropped, size=_SIZE, why="the disk is too slow")

    def deliver(received: Received) -> None:
        if session.settings.clock != "system":  # its stamps are of that time, and what replays it steps by it
            received = replace(received, received=part.now())
        if not np.isfinite(received.received) and not topics[received.topic]:
            part.dropped.add(f"{received.topic}: before the clock is known")
            return
        waiting.put(received)

    known = _OURS | {output.topic: output.type for output in rig.outputs.values()}
    for topic, history in topics.items():
        msgtype = reception.type_of(topic) or known.get(topic, "")
        transport.subscribe(topic, deliver, msgtype=msgtype, history=history)
    written, early = 0, list[Received]()
    try:
        with McapWriter(path) as writer:
            while not part.ended:  # the stop at the end is recorded, too
                received = waiting.get(0.1)
                early += [] if received is None else [received]
                if received is not None and np.isfinite(received.received):
                    for one in early:
                        definition = transport.types.definition(one.type)
                        time = one.received if np.isfinite(one.received) else received.received
                        writer.write_serialised(one.topic, one.type, one.data, definition, round(time * 1e9))
                    written += len(early)
                    early.clear()
                part.beat(f"records {path}", messages=written, refused=transport.refused.snapshot())
    except LogError as error:
        part.end_with(str(error))
    transport.close()
