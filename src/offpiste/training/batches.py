"""Batches of an epoch: gathered one ahead to hide reading from disk, with half of the windows mirrored if asked for."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from offpiste.core.conventions import STATE, WHEELS
from offpiste.core.errors import RunError
from offpiste.core.state import History, Terrain
from offpiste.dataset.columns import COLUMNS
from offpiste.dataset.feature_sets import Draw, FeatureSetChoice, drawn
from offpiste.dataset.features_under_wheels import FeaturesUnderWheels
from offpiste.dataset.resample import OWN_COLUMNS
from offpiste.dataset.windows import Batch, Windows
from offpiste.training.distributed import Group

MIRRORED: Final = 0.5
"""Share of the windows that are mirrored, if any."""

STATE_SIGNS: Final = tuple(-1.0 if name in ("py", "yaw", "vy", "yaw_rate") else 1.0 for name in STATE)
"""Signs of a state reflected in the world's x axis."""

NORMAL_SIGNS: Final = (1.0, -1.0, 1.0)
"""Signs of a surface normal, in the world frame, reflected in the x axis."""

OPPOSITE: Final = tuple(
    WHEELS.index(name.replace("left", "right") if "left" in name else name.replace("right", "left")) for name in WHEELS
)
"""Index of the wheel on the other side, for each wheel."""

Item = TypeVar("Item")
Made = TypeVar("Made")


def draw_sets(
    draw: Draw | None, windows: Windows, index: Int[np.ndarray, " B"], rng: np.random.Generator
) -> FeatureSetChoice | None:
    """Draw the feature sets that windows read; None: their own."""
    return drawn(draw, rng, len(index), windows.sets) if draw is not None else None


@dataclass(frozen=True)
class Mirror:
    """Reflects windows in the world's x axis through the place where each starts.

    Attributes:
        control, actuators: -1 for columns that change their sign (`channels.Control.lateral`), else 1.
    """

    control: Float[Tensor, " U"]
    actuators: Float[Tensor, " A"]

    def of(self, batch: Batch, chosen: Bool[Tensor, " B"]) -> Batch:
        """Replace the chosen windows of a batch by their mirror images."""
        signs, history, ground = _Signs(chosen, self), batch.history, batch.ground
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
            ground=None if ground is None else signs.ground(ground),
        )


@dataclass(frozen=True)
class _Signs:
    """Reflection of the chosen windows of a batch, quantity by quantity."""

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

    def ground(self, ground: FeaturesUnderWheels) -> FeaturesUnderWheels:
        return replace(ground, past=self.sides(ground.past), ahead=self.sides(ground.ahead))

    def sides(self, values: Shaped[Tensor, "B T 4 *S"]) -> Shaped[Tensor, "B T 4 *S"]:
        """Swap left and right wheels."""
        return torch.where(self._broadcast(values), values[:, :, list(OPPOSITE)], values)

    def _signed(self, values: Tensor, signs: Tensor) -> Tensor:
        return torch.where(self._broadcast(values), values * signs, values)

    def _broadcast(self, values: Tensor) -> Tensor:
        return self.chosen.reshape(-1, *[1] * (values.dim() - 1))


def mirror_of(windows: Windows) -> Mirror:
    """Return the mirror for the columns of a dataset.

    Raises:
        RunError: the mirror image of a column is not defined.
    """
    rig = windows.dataset.rig
    unknown = [name for name, column in COLUMNS.items() if column.segments and name not in OWN_COLUMNS]
    if unknown:
        raise RunError(f"the mirror image of column '{unknown[0]}' is not defined", how="train without --mirror")

    def signs(lateral: list[bool]) -> Tensor:
        return 1.0 - 2.0 * torch.tensor(lateral, dtype=torch.float32, device=windows.device)

    return Mirror(signs([c.lateral for c in rig.controls]), signs([a.lateral for a in rig.actuators]))


def batches_of(
    windows: Windows,
    parts: Sequence[np.ndarray],
    draw: Draw | None,
    rng: np.random.Generator,
    group: Group,
    mirror: Mirror | None = None,
) -> Iterator[Batch | None]:
    """Yield this process's share of each batch, in order; None where it has no window of a batch.

    Feature sets and mirrored windows are drawn in the same order, however far ahead batches are gathered.

    Args:
        parts: indices of the windows of each batch.
        mirror: mirrors half of the windows; None: no window.
    """

    def gathered(index: np.ndarray) -> Batch | None:
        chosen, share = draw_sets(draw, windows, index, rng), group.share(len(index))
        images = None if mirror is None else rng.random(len(index)) < MIRRORED
        if not len(mine := index[share]):
            return None
        batch = windows.gather(mine, None if chosen is None else chosen[share])
        if mirror is None or images is None:
            return batch
        return mirror.of(batch, torch.as_tensor(images[share], device=windows.device))

    return one_ahead(gathered, parts) if windows.read_ahead else map(gathered, parts)


def one_ahead(make: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
    """Apply a function to items in order, computing the next result while the current one is in use."""
    with ThreadPoolExecutor(max_workers=1) as thread:
        coming = [thread.submit(make, item) for item in items[:1]]
        for item in items[1:]:
            made = coming.pop().result()
            coming.append(thread.submit(make, item))
            yield made
        for last in coming:
            yield last.result()
