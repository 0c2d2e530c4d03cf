"""Courses for a vehicle: from a file, from a nav_msgs/Path, or straight to a goal."""

import csv
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LiveError
from offpiste.core.geometry import local_from_geographic
from offpiste.logs.channel import FAR, to_z_up
from offpiste.planning.course import FASTEST, Course
from offpiste.rig.rig import Rig

_LONGEST: Final = 100_000
"""Number of points of a course that is accepted."""
_APART: Final = 0.05
"""Points that are nearer to each other count once [m]."""


def read_course(path: Path, speed: float, rig: Rig) -> Course:
    """A course from a table with the columns x, y [m] in the world of the poses and, if there is one, speed [m/s].

    In place of x and y it may have lat and lon [degrees], where the rig says where on earth its poses are.

    Args:
        speed: where the table has none [m/s].
        rig: of the vehicle, whose position's origin is the place of x = y = 0.

    Raises:
        LiveError: no such file, or no course in it.
    """
    how = "give a .csv with a line 'x,y' or 'x,y,speed' first, in metres of the poses' frame, or 'lat,lon' in degrees"
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # Excel begins with a byte order mark
            rows = [row for _, row in zip(range(_LONGEST + 1), csv.DictReader(file), strict=False)]
    except OSError as error:
        raise LiveError(f"no course: {error.strerror}", where=path, how=how) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise LiveError(f"no course: {error}", where=path, how=how) from error
    try:
        geographic = bool(rows) and "lat" in rows[0] and "x" not in rows[0]
        names = ("lat", "lon") if geographic else ("x", "y")
        places = np.array([[float(row[name]) for name in names] for row in rows]).reshape(-1, 2)
        has_speed = bool(rows) and rows[0].get("speed") not in (None, "")
        speeds = np.array([float(row["speed"]) for row in rows]) if has_speed else np.full(len(places), speed)
    except (KeyError, TypeError, ValueError) as error:
        raise LiveError(f"a row without a number: {error}", where=path, how=how) from error
    return course_of(_on_earth(places, rig, path) if geographic else places, speeds, where=str(path))


def _on_earth(degrees: Float[np.ndarray, "P 2"], rig: Rig, path: Path) -> Float[np.ndarray, "P 2"]:
    """Places in the world of the poses [m], of latitudes and longitudes."""
    position = rig.channels["position"]
    if position.origin is None:
        how = "give x and y in metres of the poses' frame; degrees need positions in 'lat lon' with an origin"
        raise LiveError(f"a course in degrees, and rig '{rig.name}' does not say where x = y = 0", where=path, how=how)
    places = to_z_up("position", position, local_from_geographic(degrees, position.origin), rig.motion.axes)
    if (away := float(np.abs(places).max(initial=0.0))) > FAR:
        how = "give latitude and longitude of places near the rig's origin, in these columns"
        raise LiveError(f"a point {away / 1e3:.0f} km from channels.position.origin", where=path, how=how)
    return places


def course_from_message(message: Any, speed: float, topic: str, frame: str = "") -> Course:
    """The course of a nav_msgs/Path, whose poses are in the world of the vehicle's poses.

    Args:
        frame: of the vehicle's poses; "" where they do not say it.

    Raises:
        LiveError: it has no two points, or is in another frame.
    """
    given = str(message.header.frame_id).lstrip("/")
    if frame and given and given != frame:
        how = f"publish it in '{frame}'"
        raise LiveError(f"a path in '{given}', the vehicle's poses are in '{frame}'", where=f"topic '{topic}'", how=how)
    places = [(pose.pose.position.x, pose.pose.position.y) for pose in message.poses[: _LONGEST + 1]]
    xy = np.array(places, dtype=np.float64).reshape(-1, 2)
    return course_of(xy, np.full(len(xy), speed), where=f"topic '{topic}'")


def course_to(goal: Float[np.ndarray, " 2"], start: Float[np.ndarray, " 2"], speed: float) -> Course:
    """A straight course from where the vehicle is to a goal [m].

    Raises:
        LiveError: the vehicle is there.
    """
    return course_of(np.stack((start, goal)), np.full(2, speed), where="the goal")


def is_same_course(one: Course, other: Course) -> bool:
    """Whether two courses have the same points and speeds."""
    return np.array_equal(one.path, other.path) and np.array_equal(one.speed, other.speed)


def course_of(xy: Float[np.ndarray, "P 2"], speed: Float[np.ndarray, " P"], *, where: str) -> Course:
    """A course of points that are checked, those that repeat left out.

    Raises:
        LiveError: fewer than two points, or one that is no place or no speed.
    """
    if len(xy) > _LONGEST:
        raise LiveError(f"a course of more than {_LONGEST} points", where=where, how="thin it out")
    if not np.isfinite(xy).all() or not ((speed > 0) & (speed <= FASTEST)).all():
        how = f"give finite metres, and speeds above 0 and at most {FASTEST:g} m/s"
        raise LiveError("a point of the course is no place, or its speed is none", where=where, how=how)
    keep = [0] if len(xy) else []
    for k in range(1, len(xy)):
        if np.linalg.norm(xy[k] - xy[keep[-1]]) >= _APART:
            keep.append(k)
    if len(keep) < 2:
        raise LiveError("no course: fewer than two points apart", where=where, how="give where it leads")
    return Course(xy[keep], speed[keep])
