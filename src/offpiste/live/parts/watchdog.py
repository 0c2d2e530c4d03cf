"""The watchdog: sends the stop once commands stop coming, whatever became of the process that makes them."""

import time
from pathlib import Path
from typing import Final

import numpy as np

from offpiste.conventions import DT
from offpiste.live.command_messages import Command, CommandMessages
from offpiste.live.packing import unpacked
from offpiste.live.part import Part
from offpiste.live.session import Session
from offpiste.rig.rig import load_rig

SILENCE: Final = 0.1
"""Time without a command, after which the stop is sent [s]."""
_AFTER: Final = 5.0
"""The stop is sent for so long after the parent is gone [s]."""


def watchdog(session: Session) -> None:
    """The process that watches over the commands."""
    part = Part("watchdog", session)
    rig, settings = load_rig(session.settings.rig), session.settings
    transport = settings.robot.connect([Path(name) for name in rig.live.definitions])
    outputs = CommandMessages(rig, transport.types)
    send = {topic: transport.publisher(topic, msgtype) for topic, msgtype in outputs.topics.items()}
    commands, stops, until = part.ring("commands"), 0, np.inf
    while time.monotonic() < until:
        if part.ending and until == np.inf:
            until = time.monotonic() + (_AFTER if part.orphaned else 2 * SILENCE)
        silent = commands.written > 0 and commands.age > SILENCE
        if silent and not (part.ending and not part.orphaned):
            newest = commands.newest()
            steer = 0.0 if newest is None else float(unpacked(newest.data)["applied"][2])
            stop = Command(part.now(), np.array((0.0, settings.runtime.stop, steer)))
            for topic, message in outputs.messages(stop).items():
                send[topic](message)
            stops += 1
        part.beat("stops the vehicle" if silent else "ready", stops=stops)
        time.sleep(DT)
    transport.close()
