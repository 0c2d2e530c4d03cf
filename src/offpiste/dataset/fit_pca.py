"""Fits the PCA of patch features on images of the training stretches of logs (paper, "Dimensionality Reduction")."""

import logging
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float

from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.splits import Split
from offpiste.errors import PerceptionError
from offpiste.files import write_text
from offpiste.logs.drive import drive_from_log, drive_name
from offpiste.logs.measurements import Image
from offpiste.logs.opening import open_log
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.mapping.replay import Moment, ground_points, pinhole_cameras, replay
from offpiste.parallel import Report
from offpiste.perception.backbones import Backbone
from offpiste.perception.keyframes import image_statistics, keyframes_by_travel, most_diverse
from offpiste.perception.pca import COMPONENTS, IMAGES, Moments, PrincipalComponents, fit
from offpiste.progress import jobs_bar
from offpiste.rig.rig import Rig


class ListedImage(NamedTuple):
    """An image of a log.

    Attributes:
        drive: name of the log.
        camera: in the rig.
        time: the image's stamp [s].
    """

    drive: str
    camera: str
    time: float


def read_image_list(path: Path) -> list[ListedImage]:
    """Images of a list; blank lines and lines that begin with # are passed over.

    Raises:
        PerceptionError: no such file, a line of another form, or no image.
    """
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise PerceptionError(
            "no list of images can be read", where=path, how="give --images a number, or a file"
        ) from error
    result = []
    for number, line in enumerate(lines, start=1):
        words = line.rsplit(maxsplit=2)
        if not words or line.startswith("#"):
            continue
        try:
            drive, camera, seconds = words
            result.append(ListedImage(drive.strip(), camera, float(seconds)))
        except ValueError as error:
            raise PerceptionError(
                f"line {number}: '{line}' names no image", where=path, how="write DRIVE CAMERA SECONDS"
            ) from error
    if not result:
        raise PerceptionError("lists no image", where=path, how="write DRIVE CAMERA SECONDS, a line an image")
    return result


def write_image_list(path: Path, images: Iterable[ListedImage]) -> None:
    """Write a list."""
    write_text(path, "".join(f"{image.drive} {image.camera} {image.time:.6f}\n" for image in images))


logger = logging.getLogger(__name__)


SPACING = 2.0
"""Distance between candidate images of a camera [m]."""


NEAR = 0.01
"""Largest difference between the listed time and the stamp of an image [s]."""


class FittedPca(NamedTuple):
    """A PCA, and the images that it was fitted on."""

    pca: PrincipalComponents
    images: list[ListedImage]


class Candidate(NamedTuple):
    """An image that the PCA may be fitted on."""

    log: int
    camera: str
    time: float
    statistics: Float[np.ndarray, " k"]


def fit_pca(
    logs: Sequence[str | Path],
    rig: Rig,
    split: Split,
    backbone: Backbone,
    *,
    images: int | Sequence[ListedImage] = IMAGES,
    components: int = COMPONENTS,
    seed: int = 0,
) -> FittedPca:
    """Choose images of varied ground and light, and fit on their patches that ground points of the LiDAR hit.

    Args:
        images: how many are chosen; or the images themselves, which must lie in the training part too.

    Raises:
        LogError, RigError: a log cannot be read, or has no cameras and LiDARs.
        PerceptionError: no image of the training part, no patch with ground in it, or a listed image that is not there.
    """
    result: list[Candidate] = []
    with jobs_bar(len(logs), "finding images") as show:
        for number, log in enumerate(logs):
            # Listed images need not lie apart.
            spacing = SPACING if isinstance(images, int) else 0.0
            result += _candidates(number, log, rig, split, spacing, partial(show, number))
    if not result:
        raise PerceptionError("no image in the training part", how="give logs with cameras, or another --split")
    names = [drive_name(log) for log in logs]
    if isinstance(images, int):
        chosen = most_diverse(np.stack([c.statistics for c in result]), images, seed=seed).tolist()
    else:
        chosen = [_listed(image, result, names) for image in images]
    moments = Moments.none(backbone.channels)
    with jobs_bar(len(logs), "features of the chosen images") as show:
        for number, log in enumerate(logs):
            times = {(result[i].camera, result[i].time) for i in chosen if result[i].log == number}
            if times:
                moments = _add_log(moments, _sensors(log, rig), backbone, times, partial(show, number))
            show(number, 1.0)
    pca = fit(moments, backbone, components=components, logs=names, split=split.text)
    logger.info(f"{len(chosen)} of {len(result)} images, {moments.count:.0f} patches of ground")
    return FittedPca(pca, [ListedImage(names[result[i].log], result[i].camera, result[i].time) for i in chosen])


