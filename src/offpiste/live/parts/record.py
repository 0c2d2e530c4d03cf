"""Records what is received and what is sent, as a log that `inspect`, `extract` and `live --replay` read."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from offpiste.core.errors import LogError
from offpiste.live.backlog import Backlog
from offpiste.live.lockstep import CLOCK, COMMAND
from offpiste.live.part import Part
from offpiste.live.parts.control import MODE
from offpiste.live.reception import Reception
from offpiste.live.recording import Recording
from offpiste.live.reports import DIAGNOSTICS, PLAN
from offpiste.live.session import Session
from offpiste.rig.rig import load_rig
from offpiste.transport.interface import Received

_WAITING: Final = 10_000
"""Messages that may wait for the disk."""
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


def record(session: Session) -> None:
    """The process that records; too little space on the disk ends it, and nothing else."""
    part = Part("record", session)
    given, rig = session.settings.record, load_rig(session.settings.rig)
    assert given is not None
    transport = session.settings.robot.connect([Path(name) for name in rig.live.definitions])
    reception = Reception(rig, session.settings.course, cameras=False)
    sent = (output.topic for output in rig.outputs.values())
    topics = dict.fromkeys((*rig.topics, *sent, COMMAND, PLAN, DIAGNOSTICS), False) | reception.topics
    topics |= {camera.info: True for camera in rig.cameras.values() if camera.info} | {MODE: True}
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
    repeated = [topic for topic, history in topics.items() if history]
    try:
        with closing(Recording(given, transport.types, repeated)) as recording:
            while not part.ended:  # the stop at the end is recorded, too
                if (received := waiting.get(0.1)) is not None:
                    recording.add(received)
                recording.look()
                refused = transport.refused.snapshot()
                part.beat(f"records {recording.path}", messages=recording.messages, refused=refused)
    except LogError as error:
        part.end_with(str(error))
    transport.close()
