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
from typing import Final, Literal, NamedTuple

import numpy as np

from offpiste.core.channels import OPTIONAL_CONTROLS
from offpiste.core.errors import LiveError, OffpisteError, did_you_mean, require
from offpiste.core.machine import free_memory, usable_cores
from offpiste.live.command_messages import CommandMessages
from offpiste.live.lockstep import refuse_unmeasured
from offpiste.live.reception import check_types, is_pressed
from offpiste.live.robot_messages import SensorMessages, VehicleMessages
from offpiste.live.session import Source
from offpiste.logs.ros.bag_files import field_getter, heard_at
from offpiste.rig.rig import Rig, load_rig
from offpiste.runtime.planner import load_planner
from offpiste.training.run import differing_vehicle
from offpiste.transport.interface import Received
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
_MAPPING: Final = 0.1
"""Time from a scan's arrival to its use in the map [s]."""


class Finding(NamedTuple):
    """Result of one check."""

    level: Literal["ok", "warning", "error"]
    what: str


@dataclass
class _Heard:
    """Messages of a topic: count, types, and ages by their stamps [s]."""

    count: int = 0
    types: set[str] = field(default_factory=set)
    ages: list[float] = field(default_factory=list)
    waiting: deque[Received] = field(default_factory=lambda: deque(maxlen=_WAITING))

    @property
    def age(self) -> float:
        """Median age [s]; NaN if no header has a stamp."""
        return float(np.median(self.ages)) if self.ages else math.nan


def examined(
    rig_name: str, run: str, pca: Path | None, robot: ZenohSettings, seconds: float, clock: Source
) -> Iterator[Finding]:
    """Yield findings; checks whose prerequisites failed are left out.

    Args:
        run: "" for none.
        seconds: time to listen to the robot [s].
        clock: as for `offpiste live`; ages are only meaningful with "system".
    """
    require("live", "zenoh")
    yield from _computer()
    try:
        rig = load_rig(rig_name)
    except OffpisteError as error:
        yield Finding("error", str(error))
        return
    yield Finding("ok", f"rig '{rig.name}'")
    yield from _for_driving(rig)
    cameras = True
    if run:
        found, cameras = _model(rig, run, pca)
        yield from found
    try:
        transport = ZenohTransport(robot, [Path(name) for name in rig.live.definitions])
    except OffpisteError as error:
        yield Finding("error", str(error))
        return
    with closing(transport):
        yield Finding("ok", f"connected, {transport.routers()} router{'s' * (transport.routers() != 1)}")
        yield from _outputs(rig, transport)
        try:
            listener = _Listener(rig, transport, cameras=cameras)
        except OffpisteError:  # channels that cannot be read live: a finding of `_for_driving`
            return
        yield from listener.findings(seconds, clock)


def _computer() -> Iterator[Finding]:
    versions = ", ".join(f"{name} {version(name)}" for name in ("offpiste", "eclipse-zenoh", "rosbags", "torch"))
    yield Finding("ok", f"{versions}, Python {platform.python_version()}")
    cores = usable_cores()
    few = f"{cores} cores: plans and maps will be late; use {_CORES} or more"
    yield Finding("warning", few) if cores < _CORES else Finding("ok", f"{cores} cores")
    free = free_memory() / 1e9
    yield Finding("ok" if free > _FREE_MEMORY else "warning", f"{free:.1f} GB of memory are free")
    shared = Path("/dev/shm")
    room = shutil.disk_usage(shared).free / 1e9 if shared.is_dir() else 0.0
    much = room > _SHARED_MEMORY
    hint = "" if much else "; in a container, give it more: --shm-size 1g"
    yield Finding("ok" if much else "error", f"{room:.1f} GB of shared memory are free{hint}")


def _errors(check: Callable[..., object], *arguments: object) -> Iterator[Finding]:
    """Yield the error that a check raises, if any."""
    try:
        check(*arguments)
    except OffpisteError as error:
        yield Finding("error", str(error))


def _for_driving(rig: Rig) -> Iterator[Finding]:
    yield from _errors(VehicleMessages, rig)
    if not rig.lidars:
        yield Finding("error", "the rig has no LiDAR, which mapping requires")
    if not rig.outputs:
        yield Finding("warning", "the rig has no [outputs]: only shadow mode is possible")
    elif rig.live.enable is None:
        yield Finding("warning", "the rig has no [live.enable]: commands are sent without a dead man's switch")


def _model(rig: Rig, run: str, pca: Path | None) -> tuple[list[Finding], bool]:
    """Return findings, and whether the model reads images."""
    try:
        planner = load_planner(run, pca)
    except OffpisteError as error:
        return [Finding("error", str(error))], True
    found = [Finding("ok", f"run {run}: {planner.name}"), *_errors(refuse_unmeasured, planner, rig)]
    if (apart := differing_vehicle(planner.dynamics.vehicle, rig.vehicle)) is not None:
        found.append(Finding("warning", f"the model was trained on another vehicle: {apart}"))
    return found, planner.extractor is not None


def _outputs(rig: Rig, transport: ZenohTransport) -> Iterator[Finding]:
    yield from _errors(check_types, rig, transport.types)
    try:
        messages = CommandMessages(rig, transport.types)
    except OffpisteError as error:
        yield Finding("error", str(error))
        return
    for topic, msgtype in messages.topics.items():
        yield Finding("ok", f"{topic}: {msgtype} can be sent")


