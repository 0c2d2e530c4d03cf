"""Fixed transforms of a log, and the chain of them between two frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from offpiste.errors import LogError


@dataclass(frozen=True)
class Transform:
    """A fixed transform `parent_from_child` [m]."""

    parent: str
    child: str
    matrix: Float[np.ndarray, "4 4"]


def between(transforms: Sequence[Transform], parent: str, child: str, *, path: Path) -> Float[np.ndarray, "4 4"]:
    """`parent_from_child` between two frames that a chain of fixed transforms joins, up or down the tree.

    Raises:
        LogError: no chain joins them, or a transform in it is not rigid.
    """
    steps: dict[str, list[tuple[str, Float[np.ndarray, "4 4"]]]] = {}
    for t in transforms:
        usable = _is_rigid(t.matrix)
        steps.setdefault(t.parent, []).append((t.child, t.matrix))
        steps.setdefault(t.child, []).append((t.parent, np.linalg.inv(t.matrix) if usable else t.matrix))
    known, border = {parent: np.eye(4)}, [parent]
    while border and child not in known:
        frame = border.pop(0)
        for other, matrix in steps.get(frame, []):
            if other not in known:
                known[other] = known[frame] @ matrix
                border.append(other)
    if child not in known:
        frames = ", ".join(sorted(steps)) or "none"
        raise LogError(
            f"no fixed transform joins '{child}' to '{parent}'; frames with transforms: {frames}",
            where=path,
            how="fix frames.body or frames.topics, or give body_from_camera or body_from_lidar in the rig",
        )
    if not _is_rigid(known[child]):
        what = f"the transform from '{parent}' to '{child}' is not rigid"
        raise LogError(what, where=path, how="give body_from_camera or body_from_lidar in the rig")
    return known[child]


def _is_rigid(matrix: Float[np.ndarray, "4 4"]) -> bool:
    turn = matrix[:3, :3]
    return bool(np.isfinite(matrix).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-3))
