"""Command `offpiste live`: checks of all settings, then a drive in real time or a replay."""

import logging
import tempfile
from dataclasses import replace
from pathlib import Path

from offpiste.core.errors import LiveError, require
from offpiste.live.command_messages import CommandMessages
from offpiste.live.reception import Reception, check_types
from offpiste.live.record import refuse_full_disk
from offpiste.live.replay import replay_log
from offpiste.live.session import LiveSettings, RecordSettings, refuse_unmeasured
from offpiste.live.supervisor import supervise
from offpiste.planning.caution import caution_of
from offpiste.planning.gpu import require_device
from offpiste.rig.rig import Rig, load_rig
from offpiste.runtime.settings import keeping_to
from offpiste.training.run import differing_vehicle
from offpiste.transport.message_types import MessageTypes

logger = logging.getLogger(__name__)


def run_live(settings: LiveSettings, *, replay: Path | None = None, commands: Path | None = None) -> None:
    """Drive, or watch.

    Args:
        replay: log that replaces the robot.
        commands: table of all commands of a replay to be written (.csv).

    Raises:
        OffpisteError: the rig, the run, the course, an option or the connection is invalid.
    """
    require("live", "zenoh")
    _refuse_ignored(settings, replay, commands)
    device = settings.runtime.device
    rig, planner = load_rig(settings.rig), settings.load_planner("cpu" if replay is None else device)
    require_device(device, planner.dynamics)
    runtime = keeping_to(replace(settings.runtime, timeouts=rig.live.timeouts), rig.live.limits)
    settings = replace(settings, runtime=runtime, cameras=planner.extractor is not None)
    _refuse_driving(settings, rig)
    types = MessageTypes(rig.live.definitions)
    check_types(rig, types)
    CommandMessages(rig, types)  # raises for outputs that cannot be sent
    caution_of(settings.runtime.risk, planner.spread)  # raises here, not in every process
    if (apart := differing_vehicle(planner.dynamics.vehicle, rig.vehicle)) is not None:
        logger.warning(f"{planner.folder} was trained on another vehicle than {settings.rig}: {apart}")
    if settings.view:
        _refuse_showing(settings.view, settings.view_at)
    if settings.record is not None:
        _refuse_recording(settings.record)
    reception = Reception(rig, settings.course, cameras=settings.cameras)
    refuse_unmeasured(planner, rig)
    if replay is None:
        supervise(settings)
    else:
        replay_log(settings, rig, planner, reception, types, replay, commands)


def _refuse_ignored(settings: LiveSettings, replay: Path | None, commands: Path | None) -> None:
    """Raise `LiveError` for options without effect."""
    in_real_time = {
        "--record": settings.record is not None,
        "--view": settings.view != "",
        f"--clock {settings.clock}": settings.clock != "system",
    }
    given = {"--commands": commands is not None} if replay is None else in_real_time
    if ignored := [option for option, is_given in given.items() if is_given]:
        where = "driving in real time" if replay is None else "--replay"
        raise LiveError(f"{' and '.join(ignored)} would have no effect", where=where, how="leave it out")
    if not settings.seconds > 0:
        raise LiveError(f"{settings.seconds:g} seconds", where="--seconds", how="give more than 0")


def _refuse_driving(settings: LiveSettings, rig: Rig) -> None:
    """Raise `LiveError` if commands or messages of the switch could not be exchanged with the vehicle."""
    if not settings.drive:
        return
    if not rig.outputs:
        how = "add the messages to the vehicle (docs/live.md), or leave out --drive"
        raise LiveError("the rig has no [outputs]", where=settings.rig, how=how)
    enable = rig.live.enable
    if enable is None:
        logger.warning(f"{settings.rig} has no [live.enable]: commands are sent without a dead man's switch")
    elif settings.robot.keys == "bridge" and enable.topic not in rig.live.types:
        how = f'add it to [live.types], e.g. "{enable.topic}" = "std_msgs/msg/Bool": the bridge does not state it'
        raise LiveError(f"the type of the enable topic {enable.topic} is unknown", where=settings.rig, how=how)


def _refuse_recording(settings: RecordSettings) -> None:
    """Raise `LiveError` or `LogError` for a recording that cannot be written."""
    path = settings.path
    if not (settings.free >= 0 and settings.size > 0 and settings.seconds > 0):
        given = f"--record-free {settings.free:g} --record-size {settings.size:g} --record-seconds {settings.seconds:g}"
        raise LiveError(given, where=path, how="give 0 GB or more to stay free, and a size and a time above 0")
    if path.suffix != ".mcap":
        raise LiveError("a recording is an MCAP file", where=path, how="give a name that ends with .mcap")
    if path.exists():
        raise LiveError("already exists", where=path, how="remove it, or give another name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise LiveError(f"cannot be written: {error.strerror}", where=path, how="give another name") from error
    refuse_full_disk(settings)


def _refuse_showing(view: str, view_at: str) -> None:
    """Raise `LiveError` or `MissingExtra` for a viewer that is unavailable, or cannot listen or write."""
    from offpiste.live.viewers import VIEWERS  # imports libraries that only a viewer needs

    if package := VIEWERS[view].package:
        require("view", package, otherwise="leave out --view")
    if view_at and Path(view_at).exists():
        raise LiveError("already exists", where=view_at, how="remove it, or give another name")
