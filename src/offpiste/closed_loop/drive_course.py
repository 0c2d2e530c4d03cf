"""Drive a course with a planner: simulation, scores, picture and files."""

import json
import logging
import math
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from offpiste._version import commit, today
from offpiste.closed_loop.courses import KINDS as COURSE_KINDS
from offpiste.closed_loop.courses import ChosenCourse, CourseSettings, choose_course, course_world
from offpiste.closed_loop.lockstep import KINDS, WHENS, Driving, Fault, Kind, When, cameras_of, drive_planned, lidars_of
from offpiste.closed_loop.pictures import course_picture
from offpiste.closed_loop.scores import Trace, firm_way, prediction_errors, summary, trace_of
from offpiste.core.channels import registered_actuators
from offpiste.core.conventions import DT
from offpiste.core.errors import OffpisteError
from offpiste.core.files import check_folder, remove_partials, unfinished, write_text, write_whole
from offpiste.core.progress import Track, track
from offpiste.planning.caution import caution_of
from offpiste.planning.course import FASTEST
from offpiste.rig.rig import load_rig
from offpiste.runtime.planner import Planner
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.settings import RuntimeSettings
from offpiste.simulation.rendering.scene import Scene
from offpiste.simulation.sensors.suite import SensorSuite, sensor_suite
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.grids import read_grid
from offpiste.simulation.world.world import World, WorldSettings
from offpiste.training.run import differing_vehicle

logger = logging.getLogger(__name__)

_UNFINISHED = ".offpiste-drive"
"""Hidden file that marks an incomplete folder."""


@dataclass(frozen=True)
class CourseDriveSettings:
    """Settings of a drive of a course; the same settings and planner give the same drive."""

    world: WorldSettings = field(default_factory=WorldSettings)  # its seed also chooses the course
    seconds: float = 40.0  # time limit [s]
    sensors: str = "light"  # sensor profile (`simulation.sensors`)
    course: CourseSettings = field(default_factory=CourseSettings)
    runtime: RuntimeSettings = field(default_factory=RuntimeSettings)
    against: bool = False  # whether the vehicle starts in the opposite direction and has to turn round
    fault: Kind = "none"  # fault of the sensors from `fault_start` [s] on, or from the next reversing on
    fault_start: float = 10.0
    fault_when: When = "time"
    keep_log: bool = True  # whether to keep drive.mcap; without it, cameras are simulated only for visual features


@dataclass(frozen=True)
class Driven:
    """A finished drive; `result` is the content of result.json."""

    world: World
    chosen: ChosenCourse
    driving: Driving
    trace: Trace
    runtime: Runtime
    result: dict[str, Any]

    def __repr__(self) -> str:
        """Show a summary of the result."""
        return f"Driven({described(self.result)})"


def drive_course(
    planner: Planner,
    settings: CourseDriveSettings,
    out: str | Path,
    *,
    world: World | None = None,
    scene: Scene | None = None,
    track: Track = track,
) -> Driven:
    """Drive a course; writes drive.mcap, drive.png and finally result.json to a folder.

        planner = offpiste.load_planner("pretrained:proving-ground/dc")
        driven = offpiste.drive(planner, offpiste.CourseDriveSettings(offpiste.WorldSettings("dunes")), "drive")
        driven.result["mean_path_error_m"]

    Args:
        world, scene: world of `courses.course_world` and its scene, if available.
        track: progress display.

    Raises:
        OffpisteError: a setting is out of range, the risk needs a spread that the run lacks, the model reads actuators
            added by extensions, or the folder holds a drive already.
    """
    check_settings(settings)
    if lacks := [one.name for one in registered_actuators() if one.name in planner.dynamics.vehicle.actuators]:
        what = f"the model reads {', '.join(lacks)}, which the simulated vehicle does not measure"
        raise OffpisteError(what, where=planner.folder, how="give a run trained without it")
    caution_of(settings.runtime.risk, planner.spread)  # raises before a world is built
    out = Path(out)
    check_folder(out, own=(_UNFINISHED, "result.json"))
    if (out / "result.json").exists():
        raise OffpisteError("exists already", where=out / "result.json", how="give another folder, or remove it")
    rig, parameters = load_rig("proving_ground"), load_vehicle()
    world = world or course_world(settings.world, settings.course.kind)
    chosen, suite = choose_course(world, settings.world.seed, settings.course), sensor_suite(settings.sensors)
    if planner.extractor is None and not settings.keep_log:
        suite = SensorSuite((), suite.lidars)
    if (apart := differing_vehicle(planner.dynamics.vehicle, rig.vehicle)) is not None:
        logger.warning(f"{planner.folder} was trained on another vehicle than the proving ground's: {apart}")
    ground = partial(read_grid, world.properties, world.origin, world.resolution) if planner.knows_ground else None
    fault = Fault(settings.fault, settings.fault_start, settings.fault_when)
    sensors = planner.sensor_setup(cameras_of(suite, rig), lidars_of(suite, rig))
    sensors = replace(sensors, extract=sensors.extract and fault.extractor(sensors.extract))
    runtime = Runtime(
        planner.dynamics, sensors, rig.wheel_positions(), chosen.course,
        replace(settings.runtime, remember=max(settings.seconds, settings.runtime.remember)),
        ground=ground, seed=settings.world.seed, spread=planner.spread,
    )  # fmt: skip
    start = replace(chosen.start, yaw=chosen.start.yaw + math.pi) if settings.against else chosen.start
    with unfinished(out, _UNFINISHED):
        remove_partials(out)
        (out / "drive.mcap").unlink(missing_ok=True)
        driving = drive_planned(
            runtime, world, parameters, start, suite, rig, out / "drive.mcap",
            seconds=settings.seconds, seed=settings.world.seed, fault=fault, scene=scene, track=track,
        )  # fmt: skip
        trace = trace_of(driving, chosen.course)
        weights = settings.runtime.weights
        scores = summary(driving, trace, runtime.course_tracker.length, settings.seconds, weights, parameters)
        result = _result(planner, settings, chosen, runtime, trace, scores)
        title = f"{settings.world.preset}, seed {settings.world.seed}: {planner.name}, {result['time_s']:.1f} s"
        scored = round(result["time_s"] / DT)
        figure = course_picture(world, chosen.course, trace, runtime.predictions, title, scored=scored)
        write_whole(out / "drive.png", lambda partial: figure.savefig(partial, format="png"))
        if not settings.keep_log:
            (out / "drive.mcap").unlink()
        write_text(out / "result.json", json.dumps(result, indent=2, allow_nan=False) + "\n")
    logger.info(described(result))
    return Driven(world, chosen, driving, trace, runtime, result)


