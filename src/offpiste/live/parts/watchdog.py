"""The watchdog: sends the stop once commands stop coming, whatever became of the process that makes them."""

import shutil
import time
from pathlib import Path
from typing import Final

import numpy as np

from offpiste.core.conventions import DT
from offpiste.live.command_messages import Command, CommandMessages
from offpiste.live.part import Part, keep_loaded
from offpiste.live.parts.setup import last_command
from offpiste.live.session import Session
from offpiste.rig.rig import load_rig

SILENCE: Final = 0.1
"""Time without a command, after which the stop is sent [s]."""
ENDS: Final = 5.0
"""At the end of a drive, control stops the vehicle for so long at most [s]."""
_LAST: Final = 0.5
"""The watchdog sends the stop for so long after control has ended [s]: the last that is heard is a stop."""


def watchdog(session: Session) -> None:
    """The process that watches over the commands, until the vehicle was stopped."""
    part = Part("watchdog", session)
    rig, settings = load_rig(session.settings.rig), session.settings
    transport = settings.robot.connect([Path(name) for name in rig.live.definitions])
    outputs = CommandMessages(rig, transport.types)
    send = {topic: transport.publisher(topic, msgtype) for topic, msgtype in outputs.topics.items()}
    commands, stops, ends = part.ring("commands"), 0, np.inf
    for name in ("stops", "clock", "end"):  # now: once the parent is gone, nobody keeps their files
        part.ring(name)
    keep_loaded()
    while not _is_over(part, time.monotonic() - ends):
        if ends == np.inf and part.ending:
            ends = time.monotonic()
        silent = commands.written > 0 and commands.age > SILENCE
        if silent:
            last = last_command(part)
            stop = Command(part.now(), np.array((0.0, settings.runtime.stop, last["applied"][2])), last["gear"])
            for topic, message in outputs.messages(stop).items():
                send[topic](message)
            part.hand_on("stops", b"stop")  # control completes it, once it is back
            stops += 1
        part.beat("stops the vehicle" if silent else "ready", stops=stops)
        time.sleep(DT)
    transport.close()
    if part.orphaned:  # nobody else is left to do so
        shutil.rmtree(session.folder, ignore_errors=True)


def _is_over(part: Part, since: float) -> bool:
    """Whether the vehicle has been stopped.

    Args:
        since: the end of the drive [s]; minus infinity before it.
    """
    commands = part.ring("commands")
    if since < 0:
        return False
    if commands.written == 0:
        return since > SILENCE
    at_standstill = last_command(part)["mode"] == "stopped"
    return (at_standstill and commands.age > SILENCE + _LAST) or since > ENDS + 2.0
