"""Windows as in a mirror: left and right are alike to a vehicle, so that each window can teach two."""

from dataclasses import dataclass, replace
from typing import Final

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from offpiste.core.conventions import STATE, WHEELS
from offpiste.core.errors import RunError
from offpiste.core.state import History, Terrain
from offpiste.dataset.columns import COLUMNS
from offpiste.dataset.features_under_wheels import FeaturesUnderWheels
from offpiste.dataset.resample import OWN_COLUMNS
from offpiste.dataset.windows import Batch, Windows

STATE_SIGNS: Final = tuple(-1.0 if name in ("py", "yaw", "vy", "yaw_rate") else 1.0 for name in STATE)
"""Signs of a state, mirrored in the world's x axis."""

NORMAL_SIGNS: Final = (1.0, -1.0, 1.0)
"""Signs of a surface normal in the world frame, mirrored likewise."""

OPPOSITE: Final = tuple(
    WHEELS.index(name.replace("left", "right") if "left" in name else name.replace("right", "left")) for name in WHEELS
)
"""The wheel on the other side of each."""


@dataclass(frozen=True)
class Mirror:
    """Mirrors windows in the world's x axis through the place where each starts.

    Attributes:
        control, actuators: -1 for columns that change their sign (`channels.Control.lateral`), 1 for others.
    """

    control: Float[Tensor, " U"]
    actuators: Float[Tensor, " A"]

    def of(self, batch: Batch, chosen: Bool[Tensor, " B"]) -> Batch:
        """The batch with the mirror images of the chosen windows in their places."""
        return _mirrored(batch, _Signs(chosen, self))


@dataclass(frozen=True)
class _Signs:
    """What changes in the chosen windows of a batch."""

    chosen: Bool[Tensor, " B"]
    mirror: Mirror

    def state(self, values: Float[Tensor, "B *S 6"]) -> Float[Tensor, "B *S 6"]:
        return self._signed(values, values.new_tensor(STATE_SIGNS))

    def control(self, values: Float[Tensor, "B *S U"]) -> Float[Tensor, "B *S U"]:
        return self._signed(values, self.mirror.control)

    def actuators(self, values: Float[Tensor, "B *S A"]) -> Float[Tensor, "B *S A"]:
        return self._signed(values, self.mirror.actuators)

    def terrain(self, terrain: Terrain) -> Terrain:
        normal = self._signed(self.sides(terrain.normal), terrain.normal.new_tensor(NORMAL_SIGNS))
        return Terrain(normal, self.sides(terrain.known), self.sides(terrain.latent))

    def sides(self, values: Shaped[Tensor, "B T 4 *S"]) -> Shaped[Tensor, "B T 4 *S"]:
        """Left and right exchanged."""
        return torch.where(self._broadcast(values), values[:, :, list(OPPOSITE)], values)

    def _signed(self, values: Tensor, signs: Tensor) -> Tensor:
        return torch.where(self._broadcast(values), values * signs, values)

    def _broadcast(self, values: Tensor) -> Tensor:
        return self.chosen.reshape(-1, *[1] * (values.dim() - 1))


def _mirrored(batch: Batch, signs: _Signs) -> Batch:
    history = batch.history
    return replace(
        batch,
        history=History(
            signs.state(history.state),
            signs.actuators(history.actuators),
            signs.control(history.control),
            signs.terrain(history.terrain),
            history.extra,
        ),
        state=signs.state(batch.state),
        actuators=signs.actuators(batch.actuators),
        control=signs.control(batch.control),
        terrain=signs.terrain(batch.terrain),
        target=signs.state(batch.target),
        target_actuators=signs.actuators(batch.target_actuators),
        ground=None if batch.ground is None else _mirrored_ground(batch.ground, signs),
    )


def _mirrored_ground(ground: FeaturesUnderWheels, signs: _Signs) -> FeaturesUnderWheels:
    return replace(ground, past=signs.sides(ground.past), ahead=signs.sides(ground.ahead))


def mirror_of(windows: Windows) -> Mirror:
    """The mirror for the columns of a dataset.

    Raises:
        RunError: the dataset has a column that nobody has said the mirror image of.
    """
    rig = windows.dataset.rig
    unknown = [name for name, column in COLUMNS.items() if column.segments and name not in OWN_COLUMNS]
    if unknown:
        raise RunError(f"no mirror image is known of the column '{unknown[0]}'", how="train without --mirror")

    def signs(lateral: list[bool]) -> Tensor:
        return 1.0 - 2.0 * torch.tensor(lateral, dtype=torch.float32, device=windows.device)

    return Mirror(signs([c.lateral for c in rig.controls]), signs([a.lateral for a in rig.actuators]))
