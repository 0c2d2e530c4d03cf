"""Features of photographs without LiDAR or poses: the first components of a PCA as colours beside each photograph.

`python -m experiments.photographs ../shared/data/tartandrive2/images --out photographs`
"""

import logging
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
import tyro
from jaxtyping import Bool, Float, UInt8

from experiments.command import run
from offpiste.errors import PerceptionError
from offpiste.perception.backbones import Backbone, open_backbone
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.perception.pca import Moments, fit
from offpiste.progress import track
from offpiste.report.feature_colours import colour_limits, colours
from offpiste.visualization.images import beside, sheet, write_png

logger = logging.getLogger("experiments")

Photograph = UInt8[np.ndarray, "h w 3"]
_SKY = 1 / 3
"""Share of a photograph, from its top, that is no ground: as in `perception.keyframes.image_statistics`."""
_HOOD = 0.1
"""Share, from its bottom, that shows the vehicle."""


def read_photographs(folder: Path) -> dict[str, Photograph]:
    """RGB images of a folder by name.

    Raises:
        PerceptionError: there are none, or one of them cannot be read.
    """
    result = {}
    for path in sorted(p for p in folder.glob("*") if p.suffix.lower() in (".png", ".jpg", ".jpeg")):
        picture = cv2.imread(str(path))
        if picture is None:
            raise PerceptionError("not a picture", where=path, how="remove it")
        result[path.stem] = np.ascontiguousarray(np.asarray(picture, np.uint8)[:, :, ::-1])
    if not result:
        raise PerceptionError("no pictures", where=folder, how="give a folder of .png or .jpg files")
    return result


def fit_on_photographs(
    photographs: Sequence[Photograph], backbone: Backbone, *, components: int = 20
) -> FeatureExtractor:
    """A PCA on the patches between sky and hood: where a LiDAR is lacking, the best guess at ground."""
    moments = Moments.none(backbone.channels)
    for photograph in photographs:
        with torch.no_grad():
            features = backbone(photograph[None])
        moments = moments.add(features, _between(*features.shape[1:3])[None])
    return FeatureExtractor(backbone, fit(moments, backbone, components=components))


def _between(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    row = np.arange(rows)
    inside = (row >= _SKY * rows) & (row < (1 - _HOOD) * rows)
    return np.repeat(inside[:, None], columns, axis=1)


def picture(
    photograph: Photograph, extractor: FeatureExtractor, limits: Float[np.ndarray, "2 3"]
) -> UInt8[np.ndarray, "h w2 3"]:
    """A photograph and its first three components."""
    height, width = photograph.shape[:2]
    return beside(photograph, colours(extractor.extract(photograph), limits), extractor.backbone.grid(width, height))


def main(folder: tyro.conf.Positional[Path], out: Path = Path("photographs"), backbone: str = "filterbank") -> None:
    """Draw the features of each photograph, and of all in all.png.

    Args:
        folder: folder of photographs.
        out: folder of the pictures.
        backbone: name of a backbone, as in `offpiste fit-pca`.
    """
    photographs = read_photographs(folder)
    extractor = fit_on_photographs(list(photographs.values()), open_backbone(backbone))
    looks = [extractor.extract(photograph) for photograph in photographs.values()]
    ground = [look[_between(*look.shape[:2])] for look in looks]
    limits = colour_limits(np.concatenate(ground))
    out.mkdir(parents=True, exist_ok=True)
    drawn = [picture(photograph, extractor, limits) for photograph in track(list(photographs.values()), "pictures")]
    for name, one in zip(photographs, drawn, strict=True):
        write_png(out / f"{name}.png", one)
    if len({one.shape for one in drawn}) == 1:
        write_png(out / "all.png", sheet([cv2.resize(one, None, fx=0.5, fy=0.5) for one in drawn]))
    share = extractor.pca.variance[:3].sum() / extractor.pca.total_variance
    logger.info(f"{len(drawn)} photographs; the three components drawn explain {share:.0%} of the variance")


if __name__ == "__main__":
    run(main)
