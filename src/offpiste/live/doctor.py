"""Checks before a drive: computer, rig, model, connection, and the robot's messages."""

import math
import platform
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Final, Literal

import numpy as np

from offpiste.core.channels import OPTIONAL_CONTROLS
from offpiste.core.errors import LiveError, OffpisteError, did_you_mean, require
from offpiste.core.machine import free_memory, usable_cores
from offpiste.live.command_messages import CommandMessages
from offpiste.live.reception import check_types, is_pressed
from offpiste.live.robot_messages import SensorMessages, VehicleMessages
from offpiste.live.session import Source, refuse_unmeasured
from offpiste.logs.ros.bag_files import heard_at
from offpiste.rig.rig import Rig, load_rig
from offpiste.runtime.planner import load_planner
from offpiste.training.run import differing_vehicle
from offpiste.transport.received import Received
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport

_CORES: Final = 4
_FREE_MEMORY: Final = 3.0
"""Approximate memory of a drive with a model that reads images [GB]."""
_SHARED_MEMORY: Final = 0.5
"""Shared memory of its rings [GB]."""
_WAITING: Final = 16
"""Maximum number of messages of a topic that wait to be decoded; older ones are counted only."""
_OLD: Final = 0.3
"""Age at arrival from which readings and scans are late [s]."""
_AHEAD: Final = -0.05
"""Age at arrival below which a stamp is in the future [s]."""
_MAPPING: Final = 0.1
"""Time from a scan's arrival to its use in the map [s]."""
Level = Literal["ok", "warning", "error"]
Finding = tuple[Level, str]
"""Level and description of the result of a check."""


def examined(
    rig_name: str, run: str, pca: Path | None, robot: ZenohSettings, seconds: float, clock: Source
) -> Iterator[Finding]:
    """Yield findings, also of listening for some seconds; checks whose prerequisites failed are left out.

    Args:
        clock: as for `offpiste live`; ages are only meaningful with "system".
    """
    require("live", "zenoh")
    yield from _computer()
    try:
        rig, cameras = load_rig(rig_name), True
        yield "ok", f"rig '{rig.name}'"
        unreadable = [*_errors(VehicleMessages, rig)]
        yield from unreadable
        if not rig.lidars:
            yield "error", "the rig has no LiDAR, which mapping requires"
        if not rig.outputs:
            yield "warning", "the rig has no [outputs]: only shadow mode is possible"
        elif rig.live.enable is None:
            yield "warning", "the rig has no [live.enable]: commands are sent without a dead man's switch"
        if run:
            found, cameras = _model(rig, run, pca)
            yield from found
        transport = ZenohTransport(robot, rig.live.definitions)
    except OffpisteError as error:
        yield "error", str(error)
        return
    with closing(transport):
        yield "ok", f"connected, {transport.routers()} router{'s' * (transport.routers() != 1)}"
        wrong = [*_errors(check_types, rig, transport.types), *_errors(CommandMessages, rig, transport.types)]
        yield from wrong
        for output in [] if wrong else rig.outputs.values():
            yield "ok", f"{output.topic}: {output.type} can be sent"
        if not unreadable:
            yield from _Listener(rig, transport, cameras=cameras).findings(seconds, clock)


def _computer() -> Iterator[Finding]:
    versions = ", ".join(f"{name} {version(name)}" for name in ("offpiste", "eclipse-zenoh", "rosbags", "torch"))
    yield "ok", f"{versions}, Python {platform.python_version()}"
    cores = usable_cores()
    few = f"{cores} cores: plans and maps will be late; use {_CORES} or more"
    yield ("warning", few) if cores < _CORES else ("ok", f"{cores} cores")
    free = free_memory() / 1e9
    yield "ok" if free > _FREE_MEMORY else "warning", f"{free:.1f} GB of memory are free"
    shared = Path("/dev/shm")
    room = shutil.disk_usage(shared).free / 1e9 if shared.is_dir() else 0.0
    much = room > _SHARED_MEMORY
    hint = "" if much else "; in a container, give it more: --shm-size 1g"
    yield "ok" if much else "error", f"{room:.1f} GB of shared memory are free{hint}"


def _errors(check: Callable[..., object], *arguments: object) -> Iterator[Finding]:
    """Yield the error that a check raises, if any."""
    try:
        check(*arguments)
    except OffpisteError as error:
        yield "error", str(error)


def _model(rig: Rig, run: str, pca: Path | None) -> tuple[list[Finding], bool]:
    """Return findings, and whether the model reads images."""
    try:
        planner = load_planner(run, pca)
    except OffpisteError as error:
        return [("error", str(error))], True
    found = [("ok", f"run {run}: {planner.name}"), *_errors(refuse_unmeasured, planner, rig)]
    if (apart := differing_vehicle(planner.dynamics.vehicle, rig.vehicle)) is not None:
        found.append(("warning", f"the model was trained on another vehicle: {apart}"))
    return found, planner.extractor is not None


@dataclass
class _Heard:
    """Messages of a topic: count, types, ages by their stamps [s], and those that are not decoded yet."""

    count: int = 0
    types: set[str] = field(default_factory=set)
    ages: list[float] = field(default_factory=list)
    waiting: deque[Received] = field(default_factory=lambda: deque(maxlen=_WAITING))

    @property
    def age(self) -> float:
        """Median age [s]; NaN if no header has a stamp."""
        return float(np.median(self.ages)) if self.ages else math.nan


