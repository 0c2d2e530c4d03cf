"""Grid of square patches of an image. As in OpenCV and ROS, the centre of the first pixel is (0, 0)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.errors import PerceptionError


@dataclass(frozen=True)
class PatchGrid:
    """Square patches in the centre of an image, with cropped edges.

    For example, 960x594 at patch 14 gives 68x42 patches in the crop 952x588 that starts at pixel (4, 3).
    """

    width: int  # of the image [px]
    height: int
    size: int  # of a patch [px]

    def __post_init__(self) -> None:
        if self.width < self.size or self.height < self.size:
            what = f"an image of {self.width}x{self.height} pixels is smaller than a patch ({self.size}x{self.size})"
            raise PerceptionError(what, how="give larger images")

    @property
    def rows(self) -> int:
        """Number of rows of patches."""
        return self.height // self.size

    @property
    def columns(self) -> int:
        """Number of columns of patches."""
        return self.width // self.size

    @property
    def offset(self) -> tuple[int, int]:
        """First pixel of the crop, x and y [px]."""
        return self.width % self.size // 2, self.height % self.size // 2

    @property
    def crop(self) -> tuple[slice, slice]:
        """Rows and columns of the image covered by patches."""
        x, y = self.offset
        return slice(y, y + self.rows * self.size), slice(x, x + self.columns * self.size)

    def share(self, mask: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "rows columns"]:
        """Return the masked share of each patch's pixels."""
        return mask[self.crop].reshape(self.rows, self.size, self.columns, self.size).mean(axis=(1, 3))
