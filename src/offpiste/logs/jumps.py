"""Where poses jump: a vehicle cannot be there so soon. Maps and windows must not reach across."""

from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from offpiste.geometry import rotation_from_quaternion
from offpiste.logs.channel import Channel

FARTHEST: Final = 1.0
"""A step that is longer than the speed explains by more than this is a jump [m]: five cells of the map. Shorter ones,
GPS has many; `offpiste inspect` lists them."""
_AROUND: Final = 21
"""Samples whose median speed explains a step."""
_ACCELERATION: Final = 10.0
"""No vehicle changes its speed faster [m/s^2]; counts where samples are far apart."""
_TURN: Final = np.deg2rad(20.0)
"""A turn between two samples that is larger than this ..."""
_TURN_RATE: Final = 4.0
"""... and than what the vehicle could turn meanwhile [rad/s] is a jump."""


def find_jumps(position: Channel, orientation: Channel | None = None) -> Float[np.ndarray, "j 2"]:
    """The last moment before and the first one after each jump, in the order of time [s]."""
    found = [_between(position, position_excess(position) > FARTHEST)]
    if orientation is not None and len(orientation.time) > 1:
        turned = _turns(orientation)
        limit = np.maximum(_TURN, _TURN_RATE * np.diff(orientation.time))
        found.append(_between(orientation, turned > limit))
    jumps = np.concatenate(found)
    return jumps[np.lexsort(jumps.T[::-1])]


def position_excess(position: Channel) -> Float[np.ndarray, " m"]:
    """By how much each of the m = n - 1 steps is longer than the speed around it explains [m]."""
    step = np.linalg.norm(np.diff(position.values, axis=0), axis=1)
    dt = np.diff(position.time)
    speed = median_filter(step / dt, _AROUND, mode="nearest")
    return step - (speed + _ACCELERATION * dt) * dt


def _turns(orientation: Channel) -> Float[np.ndarray, " m"]:
    """Angle between neighbouring samples [rad]."""
    matrix = rotation_from_quaternion(orientation.values)
    trace = np.einsum("nij,nij->n", matrix[:-1], matrix[1:])
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def _between(channel: Channel, jumps: np.ndarray) -> Float[np.ndarray, "j 2"]:
    first = np.flatnonzero(jumps)
    return np.stack((channel.time[first], channel.time[first + 1]), axis=1)