class _Listener:
    """Listener to all topics of a rig."""

    def __init__(self, rig: Rig, transport: ZenohTransport, *, cameras: bool) -> None:
        self._rig, self._transport, self._wrong_switch = rig, transport, ""
        self._vehicle, self._sensors = VehicleMessages(rig), SensorMessages(rig, cameras=cameras)
        switch = [] if rig.live.enable is None else [rig.live.enable.topic]
        self._needed = dict.fromkeys((*self._vehicle.topics, *self._sensors.topics, *switch))
        self._commands = {output.topic for output in rig.outputs.values()}
        optional = {control.name for control in OPTIONAL_CONTROLS}
        required = {source.topic for name, source in rig.channels.items() if name not in optional}
        self._optional = self._commands | {source.topic for source in rig.channels.values()} - required
        self._optional |= {lidar.topic for lidar in rig.lidars.values() if lidar.optional}
        self._optional |= {name for one in rig.cameras.values() if one.optional for name in (one.topic, one.info)}
        self._all = {topic: _Heard() for topic in (*self._needed, *self._commands)}
        for topic in self._all:
            wanted = rig.live.types.get(topic, "")
            wanted = wanted if wanted in transport.types else ""  # an unknown type is an error of `check_types`
            transport.subscribe(topic, self._deliver, msgtype=wanted, history=topic in rig.frames.topics)

    def findings(self, seconds: float, clock: Source) -> Iterator[Finding]:
        """Listen, and yield findings."""
        if not 0 < seconds <= 600:
            raise LiveError(f"listening for {seconds:g} s", where="--seconds", how="give more than 0, and at most 600")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for heard in self._all.values():
                while heard.waiting:
                    self._take(heard.waiting.popleft(), heard)
            time.sleep(0.02)
        stamped, published = clock == "system" and self._rig.clock.stamps != "receive", self._transport.topics()
        for topic in self._needed:
            yield self._of(topic, seconds, stamped, published)
        yield from self._short_timeouts(seconds, stamped)
        for topic in self._commands - set(self._vehicle.topics):
            if self._all[topic].types:
                what = "another publisher commands; with --drive the vehicle would be stopped"
                yield "warning", f"{topic}: {what}"
        self._sensors.settle()
        unusable, refused = self._vehicle.dropped + self._sensors.dropped, self._transport.refused
        wrong = [self._wrong_switch] if self._wrong_switch else []
        wrong += [f"{what} ({number} times)" for what, number in sorted(unusable.items())]
        wrong += [f"refused {number} times: {what}" for what, number in sorted(refused.items())]
        if self._sensors.waiting_for:
            wrong.append(f"sensors cannot be set up: {self._sensors.waiting_for}")
        yield from (("error", what) for what in wrong)

    def _deliver(self, received: Received) -> None:
        """Queue a message; called in the transport's thread."""
        heard = self._all[received.topic]
        heard.count += 1
        heard.waiting.append(received)

    def _take(self, received: Received, heard: _Heard) -> None:
        message = self._transport.decode(received)
        if message is None:
            return
        heard.types.add(received.type)
        stamp = heard_at(received.received, message, self._rig.clock.stamps)
        if not math.isnan(stamp):
            heard.ages.append(received.received - stamp)
        enable = self._rig.live.enable
        if enable is not None and received.topic == enable.topic and is_pressed(enable.field, message) is None:
            what = f"{enable.topic}: {received.type} has no number '{enable.field}'"
            self._wrong_switch = f"{what}: correct live.enable.field"
        self._vehicle.take(received.topic, message, received.received)
        if received.topic in self._sensors.topics:
            self._sensors.take(received.topic, message, received.received)

    def _short_timeouts(self, seconds: float, stamped: bool) -> Iterator[Finding]:
        """Yield timeouts that the loss of a single message would exceed."""
        lidars = [lidar.topic for lidar in self._rig.lidars.values()]
        fastest = max(lidars, key=lambda topic: self._all[topic].count, default="")
        limits = ((self._vehicle.position_topic, ("state",), 0.0), (fastest, ("scan", "scan_limit"), _MAPPING))
        for topic, names, spare in limits:
            heard = self._all.get(topic, _Heard())
            age = heard.age if stamped else 0.0
            if not heard.types or not _AHEAD < age < 1.0:
                continue
            oldest = math.ceil(100 * (age + 2 * seconds / heard.count + spare)) / 100
            timeouts = self._rig.live.timeouts
            if short := [f"live.timeouts.{name}" for name in names if getattr(timeouts, name) < oldest]:
                what = f"{heard.count / seconds:.1f} Hz, so after a lost message the newest is {oldest:g} s old"
                yield "warning", f"{topic}: {what}: increase {' and '.join(short)}"

    def _of(self, topic: str, seconds: float, stamped: bool, published: dict[str, str]) -> Finding:
        """Return the level and the description of what was heard on a topic; `published` are types by topic."""
        heard = self._all[topic]
        if not heard.types:
            there = f"; it is published, as {published[topic]}" if topic in published else ""
            # A topic that is heard belongs to another channel.
            free = [name for name in published if name not in self._all or not self._all[name].types]
            if not there and (near := did_you_mean(topic, free)):
                there = f"; {near}"
            return "warning" if topic in self._optional else "error", f"{topic}: nothing heard{there}"
        what = f"{topic}: {', '.join(sorted(heard.types))}"
        if topic in self._rig.frames.topics:
            return "ok", what
        what, age = f"{what}, {heard.count / seconds:.1f} a second", heard.age
        if math.isnan(age):
            return "error", f"{what}: its header has no stamp"
        if not stamped:
            return "ok", what
        what += f", {1e3 * age:.0f} ms old"
        oldest = max(_OLD, self._rig.live.timeouts.state) if topic == self._vehicle.position_topic else _OLD
        if _AHEAD < age < oldest:
            return "ok", what
        how = "synchronise the clocks (chrony), or give --clock stamps; for a simulator or played log --clock clock"
        return "error", f"{what}: {how}"
