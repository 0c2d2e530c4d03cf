"""Simulates drives: vehicle and controller in lockstep, from settings to a recorded log."""

import logging
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.core.errors import OffpisteError
from offpiste.core.progress import track
from offpiste.logs.ros.writer import McapWriter
from offpiste.simulation.driver.driver import Driver, DriverSettings
from offpiste.simulation.driver.manoeuvres import ManoeuvringDriver
from offpiste.simulation.recorder import Recorder
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.sensors.imperfections import Imperfections
from offpiste.simulation.sensors.suite import Sensing, SensorSuite, observed, remounted, sensor_suite
from offpiste.simulation.vehicle.parameters import VehicleParameters, load_vehicle
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings

FINAL_EVENTS = ("rollover", "left the world")
"""Events that end a drive."""

STUCK = "stuck"
"""Event of a controller that gives up."""


@runtime_checkable
class Controller(Protocol):
    """A driver, a planner, or recorded commands."""

    @property
    def stuck(self) -> bool:
        """Whether it has given up."""
        ...

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " U"]:
        """Throttle [0..1], brake [0..1], steer [-1..1, + left] for the next `conventions.DT`.

        A fourth number is the gear (1, 0, -1), which is shifted at a standstill; without it the gear stays.
        """
        ...


@dataclass(frozen=True)
class Start:
    """Start of a drive: x, y [m], yaw [rad], speed forwards [m/s]."""

    x: float
    y: float
    yaw: float
    speed: float


@dataclass
class Replay:
    """Commands of another drive, open loop."""

    commands: Float[np.ndarray, "N U"]
    stuck: bool = False
    _row: int = 0

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " U"]:
        """The next recorded command; the last one is held."""
        command = self.commands[self._row]
        self._row = min(self._row + 1, len(self.commands) - 1)
        return command


def drive(
    world: World, parameters: VehicleParameters, start: Start, controller: Controller, *, steps: int
) -> Iterator[VehicleSample]:
    """Samples of a drive; it ends early after a rollover, at the world's border, or if the controller gives up."""
    vehicle = VehicleSimulation(world, parameters, x=start.x, y=start.y, yaw=start.yaw, speed=start.speed)
    for _ in range(steps):
        sample = vehicle.sample()
        command = controller.command(sample)
        stuck = (STUCK,) if controller.stuck else ()
        yield replace(sample, command=command, events=sample.events + stuck)
        if stuck or set(sample.events) & set(FINAL_EVENTS):
            return
        vehicle.step(*command)


def start_and_driver(
    world: World, parameters: VehicleParameters, *, seed: int, settings: DriverSettings | None = None
) -> tuple[Start, Driver | ManoeuvringDriver]:
    """A driver on a trail of a world; one that also does manoeuvres if the settings say so."""
    settings = settings or DriverSettings()
    driver = Driver(world, parameters, np.random.default_rng([seed, 0xD21]), settings)
    start = Start(*driver.start())
    if not settings.manoeuvres:
        return start, driver
    rng = np.random.default_rng([seed, 0xD22])
    manoeuvring = ManoeuvringDriver(driver, parameters, rng, rate=settings.manoeuvres, fastest=settings.top_speed)
    return start, manoeuvring


def on_other_ground(world: World, other: World) -> World:
    """A world's hills, trails and plants on the ground of another world of the same size: for twins.

    Raises:
        ValueError: the worlds' grids differ.
    """
    if world.elevation.shape != other.elevation.shape or world.resolution != other.resolution:
        raise ValueError("twins need worlds of one size and resolution")
    return replace(world, kinds=other.kinds, wetness=other.wetness, properties=other.properties)


logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class DriveSettings:
    """Settings of a simulated drive; the same settings give the same bytes.

    Attributes:
        world: the world to drive in.
        seconds: duration [s]; a drive that rolls over or gets stuck ends early.
        seed: seed of driver, noise and light; the world has its own.
        sensors: "full", "light" or "none".
        mounting_turn: angle by which each sensor is rotated from its usual mounting, about a random axis of the seed
            [deg]; the log records the mounting as it is.
        vehicle: a TOML file (`vehicle.parameters.VehicleParameters`); "" for the side-by-side that is shipped.
    """

    world: WorldSettings = field(default_factory=WorldSettings)
    seconds: float = 60.0
    seed: int = 0
    sensors: str = "light"
    mounting_turn: float = 0.0
    driver: DriverSettings = field(default_factory=DriverSettings)
    imperfections: Imperfections = field(default_factory=Imperfections)
    vehicle: str = ""


@dataclass(frozen=True)
class DriveSummary:
    """Summary of a simulated drive.

    Attributes:
        log: the recorded file.
        seconds: recorded time [s].
        metres: driven distance [m].
        events: events with their times [s].
        path: x, y of the pose point [m], every `conventions.DT`.
        speed: horizontal speed in the same rows [m/s].
    """

    log: Path
    seconds: float
    metres: float
    events: tuple[tuple[float, str], ...]
    path: np.ndarray
    speed: np.ndarray

    def __str__(self) -> str:
        events = "".join(f"; {event} at {time:.1f} s" for time, event in self.events)
        median = float(np.median(self.speed)) if len(self.speed) else 0.0
        return f"{self.log}: {self.seconds:.0f} s, {self.metres:.0f} m, median {median:.1f} m/s{events}"


