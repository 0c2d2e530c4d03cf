"""Records what is received and what is sent, as a log that `inspect`, `extract` and `live --replay` read."""

import queue
from pathlib import Path

from offpiste.errors import LogError
from offpiste.live.lockstep import CLOCK, COMMAND
from offpiste.live.part import Part
from offpiste.live.parts.control import MODE
from offpiste.live.reception import Reception
from offpiste.live.reports import DIAGNOSTICS, PLAN
from offpiste.live.session import Session
from offpiste.logs.ros.writer import McapWriter
from offpiste.rig.rig import load_rig
from offpiste.transport.interface import Received

_WAITING = 400
"""Messages that may wait for the disk; more are dropped, and counted."""


def record(session: Session, *, cameras: bool) -> None:
    """The process that records; a full disk ends it, and nothing else."""
    part = Part("record", session)
    path, rig = session.settings.record, load_rig(session.settings.rig)
    assert path is not None
    transport = session.settings.robot.connect([Path(name) for name in rig.live.definitions])
    topics = dict(Reception(rig, session.settings.course, cameras=cameras).topics)
    topics |= {camera.topic: False for camera in rig.cameras.values()}
    topics |= {camera.info: False for camera in rig.cameras.values() if camera.info}
    topics |= {output.topic: False for output in rig.outputs.values()}
    topics |= {COMMAND: False, MODE: True, PLAN: False, DIAGNOSTICS: False}
    if session.settings.clock == "clock":
        topics[CLOCK] = False
    waiting: queue.Queue[Received] = queue.Queue(_WAITING)

    def deliver(received: Received) -> None:
        try:
            waiting.put_nowait(received)
        except queue.Full:
            part.dropped[f"{received.topic}: the disk is too slow"] += 1

    for topic, history in topics.items():
        transport.subscribe(topic, deliver, msgtype=rig.live.types.get(topic, ""), history=history)
    written = 0
    try:
        with McapWriter(path) as writer:
            while not part.ending:
                try:
                    received = waiting.get(timeout=0.1)
                except queue.Empty:
                    received = None
                if received is not None:
                    definition = transport.types.definition(received.type)
                    stamp = round(received.received * 1e9)
                    writer.write_serialised(received.topic, received.type, received.data, definition, stamp)
                    written += 1
                part.beat(f"records {path}", messages=written)
    except LogError as error:
        part.end_with(str(error))
    transport.close()
