"""Poses and velocities of logs whose z points down, turned to z up: half a turn about the x axis of world or body."""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.rig.channels import GEOGRAPHIC, ChannelSource

_HALF_TURN = np.array([1.0, -1.0, -1.0])
WORLD_DOWN: Final = ("world down", "ned")
"""Values of `motion.axes` by which the world's third axis points down."""
_BODY_DOWN: Final = ("body down", "ned")
"""The same of the body's."""


def turning_sign(name: str, axes: str) -> int:
    """Sign by which an offset in the rig turns a heading, or its rate, to the left: -1 about an axis that points down.

    An orientation is turned about the body's axis, all else about the world's.
    """
    return -1 if axes in (_BODY_DOWN if name == "orientation" else WORLD_DOWN) else 1


def to_z_up(name: str, source: ChannelSource, values: Float[np.ndarray, "n k"], axes: str) -> Float[np.ndarray, "n k"]:
    """Values of a channel in a world and a body whose z axes point up.

    Latitude and longitude have no axes. They come as east, north, up; a world of north, east, down is north, west, up
    once it is turned, and they with it.

    Args:
        axes: as the rig's `motion.axes` says them: "body down", "world down" or "ned"; "z up" changes nothing.
    """
    world, body = axes in WORLD_DOWN, axes in _BODY_DOWN
    if name == "orientation":
        return _turned(values, world=world, body=body)
    if name in ("yaw", "yaw_rate"):
        return values * turning_sign(name, axes)
    if name == "position" and source.unit == GEOGRAPHIC:
        return _north_west(values) if world else values
    in_world = name == "position" or (name in ("linear_velocity", "angular_velocity") and source.frame == "world")
    in_body = name in ("linear_velocity", "angular_velocity") and source.frame == "body"
    if (in_world and world) or (in_body and body):
        return values * _HALF_TURN[: values.shape[1]]
    return values


def _north_west(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Places north and west, and their height, from those east and north."""
    return np.column_stack((values[:, 1], -values[:, 0], values[:, 2:]))


def _turned(quaternion: Float[np.ndarray, "n 4"], *, world: bool, body: bool) -> Float[np.ndarray, "n 4"]:
    """Orientations xyzw with i multiplied from the left (world) and from the right (body)."""
    x, y, z, w = quaternion.T
    if world:
        x, y, z, w = w, -z, y, -x
    if body:
        x, y, z, w = w, z, -y, -x
    return np.stack((x, y, z, w), axis=1)
