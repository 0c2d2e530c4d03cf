"""Where the wheels of a level vehicle are in the world: for rows (NumPy), for states (torch), for compiled loops."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

Number = Any
"""A float, a NumPy array or a tensor."""


def wheel_position(px: Number, py: Number, cos: Number, sin: Number, x: Number, y: Number) -> tuple[Number, Number]:
    """Horizontal position of a wheel [m].

    Args:
        px, py: of the pose point [m].
        cos, sin: of the yaw.
        x, y: of the wheel in the body frame, from the pose point [m].
    """
    return px + cos * x - sin * y, py + sin * x + cos * y


def wheel_positions(
    xy: Float[np.ndarray, "N 2"], yaw: Float[np.ndarray, " N"], wheels: Float[np.ndarray, "4 2"]
) -> Float[np.ndarray, "N 4 2"]:
    """Horizontal positions of the wheels in the frame of the poses [m].

    Args:
        xy, yaw: of the pose point [m, rad].
        wheels: in the body frame, from the pose point (`Rig.wheel_positions`) [m].
    """
    x, y = wheels.T
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    return np.stack(wheel_position(xy[:, :1], xy[:, 1:], cos, sin, x, y), axis=-1)


def wheel_positions_of_states(state: Float[Tensor, "*B 6"], wheels: Float[Tensor, "4 2"]) -> Float[Tensor, "*B 4 2"]:
    """The same for states (`conventions.STATE`), as tensors of their type."""
    px, py, yaw = (column[..., None] for column in state[..., :3].unbind(dim=-1))
    x, y = wheels.to(state.dtype).unbind(dim=-1)
    return torch.stack(wheel_position(px, py, torch.cos(yaw), torch.sin(yaw), x, y), dim=-1)