def described(result: dict[str, Any]) -> str:
    """Return a one-line summary of a drive."""
    incidents = [name for name in ("rollover", "collision", "stuck", "left_world") if result[name]]
    ending = "finished" if result["finished"] else f"{result['progress_m']:.0f} of {result['course_m']:.0f} m"
    if not result["finished"] and not incidents and result["time_s"] >= result["limit_s"] - 1:
        incidents = ["time limit reached"]
    error = result["plan_error_5s_m"]["mean"]
    plans = f", plans {error:.1f} m off after 5 s" if error is not None else ""
    return (
        f"{result['world']} {result['seed']}, {result['planner']}: {ending} in {result['time_s']:.1f} s, "
        f"{result['mean_speed_mps']:.1f} m/s, {result['mean_path_error_m']:.2f} m off the course "
        f"({result['worst_path_error_m']:.2f} at worst){plans}{'; ' if incidents else ''}{', '.join(incidents)}"
    )


def check_settings(settings: CourseDriveSettings) -> None:
    """Raise `OffpisteError` for the first setting out of range."""
    seconds, speed, fault, start = settings.seconds, settings.course.speed, settings.fault, settings.fault_start
    if not 1.0 <= seconds <= 3600:
        raise OffpisteError(f"invalid time limit of {seconds:g} s", how="give --seconds from 1 to 3600")
    if not 0 < speed <= FASTEST:
        raise OffpisteError(f"invalid target speed of {speed:g} m/s", how=f"give --speed above 0, at most {FASTEST:g}")
    if fault not in KINDS:
        raise OffpisteError(f"unknown fault {fault!r}", how=f"choose one of {', '.join(KINDS)}")
    if settings.fault_when not in WHENS:
        what = f"unknown beginning of a fault, {settings.fault_when!r}"
        raise OffpisteError(what, how=f"choose one of {', '.join(WHENS)}")
    if not 0 <= start < (seconds if fault != "none" else math.inf):
        how = f"give --fault-start of 0 or more, before the drive's end at {seconds:g} s"
        raise OffpisteError(f"invalid start of a fault at {start:g} s", how=how)
    COURSE_KINDS[settings.course.kind], sensor_suite(settings.sensors)  # raise for unknown names


def _result(
    planner: Planner,
    settings: CourseDriveSettings,
    chosen: ChosenCourse,
    runtime: Runtime,
    trace: Trace,
    scores: dict[str, Any],
) -> dict[str, Any]:
    errors = prediction_errors(runtime.predictions, trace.place)
    began = runtime.events[0].time if runtime.events else 0.0
    return {
        "schema": 1,
        "world": settings.world.preset,
        "seed": settings.world.seed,
        "planner": planner.name,
        "latency_s": settings.runtime.latency,
        "target_mps": settings.course.speed,
        "surprise_mps": chosen.surprise,
        **scores,
        "firm_way": firm_way(trace, chosen.course, chosen.firm),
        "plan_error_5s_m": {
            "mean": float(errors.mean()) if len(errors) else None,
            "median": float(np.median(errors)) if len(errors) else None,
            "n": len(errors),
        },
        "modes": [(round(e.time - began, 2), e.mode, e.why) for e in runtime.events],
        "dropped": runtime.dropped,
        "failed_plans": len(runtime.failures),
        "stages": runtime.watch.summary(),
        **settings_of(planner, settings),
        "commit": commit(),
        "date": today(),
    }


def settings_of(planner: Planner, settings: CourseDriveSettings) -> dict[str, Any]:
    """Return the settings in result.json, without the noise, which is a function."""
    runtime = asdict(settings.runtime)
    runtime["sampling"].pop("noise")
    runtime["weights"] = settings.runtime.weights.values()
    given = {
        "run": str(planner.folder.resolve()),
        "limit_s": settings.seconds,
        **{name: getattr(settings, name) for name in ("fault", "fault_start", "fault_when", "against", "sensors")},
        "weights_sha256": planner.weights,
        "novelty": planner.novelty,
        "runtime": runtime,
        "course": asdict(settings.course),
    }
    return dict(json.loads(json.dumps(given, default=str)))
