"""Grid of the patches of an image.

Pixel coordinates are OpenCV's and ROS's: the middle of the first pixel is (0, 0).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import PerceptionError


@dataclass(frozen=True)
class PatchGrid:
    """Square patches side by side in the middle of an image, whose edges are cropped.

    960x594 at patch 14 gives 68x42 patches of the crop 952x588 that starts at pixel (4, 3).

    Attributes:
        width, height: of the image [px].
        size: of a patch [px].
    """

    width: int
    height: int
    size: int

    def __post_init__(self) -> None:
        if self.width < self.size or self.height < self.size:
            raise PerceptionError(
                f"an image of {self.width}x{self.height} holds no patch of {self.size}x{self.size} pixels",
                how="give larger images",
            )

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
        """First pixel of the crop, x and y [px]; the crop's principal point is the image's minus this."""
        return (self.width - self.columns * self.size) // 2, (self.height - self.rows * self.size) // 2

    @property
    def crop(self) -> tuple[slice, slice]:
        """Rows and columns of the image that the patches cover."""
        x, y = self.offset
        return slice(y, y + self.rows * self.size), slice(x, x + self.columns * self.size)

    def cells(
        self, pixels: Float[np.ndarray, "n 2"]
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Row and column of the patch at each place (x, y) of the image [px], and whether there is one.

        Rows and columns of places outside, or NaN, are 0.
        """
        place = np.floor((pixels + 0.5 - np.array(self.offset)) / self.size)
        inside = (place >= 0).all(axis=1) & (place[:, 0] < self.columns) & (place[:, 1] < self.rows)
        column, row = np.where(inside[:, None], place, 0).astype(np.int64).T
        return row, column, inside

    def hit(self, pixels: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "rows columns"]:
        """Patches with at least one of these places of the image, e.g. of ground points."""
        row, column, inside = self.cells(pixels)
        hit = np.zeros((self.rows, self.columns), dtype=bool)
        hit[row[inside], column[inside]] = True
        return hit

    def share(self, mask: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "rows columns"]:
        """Share of the pixels of each patch that a mask of the image marks."""
        cropped = mask[self.crop].reshape(self.rows, self.size, self.columns, self.size)
        return cropped.mean(axis=(1, 3))
