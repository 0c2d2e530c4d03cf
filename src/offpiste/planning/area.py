"""The part of the map that a plan can come to, with its codes."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.dynamics.encoder import FeatureEncoder
from offpiste.mapping.layers import TerrainLayers
from offpiste.mapping.lookup import Encode, MapStack, MapTerrain, as_codes, stack_maps
from offpiste.planning.fused import Codes

KnownGround = Callable[[Float[np.ndarray, "M 2"]], Float[np.ndarray, "M F"]]
"""From places x, y [m] to features of the ground there: a simulator's truth instead of what cameras see."""


@dataclass(frozen=True)
class Area:
    """Layers, and the same as tensors.

    Attributes:
        stack: holds codes where `codes` does.
        codes: as `fused_costs` reads them.
    """

    layers: TerrainLayers
    stack: MapStack
    codes: Codes

    @property
    def encode(self) -> Encode | None:
        """Reads the codes of the stack; None where it holds none."""
        missing = self.codes[1]
        return as_codes(missing) if len(missing) else None

    def terrain(self, offset: Float[Tensor, " 2"], wheels: Float[Tensor, "4 2"], count: int) -> MapTerrain:
        """A source for as many states in the frame at `offset` [m]."""
        number = torch.zeros(count, dtype=torch.long)
        return MapTerrain(self.stack, number, offset.expand(count, 2), wheels, self.encode)


def cropped(layers: TerrainLayers, centre: Float[np.ndarray, " 2"], half: float) -> TerrainLayers:
    """The layers within a square; shares memory.

    Args:
        centre: x, y [m]; cells outside of the layers are left out, but for one.
        half: of the square's side [m].
    """
    ny, nx = layers.known.shape
    first = np.clip(np.floor((centre - half - layers.origin) / layers.resolution).astype(int), 0, [nx - 1, ny - 1])
    last = np.clip(np.ceil((centre + half - layers.origin) / layers.resolution).astype(int), first, [nx - 1, ny - 1])
    window = (slice(first[1], last[1] + 1), slice(first[0], last[0] + 1))
    cut = {f.name: getattr(layers, f.name)[window] for f in fields(layers) if f.name not in ("origin", "resolution")}
    return replace(layers, origin=layers.origin + first * layers.resolution, **cut)


def coded_area(layers: TerrainLayers, encoder: FeatureEncoder | None, ground: KnownGround | None = None) -> Area:
    """An area of a map that holds codes.

    Args:
        encoder: of the model; None where it reads no features.
        ground: known features, which are encoded instead of the map's codes.
    """
    if encoder is None:
        bare = replace(layers, features=layers.features[..., :0])
        stack = stack_maps([bare.terrain_map()])
        return Area(bare, stack, (stack.features[0], torch.zeros(0)))
    missing = encoder.missing().detach()
    if ground is not None:
        codes = encoder(*_known(layers, ground)).detach().unflatten(0, layers.known.shape)
    else:
        held = torch.from_numpy(np.ascontiguousarray(layers.features, np.float32))
        codes = torch.where(held.isfinite().all(dim=-1, keepdim=True), held, missing)
    coded = replace(layers, features=codes.numpy())
    return Area(coded, stack_maps([coded.terrain_map()]), (codes, missing))


def _known(layers: TerrainLayers, ground: KnownGround) -> tuple[Tensor, Tensor]:
    features = torch.from_numpy(np.asarray(ground(layers.centres.reshape(-1, 2)), np.float32))
    return features, torch.ones(len(features), dtype=torch.bool)
