"""Simulate drives: vehicle and controller in lockstep, from settings to a recorded log."""

import io
import logging
from array import array
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.core.errors import OffpisteError
from offpiste.core.machine import within_memory
from offpiste.core.parallel import Report, run_all
from offpiste.core.progress import track
from offpiste.logs.ros.writer import McapWriter
from offpiste.simulation.driver.driver import Driver, DriverSettings
from offpiste.simulation.driver.manoeuvres import ManoeuvringDriver
from offpiste.simulation.recorder import Imperfections, Recorder
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.sensors.suite import Sensing, SensorSuite, observed, remounted, sensor_suite
from offpiste.simulation.vehicle.parameters import VehicleParameters, load_vehicle
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings

logger = logging.getLogger(__name__)

FINAL_EVENTS = ("rollover", "left the world")
"""Events that end a drive; so does `STUCK`, a controller that gives up."""
STUCK = "stuck"
MEMORY: Final = {"none": 0.7e9, "light": 1.3e9, "full": 1.3e9}
"""Memory of a process that records a drive, by sensors [bytes]: the largest measured plus a third."""


@runtime_checkable
class Controller(Protocol):
    """Driver of a vehicle, e.g. a simulated person or a planner."""

    @property
    def stuck(self) -> bool:
        """Whether the controller has given up."""
        ...

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " U"]:
        """Return the throttle [0..1], brake [0..1], steer [-1..1, positive left] for the next `conventions.DT`.

        An optional fourth number is the gear (1, 0, -1), shifted at a standstill.
        """
        ...