def simulate(settings: DriveSettings, out: Path, *, twins: int = 0) -> list[DriveSummary]:
    """Record a drive, and `twins` of it: the same start and the same commands, open loop, on other ground.

    Args:
        out: an .mcap file; the k-th twin's is called NAME-twin-k.mcap.

    Raises:
        OffpisteError: a setting is out of range, or a file exists already.
    """
    if twins < 0:
        raise OffpisteError(f"--twins is {twins}", how="give a number of 0 or more")
    files = [out, *(out.with_name(f"{out.stem}-twin-{k}{out.suffix}") for k in range(1, twins + 1))]
    steps = _check(settings, files)
    parameters = load_vehicle(settings.vehicle or None)
    world = make_world(settings.world)
    start, driver = start_and_driver(world, parameters, seed=settings.seed, settings=settings.driver)
    commands: list[np.ndarray] = []
    drives = [record(settings, world, parameters, start, driver, files[0], steps=steps, commands=commands)]
    logger.info(str(drives[0]))
    for k, file in enumerate(files[1:], start=1):
        other = make_world(replace(settings.world, seed=settings.world.seed + 1_000_003 * k))
        ground, replay = on_other_ground(world, other), Replay(np.stack(commands))
        drives.append(record(settings, ground, parameters, start, replay, file, steps=len(commands)))
        logger.info(str(drives[-1]))
    return drives


def _check(settings: DriveSettings, files: Sequence[Path]) -> int:
    """Number of steps of `DT`; refuses wrong settings before minutes are spent."""
    if not DT / 2 < settings.seconds < np.inf:
        raise OffpisteError(f"a drive of {settings.seconds:g} s", how="give --seconds above zero")
    amounts = {**vars(settings.imperfections), "mounting_turn": settings.mounting_turn}
    for name, amount in amounts.items():
        if not np.isfinite(amount) or (amount < 0 and name != "stamp_offset_ms"):
            raise OffpisteError(f"{name} is {amount:g}", how="give a number of 0 or more")
    if settings.seed < 0:
        raise OffpisteError(f"the drive's seed is {settings.seed}", how="choose 0 or more")
    sensor_suite(settings.sensors)
    for file in files:
        if file.exists():
            raise OffpisteError("exists already", where=file, how="remove it, or give another name")
    return round(settings.seconds / DT)


def record(
    settings: DriveSettings,
    world: World,
    parameters: VehicleParameters,
    start: Start,
    controller: Controller,
    out: Path,
    *,
    steps: int,
    commands: list[np.ndarray] | None = None,
    seen: World | None = None,
    suite: SensorSuite | None = None,
) -> DriveSummary:
    """Drive and write every message; an interruption leaves a readable file.

    Args:
        commands: the controller's commands are appended to it.
        seen: the world that the sensors and the true map show, where it differs from the one driven in.
        suite: instead of the sensors that the settings name.
    """
    noise, light, mountings = (np.random.default_rng([settings.seed, stream]) for stream in (1, 2, 3))
    suite = suite or sensor_suite(settings.sensors)
    suite, seen = remounted(suite, settings.mounting_turn, mountings), seen or world
    sensing = Sensing(seen, suite, light) if suite.cameras or suite.lidars else None
    events: list[tuple[float, str]] = []
    path, speed = array("d"), array("d")  # compact: drives can be long
    with McapWriter(out) as writer:
        recorder = Recorder(
            writer, wheel_radius=parameters.rolling_radius, rng=noise, imperfections=settings.imperfections
        )
        recorder.start(seen, suite.mountings())
        samples = drive(world, parameters, start, controller, steps=steps)
        for sample, seen_there in observed(_with_progress(samples, steps, out.name), sensing, recorder.sensor_stamp_ns):
            recorder.vehicle(sample)
            for topic, message in seen_there:
                recorder.sensor(topic, message)
            events += [(sample.time, event) for event in sample.events]
            path.extend(sample.position[:2].tolist())
            speed.append(float(np.hypot(*sample.velocity[:2])))
            if commands is not None:
                commands.append(sample.command)
    xy = np.array(path).reshape(-1, 2)
    metres = float(np.hypot(*np.diff(xy, axis=0).T).sum())
    return DriveSummary(out, len(speed) * DT, metres, tuple(events), xy, np.array(speed))


def _with_progress(samples: Iterator[VehicleSample], steps: int, name: str) -> Iterator[VehicleSample]:
    """The same samples, with a progress bar over the drive."""
    for _, sample in zip(track(range(steps), f"simulate {name}"), samples, strict=False):
        yield sample