def _listed(image: ListedImage, result: Sequence[Candidate], names: Sequence[str]) -> int:
    for number, candidate in enumerate(result):
        same = (names[candidate.log], candidate.camera) == (image.drive, image.camera)
        if same and abs(candidate.time - image.time) <= NEAR:
            return number
    raise PerceptionError(
        f"image '{image.drive} {image.camera} {image.time:.6f}' is not in the training part of these logs",
        how="remove it from the list; only the training part may be used",
    )


def _sensors(log: str | Path, rig: Rig) -> SensorLog:
    return open_sensors(open_log(log, clock=rig.clock), rig)


def _candidates(
    number: int, log: str | Path, rig: Rig, split: Split, spacing: float, report: Report
) -> list[Candidate]:
    opened = open_log(log, clock=rig.clock)
    sensors = open_sensors(opened, rig)
    sensors.coverage()  # refuses clocks that are not the poses'
    rows = extract_rows(drive_from_log(opened, rig))
    part = split.label(drive_name(log), rows.state[:, :2] + rows.origin)
    result = []
    for done, camera in enumerate(sensors.cameras):
        stamps = np.sort(sensors.stamps(camera))
        stamps = stamps[_in_training(stamps, rows, part == 0)]
        kept = keyframes_by_travel(sensors.poses.at(stamps)[:, :3, 3], spacing)
        times = set(np.round(stamps[kept], 6))
        for image in sensors.stream([camera]):
            report((done + _share(image.time, sensors)) / len(sensors.cameras))
            if isinstance(image, Image) and round(image.time, 6) in times:
                result.append(Candidate(number, camera, round(image.time, 6), image_statistics(image.pixels)))
    return result


def _share(time: float, log: SensorLog) -> float:
    first, last = log.poses.span
    return float(np.clip((time - first) / (last - first), 0, 1))


def _in_training(stamps: Float[np.ndarray, " n"], rows: Rows, training: Bool[np.ndarray, " N"]) -> np.ndarray:
    row = np.searchsorted(rows.time, stamps).clip(0, len(rows.time) - 1)
    inside = (stamps >= rows.time[0]) & (stamps <= rows.time[-1])
    return np.asarray(inside & training[row] & rows.valid[row])


def _add_log(
    moments: Moments, log: SensorLog, backbone: Backbone, times: set[tuple[str, float]], report: Report
) -> Moments:
    cameras = pinhole_cameras(log, backbone.patch)
    hit: dict[tuple[str, float], tuple[torch.Tensor, np.ndarray]] = {}

    def extract(pixels: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return np.asarray(backbone(pixels[None])[0].cpu().numpy())

    def wanted(image: Image) -> bool:
        return (image.camera, round(image.time, 6)) in times

    for moment in replay(log, cameras, extract, 0, wanted=wanted):
        report(_share(moment.time, log))
        current = _ground_hits(moment)
        for key in [key for key in hit if key not in current]:
            moments = _added(moments, *hit.pop(key))
        for key, (features, mask) in current.items():
            before = hit[key][1] if key in hit else np.zeros_like(mask)
            hit[key] = features, before | mask
    for features, mask in hit.values():
        moments = _added(moments, features, mask)
    return moments


def _added(moments: Moments, features: torch.Tensor, mask: np.ndarray) -> Moments:
    return moments.add(features[None], mask[None])


def _ground_hits(moment: Moment) -> dict[tuple[str, float], tuple[torch.Tensor, np.ndarray]]:
    """Of each image in view: its features, and the patches in which a ground point of this scan lies."""
    if moment.projection is None:
        return {}
    ground, result = ground_points(moment), {}
    for number, (view, features) in enumerate(zip(moment.views, moment.features, strict=True)):
        mine = ground & (moment.projection.view == number)
        mask = np.zeros(features.shape[:2], bool)
        mask[moment.projection.row[mine], moment.projection.column[mine]] = True
        result[view.camera.name, view.time] = torch.from_numpy(features), mask
    return result