@dataclass(frozen=True)
class Start:
    """Start of a drive."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad]
    speed: float  # forward [m/s]


def drive(
    world: World, parameters: VehicleParameters, start: Start, controller: Controller, *, steps: int
) -> Iterator[VehicleSample]:
    """Yield the samples of a drive, which ends early at a rollover, at the border, or if the controller gives up."""
    vehicle = VehicleSimulation(world, parameters, **vars(start))
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
    """Return a start and a driver on a trail of a world, with manoeuvres if the settings ask for them."""
    settings = settings or DriverSettings()
    driver = Driver(world, parameters, np.random.default_rng([seed, 0xD21]), settings)
    start = Start(*driver.start())
    if not settings.manoeuvres:
        return start, driver
    rng = np.random.default_rng([seed, 0xD22])
    manoeuvring = ManoeuvringDriver(driver, parameters, rng, rate=settings.manoeuvres, fastest=settings.top_speed)
    return start, manoeuvring


@dataclass(frozen=True)
class DriveSettings:
    """Settings of a simulated drive; the same settings give the same bytes."""

    world: WorldSettings = field(default_factory=WorldSettings)
    seconds: float = 60.0  # longest duration [s]
    seed: int = 0  # seed of driver, noise and light; the world has its own
    sensors: str = "light"  # "full", "light" or "none"
    mounting_turn: float = 0.0  # rotation of each sensor's mounting, true and recorded, about a random axis [deg]
    driver: DriverSettings = field(default_factory=DriverSettings)
    imperfections: Imperfections = field(default_factory=Imperfections)
    vehicle: str = ""  # TOML file of a vehicle (`vehicle.parameters`), or "" for the shipped side-by-side


@dataclass(frozen=True)
class DriveSummary:
    """Summary of a simulated drive."""

    log: Path  # recorded file
    seconds: float  # recorded time [s]
    metres: float  # driven distance [m]
    events: tuple[tuple[float, str], ...]  # times [s] and events
    path: np.ndarray  # x, y of the pose point every `conventions.DT` [m]
    speed: np.ndarray  # horizontal speed in the same rows [m/s]

    def __str__(self) -> str:
        events = "".join(f"; {event} at {time:.1f} s" for time, event in self.events)
        median = float(np.median(self.speed)) if len(self.speed) else 0.0
        return f"{self.log}: {self.seconds:.0f} s, {self.metres:.0f} m, median {median:.1f} m/s{events}"


def simulate(settings: DriveSettings, out: Path) -> DriveSummary:
    """Record a drive in an .mcap file.

    Raises:
        OffpisteError: a setting is out of range, the file exists already, or the vehicle diverges.
    """
    check_settings(settings)
    if out.exists():
        raise OffpisteError("exists already", where=out, how="remove it, or give another name")
    parameters = load_vehicle(settings.vehicle or None)
    world = make_world(settings.world)
    start, driver = start_and_driver(world, parameters, seed=settings.seed, settings=settings.driver)
    summary = record(settings, world, parameters, start, driver, out, steps=round(settings.seconds / DT))
    logger.info(str(summary))
    return summary


def check_settings(settings: DriveSettings) -> None:
    """Raise `OffpisteError` for the first setting out of range."""
    if not DT / 2 < settings.seconds < np.inf:
        raise OffpisteError(f"invalid duration {settings.seconds:g} s", how="give --seconds above zero")
    amounts = {**vars(settings.imperfections), "mounting_turn": settings.mounting_turn}
    for name, amount in amounts.items():
        if not np.isfinite(amount) or (amount < 0 and name != "stamp_offset_ms"):
            raise OffpisteError(f"invalid {name} = {amount:g}", how="give a number of 0 or more")
    if settings.seed < 0:
        raise OffpisteError(f"invalid drive seed {settings.seed}", how="choose 0 or more")
    sensor_suite(settings.sensors)


def record(
    settings: DriveSettings,
    world: World,
    parameters: VehicleParameters,
    start: Start,
    controller: Controller,
    out: Path,
    *,
    steps: int,
    suite: SensorSuite | None = None,
) -> DriveSummary:
    """Drive and write every message; an interruption leaves a readable file.

    Args:
        suite: sensors to use instead of those in the settings.
    """
    noise, light, mountings = (np.random.default_rng([settings.seed, stream]) for stream in (1, 2, 3))
    suite = remounted(suite or sensor_suite(settings.sensors), settings.mounting_turn, mountings)
    sensing = Sensing(world, suite, light) if suite.cameras or suite.lidars else None
    events: list[tuple[float, str]] = []
    motion = array("d")  # x, y, speed; compact, as drives can be long
    with McapWriter(out) as writer:
        recorder = Recorder(writer, parameters.rolling_radius, noise, settings.imperfections)
        recorder.start(world, suite.mountings)
        samples = drive(world, parameters, start, controller, steps=steps)
        shown = (sample for _, sample in zip(track(range(steps), f"simulate {out.name}"), samples, strict=False))
        for sample, messages in observed(shown, sensing, recorder.sensor_stamp_ns):
            recorder.vehicle(sample)
            for topic, message in messages:
                recorder.sensor(topic, message)
            events += [(sample.time, event) for event in sample.events]
            motion.extend((*sample.position[:2].tolist(), float(np.hypot(*sample.velocity[:2]))))
    rows = np.array(motion).reshape(-1, 3)
    metres = float(np.hypot(*np.diff(rows[:, :2], axis=0).T).sum())
    return DriveSummary(out, len(rows) * DT, metres, tuple(events), rows[:, :2], rows[:, 2])


class Recording(NamedTuple):
    """A drive to simulate, and the path of its log."""

    settings: DriveSettings
    log: Path


def simulate_all(recordings: Sequence[Recording], processes: int, cluster: str = "") -> None:
    """Record missing drives, `processes` at a time or on a Ray cluster.

    Raises:
        OffpisteError: the first failure; the other drives are recorded.
    """
    missing = [recording for recording in recordings if not recording.log.exists()]
    if kept := len(recordings) - len(missing):
        logger.warning(f"{kept} of {len(recordings)} drives exist already and are kept")
    if not cluster and missing:
        memory = max(MEMORY.get(one.settings.sensors, 0.0) for one in missing)
        processes = within_memory(min(processes, len(missing)), memory)
    run_all(_record, missing, processes, "simulate", cluster=cluster).checked()


def simulate_once(settings: DriveSettings, log: Path) -> str:
    """Record a drive unless it exists, and return its summary; an interrupted drive is recorded anew."""
    if log.exists():
        return f"{log}: exists"
    partial = log.with_name(f"{log.stem}.partial{log.suffix}")
    partial.unlink(missing_ok=True)
    driven = simulate(settings, partial)
    partial.rename(log)
    return str(driven).replace(partial.name, log.name)


def _record(recording: Recording, report: Report) -> str:
    with redirect_stderr(io.StringIO()):  # progress bars of parallel drives would overlap
        return simulate_once(*recording)
