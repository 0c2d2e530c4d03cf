"""Scores of a drive along a course: time, path and speed errors, cost, energy, damage, and errors of the plans."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from offpiste.closed_loop.lockstep import WITHOUT_PROGRESS, Driving, time_of
from offpiste.core.conventions import DT, HORIZON_STEPS
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.course import Course, CourseTracker, arc_length
from offpiste.runtime.modes import Controls
from offpiste.runtime.prediction import Prediction
from offpiste.runtime.settings import RuntimeSettings
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import STUCK
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.vehicle.physics import engine_torque

DAMAGE = {"rollover", "collision with a tree"}
"""Events that damage the vehicle."""
RUN_UP = 20.0
"""Length of the run-up, excluded from the moving cost [m]."""
FINISH = 3.0
"""Distance from its end at which a course is finished [m]."""


@dataclass(frozen=True)
class Trace:
    """Time series of a drive compared with its course."""

    place: Float[np.ndarray, "N 2"]  # x, y of the pose point [m]
    speed: Float[np.ndarray, " N"]  # horizontal speed [m/s]
    off: Float[np.ndarray, " N"]  # distance from the course [m]
    target: Float[np.ndarray, " N"]  # target speed [m/s]
    progress: Float[np.ndarray, " N"]  # distance along the course [m]
    slip: Float[np.ndarray, " N"]  # mean over the wheels of hypot(slip ratio, tan(slip angle))


def trace_of(driving: Driving, course: Course) -> Trace:
    """Return the trace of a drive along its course."""
    tracker = CourseTracker(course)
    place = np.stack([s.position[:2] for s in driving.samples])
    off, target, progress = np.array([(tracker.move(xy), tracker.target, tracker.progress) for xy in place]).T
    speed = np.array([float(np.hypot(*s.velocity[:2])) for s in driving.samples])
    ratio, angle = (
        np.stack([getattr(s.truth, name) for s in driving.samples]) for name in ("slip_ratio", "slip_angle")
    )
    slip = np.hypot(ratio, np.tan(np.clip(angle, -1.4, 1.4))).mean(axis=1)
    return Trace(place, speed, off, target, progress, slip)


def scores_of(driving: Driving, course: Course, limit: float, parameters: VehicleParameters) -> dict[str, Any]:
    """Return the `summary` of a drive with a time limit [s] and default weights."""
    length = float(arc_length(course.driven)[-1])
    return summary(driving, trace_of(driving, course), length, limit, RuntimeSettings().weights, parameters)


def summary(
    driving: Driving, trace: Trace, length: float, limit: float, weights: CostWeights, parameters: VehicleParameters
) -> dict[str, Any]:
    """Return scores up to the end of the course; `vehicle_events` and the final speed cover the whole drive.

    Args:
        length: length of the course [m].
        limit: time limit of the drive [s].
    """
    there = np.flatnonzero(trace.progress >= length - FINISH)
    finished = bool(len(there))
    rows = int(there[0]) + 1 if finished else len(trace.off)
    driven = Trace(*(values[:rows] for values in vars(trace).values()))
    samples, controls = driving.samples[:rows], driving.controls[:rows]
    modes = [control.mode for control in controls]
    happened = {event for sample in samples for event in sample.events}
    if not finished and is_stuck(driven, controls, happened):
        happened.add(STUCK)
    still_until = None if finished else limit
    run_up = int(np.argmax(driven.progress >= RUN_UP))  # 0 if the vehicle did not pass it
    return {
        "finished": finished,
        "time_s": float(rows * DT),
        "driven_cost": driven_cost(driven, still_until, weights),
        "moving_cost": driven_cost(driven, still_until, weights, begin=run_up),
        "course_m": length,
        "progress_m": float(driven.progress[-1]),
        "energy_kj": 1e-3 * engine_energy(samples, parameters),
        "interventions": interventions(controls, happened),
        "driven_m": float(arc_length(driven.place)[-1]),
        "mean_path_error_m": float(driven.off.mean()),
        "worst_path_error_m": float(driven.off.max()),
        "mean_speed_mps": float(driven.speed.mean()),
        "mean_speed_error_mps": float(np.abs(driven.speed - driven.target).mean()),
        "mean_slip": float(driven.slip.mean()),
        "rollover": "rollover" in happened,
        "collision": "collision with a tree" in happened,
        "damage": bool(happened & DAMAGE),
        "stuck": STUCK in happened,
        "backed_out": backed_out(controls),
        "left_world": "left the world" in happened,
        "final_speed_mps": float(trace.speed[-1]),
        "share_of_time": {mode: modes.count(mode) / len(modes) for mode in sorted(set(modes))},
        "vehicle_events": [(round(s.time, 2), event) for s in driving.samples for event in s.events],
    }


def engine_energy(samples: Sequence[VehicleSample], parameters: VehicleParameters) -> float:
    """Return the energy delivered by the engine, without engine braking [J]."""
    record = parameters.as_record()
    speed = np.array([sample.engine_speed for sample in samples]) * 2 * np.pi / 60
    torque = [engine_torque(v, s.command[0], record) for v, s in zip(speed, samples, strict=True)]
    return float(DT * np.maximum(torque * speed, 0.0).sum())


def interventions(controls: Sequence[Controls], happened: set[str]) -> int:
    """Count the interventions of a safety driver: stops by the run time, and one per kind of event.

    The stop of a stuck vehicle counts as the event only.
    """
    drives = [one.drives or one.why == STUCK for one in controls]
    return sum(before and not now for before, now in pairwise(drives)) + len(happened)


def is_stuck(trace: Trace, controls: Sequence[Controls], happened: set[str]) -> bool:
    """Return whether an unfinished drive is stuck: it gave up, backed out, or made no progress at the end.

    A drive with another reason is not stuck: other events, or a stop for missing inputs.
    """
    stopped = bool(controls) and not controls[-1].drives and any(one.drives for one in controls)
    if happened or stopped:
        return STUCK in happened
    last = trace.progress[-round(WITHOUT_PROGRESS / DT) - 1 :]
    return backed_out(controls) or bool(len(last) * DT > WITHOUT_PROGRESS and last[-1] - last[0] < 1.0)


def backed_out(controls: Sequence[Controls]) -> bool:
    """Return whether the vehicle was driven in reverse."""
    return any(one.drives and one.gear < 0 for one in controls)


def firm_way(trace: Trace, course: Course, firm: int | None) -> bool | None:
    """Return whether the vehicle took the firm way; None for a single way, or if it did not reach the ways.

    The taken way is the nearer one where the ways are farthest apart.
    """
    if firm is None:
        return None
    apart = int(np.argmax(np.linalg.norm(np.diff(course.ways, axis=0)[0], axis=1)))
    there = np.flatnonzero(trace.progress >= arc_length(course.path)[apart])
    if not len(there):
        return None
    away = [np.linalg.norm(way - trace.place[there[0]], axis=1).min() for way in course.ways]
    return bool(np.argmin(away) == firm)


def driven_cost(trace: Trace, limit: float | None, weights: CostWeights, *, begin: int = 0) -> float:
    """Integrate the weighted squared distance from the course and squared speed error from row `begin` on.

    These are the path and speed terms of the planner, with the total speed instead of its component along the course.

    Args:
        limit: time limit of an unfinished drive, until which the vehicle counts as standing at its last place [s];
            None for a finished drive.
    """
    left = max((limit or 0.0) - len(trace.off) * DT, 0.0)
    path = weights.path * trace.off[begin:] ** 2
    speed = weights.speed * (trace.speed - trace.target)[begin:] ** 2
    standing = (weights.path * trace.off[-1] ** 2 + weights.speed * trace.target[-1] ** 2) * left
    return float(DT * (path + speed).sum() + standing)


def prediction_errors(predictions: list[Prediction], place: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " P"]:
    """Return the distance between predicted and true place after 5 s [m], for plans within the drive.

    They include changes of plan, since a vehicle follows each plan for only a tenth of a second.
    """
    errors = []
    for prediction in predictions:
        row = round((prediction.time - time_of(0.0)) / DT) + HORIZON_STEPS
        if len(prediction.state) == HORIZON_STEPS and row < len(place):
            errors.append(float(np.linalg.norm(prediction.state[-1, :2] - place[row])))
    return np.array(errors)