class _Listener:
    """Listener to all topics of a rig."""

    def __init__(self, rig: Rig, transport: ZenohTransport, *, cameras: bool) -> None:
        self._rig, self._transport = rig, transport
        self._vehicle, self._sensors = VehicleMessages(rig), SensorMessages(rig, cameras=cameras)
        enable = [] if rig.live.enable is None else [rig.live.enable.topic]
        self._switch_without = ""
        self._static = set(rig.frames.topics)
        self._optional = {lidar.topic for lidar in rig.lidars.values() if lidar.optional}
        self._optional |= {name for one in rig.cameras.values() if one.optional for name in (one.topic, one.info)}
        optional = {control.name for control in OPTIONAL_CONTROLS}
        needed = {source.topic for name, source in rig.channels.items() if name not in optional}
        self._optional |= {source.topic for source in rig.channels.values()} - needed
        self._commands = {output.topic for output in rig.outputs.values()}
        self._needed = dict.fromkeys([*self._vehicle.topics, *self._sensors.topics, *enable])
        self._all = {topic: _Heard() for topic in (*self._needed, *self._commands)}
        for topic in self._all:
            wanted = rig.live.types.get(topic, "")
            wanted = wanted if wanted in transport.types else ""  # an unknown type is a finding of `_outputs`
            transport.subscribe(topic, self._deliver, msgtype=wanted, history=topic in self._static)

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
        others = self._transport.topics()
        for topic in self._needed:
            yield self._of(topic, seconds, clock, others)
        yield from self._short_timeouts(seconds, clock)
        for topic in self._commands & self._heard - set(self._vehicle.topics):
            yield Finding("warning", f"{topic}: another publisher commands; with --drive the vehicle would be stopped")
        if self._switch_without:
            yield Finding("error", self._switch_without)
        for what, count in sorted((self._vehicle.dropped + self._sensors.dropped).items()):
            yield Finding("error", f"{what} ({count} times)")
        for what, count in sorted(self._transport.refused.items()):
            yield Finding("error", f"refused {count} times: {what}")
        self._sensors.settle()
        if self._sensors.waiting_for:
            yield Finding("error", f"sensors cannot be set up: {self._sensors.waiting_for}")

    @property
    def _heard(self) -> set[str]:
        """Topics with at least one decoded message."""
        return {topic for topic, heard in self._all.items() if heard.types}

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
        is_switch = enable is not None and received.topic == enable.topic
        if enable is not None and is_switch and is_pressed(field_getter(enable.field), message) is None:
            what = f"{enable.topic}: {received.type} has no number '{enable.field}'"
            self._switch_without = f"{what}: correct live.enable.field"
        self._vehicle.take(received.topic, message, received.received)
        if received.topic in self._sensors.topics:
            self._sensors.take(received.topic, message, received.received)

    def _short_timeouts(self, seconds: float, clock: Source) -> Iterator[Finding]:
        """Yield timeouts that the loss of a single message would exceed."""
        timeouts, stamped = self._rig.live.timeouts, clock == "system" and self._rig.clock.stamps != "receive"
        lidars = [lidar.topic for lidar in self._rig.lidars.values()]
        fastest = max(lidars, key=lambda topic: self._all[topic].count, default="")
        for topic, names, spare in (
            (self._vehicle.position_topic, ("state",), 0.0),
            (fastest, ("scan", "scan_limit"), _MAPPING),
        ):
            if topic not in self._heard:
                continue
            heard = self._all[topic]
            age = heard.age if stamped else 0.0
            if math.isnan(age):
                continue
            oldest = math.ceil(100 * (age + 2 * seconds / heard.count + spare)) / 100
            short = [f"live.timeouts.{name}" for name in names if getattr(timeouts, name) < oldest]
            if short and -0.05 < age < 1.0:
                rate = f"{topic}: {heard.count / seconds:.1f} a second"
                what = f"{rate}; after a lost message, the newest is {oldest:g} s old"
                yield Finding("warning", f"{what}: increase {' and '.join(short)}")

    def _of(self, topic: str, seconds: float, clock: Source, others: dict[str, str]) -> Finding:
        if topic not in self._heard:
            free = [other for other in others if other not in self._heard]  # a heard topic belongs to another channel
            near = "" if topic in others else did_you_mean(topic, free)
            there = f"; {near}" if near else "" if topic not in others else f"; it is published, as {others[topic]}"
            optional = topic in self._optional or topic in self._commands
            return Finding("warning" if optional else "error", f"{topic}: nothing heard{there}")
        heard = self._all[topic]
        kind = ", ".join(sorted(heard.types))
        if topic in self._static:
            return Finding("ok", f"{topic}: {kind}")
        age, rate = heard.age, heard.count / seconds
        what = f"{topic}: {kind}, {rate:.1f} a second"
        if math.isnan(age):
            return Finding("error", f"{what}: its header has no stamp")
        if clock != "system" or self._rig.clock.stamps == "receive":
            return Finding("ok", what)
        what += f", {1e3 * age:.0f} ms old"
        oldest = max(_OLD, self._rig.live.timeouts.state) if topic == self._vehicle.position_topic else _OLD
        if not -0.05 < age < oldest:
            how = "synchronise the clocks (chrony), or give --clock stamps; for a simulator or played log --clock clock"
            return Finding("error", f"{what}: {how}")
        return Finding("ok", what)
