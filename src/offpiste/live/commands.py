"""Commands `offpiste live` and `offpiste play`."""

import csv
import logging
import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError, require
from offpiste.core.files import write_whole
from offpiste.core.progress import track
from offpiste.live.command_messages import CommandMessages
from offpiste.live.lockstep import Lockstep, OnStep, Step, StepDriver
from offpiste.live.part import freeze_loaded_objects
from offpiste.live.play import LogPlayer, RecordedDrive, replayed
from offpiste.live.reception import Reception, check_types
from offpiste.live.record import refuse_full_disk
from offpiste.live.session import LiveSettings, RecordSettings, ViewSettings
from offpiste.live.supervisor import end_requested, supervise
from offpiste.planning.caution import caution_of
from offpiste.planning.gpu import require_device
from offpiste.rig.rig import Rig, load_rig
from offpiste.runtime.settings import keeping_to
from offpiste.training.run import differing_vehicle
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport

logger = logging.getLogger(__name__)


def run_live(settings: LiveSettings, *, lockstep: bool, replay: Path | None, commands: Path | None) -> None:
    """Drive, or watch.

    Raises:
        OffpisteError: the rig, the run, the course, an option or the connection is invalid.
    """
    settings.robot.require()
    in_real_time = not lockstep and replay is None
    _refuse_ignored(settings, lockstep=lockstep, replay=replay, commands=commands)
    device = settings.runtime.device
    rig, planner = load_rig(settings.rig), settings.load_planner("cpu" if in_real_time else device)
    require_device(device, planner.dynamics)
    runtime = keeping_to(replace(settings.runtime, timeouts=rig.live.timeouts), rig.live.limits)
    settings = replace(settings, runtime=runtime)
    _refuse_driving(settings, rig)
    definitions = [Path(name) for name in rig.live.definitions]
    types = MessageTypes(definitions)
    check_types(rig, types)
    CommandMessages(rig, types)  # raises for outputs that cannot be sent
    caution_of(settings.runtime.risk, planner.spread)  # raises here, not in every process
    if (apart := differing_vehicle(planner.dynamics.vehicle, rig.vehicle)) is not None:
        logger.warning(f"{planner.folder} was trained on another vehicle than {settings.rig}: {apart}")
    if settings.view is not None:
        _refuse_showing(settings.view, in_real_time=in_real_time)
    if settings.record is not None:
        _refuse_recording(settings.record)
    reception = Reception(rig, settings.course, cameras=planner.extractor is not None)
    driver = StepDriver(rig, planner, reception, settings.runtime, shadow=not settings.drive, seed=settings.seed)
    with _table_of(commands) as on_step:
        if replay is not None:
            _replay(settings, rig, driver, reception, types, replay, on_step)
        elif lockstep:
            with end_requested() as asked, closing(settings.robot.connect(definitions)) as transport:
                outputs = CommandMessages(rig, transport.types) if settings.drive else None
                Lockstep(transport, driver, reception, outputs).run(on_step, asked, settings.seconds)
                for what, count in sorted(transport.refused.items()):
                    logger.warning(f"refused {count} messages: {what}")
        else:
            supervise(settings, planner, definitions)
    for name in reception.sensors.left_out:
        logger.warning(f"optional sensor {name} was left out: it was first heard after the setup of the others")


def _refuse_ignored(settings: LiveSettings, *, lockstep: bool, replay: Path | None, commands: Path | None) -> None:
    """Raise `LiveError` for options without effect."""
    mode = "--replay" if replay is not None else "--lockstep" if lockstep else "driving in real time"
    given = {
        "--lockstep": lockstep and replay is not None,
        "--record": settings.record is not None and mode != "driving in real time",
        "--status": settings.status is not None and mode != "driving in real time",
        "--commands": commands is not None and mode == "driving in real time",
        f"--clock {settings.clock}": settings.clock != "system" and mode == "--replay",
        "--clock stamps": settings.clock == "stamps" and mode == "--lockstep",
    }
    if ignored := [option for option, is_ignored in given.items() if is_ignored]:
        raise LiveError(f"{' and '.join(ignored)} would have no effect", where=mode, how="leave it out")
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
    elif not settings.robot.says_types and enable.topic not in rig.live.types:
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
    except OSError as error:
        raise LiveError(f"cannot be written: {error.strerror}", where=path, how="give another name") from error
    if not os.access(path.parent, os.W_OK):
        raise LiveError("cannot be written: the folder is read-only", where=path, how="give another name")
    refuse_full_disk(settings)


def _refuse_showing(view: ViewSettings, *, in_real_time: bool) -> None:
    """Raise `LiveError` or `MissingExtra` for a viewer that is unavailable, or cannot show or write anything."""
    from offpiste.live.viewers import VIEWERS

    if not in_real_time:
        raise LiveError("only a live drive is shown", where="--view", how="leave it out, or use `offpiste view LOG`")
    if package := VIEWERS[view.name].package:
        require("view", package, otherwise="leave out --view")
    if view.place and Path(view.place).exists():
        raise LiveError("already exists", where=view.place, how="remove it, or give another name")


def _replay(
    settings: LiveSettings, rig: Rig, driver: StepDriver, reception: Reception, types: MessageTypes, log: Path,
    on_step: OnStep,
) -> None:  # fmt: skip
    drive = RecordedDrive(log, rig, tuple(reception.topics))
    steps = replayed(drive, driver, types)
    total = round(min(drive.seconds, settings.seconds) / DT)
    for _, (now, step) in zip(track(range(total + 1), f"replay {log.name}"), steps, strict=False):
        on_step(now, step)
    if driver.runtime is None:
        what = f"planning was never possible: the log lacks {reception.waiting_for}"
        raise LiveError(what, where=log, how="see docs/live.md")


@contextmanager
def _table_of(path: Path | None) -> Iterator[OnStep]:
    """Collect steps, and write them as a table at the end."""
    rows: list[tuple[str, ...]] = []

    def on_step(now: float, step: Step | None) -> None:
        if step is not None and path is not None:
            control = (repr(float(value)) for value in step.command.control)
            rows.append((repr(now), *control, step.controls.mode, step.controls.why or step.why))

    try:
        yield on_step
    finally:
        if path is not None and rows:
            write_whole(path, lambda partial: _write(partial, rows))


def _write(path: Path, rows: list[tuple[str, ...]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("time", "throttle", "brake", "steer", "mode", "why"), *rows])


def play_log(
    log: Path, rig: str, robot: ZenohSettings, rate: float, seconds: float, *, lockstep: bool, without: tuple[str, ...]
) -> None:
    """Play a log.

    Raises:
        OffpisteError: an option, the log, the rig or the connection is invalid.
    """
    if not seconds > 0:
        raise LiveError(f"{seconds:g} seconds", where="--seconds", how="give more than 0")
    require("live", "zenoh")
    known = load_rig(rig) if rig else None
    drive = RecordedDrive(log, known, None if known is None else known.topics)
    with closing(ZenohTransport(robot)) as transport:
        player = LogPlayer(drive, transport, without)
        if player.left_out:
            logger.info(f"left out: {', '.join(player.left_out)}")
        freeze_loaded_objects()
        played = player.play_in_lockstep(seconds) if lockstep else player.play(rate, seconds)
    late = f", {1e3 * played.late:.0f} ms late at worst" if not lockstep else ""
    logger.info(f"played {played.messages} messages in {played.steps} steps{late}")
