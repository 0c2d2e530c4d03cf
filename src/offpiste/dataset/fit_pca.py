"""Fitting of the PCA of patch features on images of training rows (paper, "Dimensionality Reduction")."""

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float

from offpiste.core.errors import PerceptionError
from offpiste.core.files import write_text
from offpiste.core.limits import read_small
from offpiste.core.object_store import brought, expanded
from offpiste.core.parallel import Report, at_a_time, run_all
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.splits import Split, refuse_places_without_origin
from offpiste.logs.drive import drive_from_log, drive_name
from offpiste.logs.log import open_log
from offpiste.logs.measurements import Image
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.mapping.replay import Moment, ground_points, pinhole_cameras, replay
from offpiste.perception.backbones import Backbone
from offpiste.perception.keyframes import image_statistics, keyframes_by_travel, most_diverse
from offpiste.perception.pca import COMPONENTS, IMAGES, Moments, PrincipalComponents, fit
from offpiste.rig.rig import Rig

logger = logging.getLogger(__name__)

SPACING = 2.0
"""Distance between candidate images of a camera [m]."""

NEAR = 0.01
"""Largest difference between a listed time and the stamp of an image [s]."""


class ListedImage(NamedTuple):
    """Image of a log, by its drive, camera and stamp [s]."""

    drive: str
    camera: str
    time: float


def read_image_list(path: Path) -> list[ListedImage]:
    """Read a list of images; blank lines and lines that begin with # are skipped.

    Raises:
        PerceptionError: the file cannot be read, a line is malformed, or there is no image.
    """
    try:
        lines = read_small(path).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise PerceptionError(
            "cannot read the list of images", where=path, how="give --images a number, or a file"
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
                f"line {number}: '{line}' is not an image", where=path, how="write DRIVE CAMERA SECONDS"
            ) from error
    if not result:
        raise PerceptionError("lists no image", where=path, how="write a line DRIVE CAMERA SECONDS per image")
    return result


def write_image_list(path: Path, images: Iterable[ListedImage]) -> None:
    """Write a list of images."""
    write_text(path, "".join(f"{image.drive} {image.camera} {image.time:.6f}\n" for image in images))


class FittedPca(NamedTuple):
    """PCA and the images it was fitted on."""

    pca: PrincipalComponents
    images: list[ListedImage]


class Candidate(NamedTuple):
    """Candidate image for the PCA and its `image_statistics`."""

    image: ListedImage
    statistics: Float[np.ndarray, " k"]


@dataclass(frozen=True)
class Job:
    """Search for candidate images in a log, or computation of the chosen images' features.

    Attributes:
        spacing: distance between candidate images of a camera [m].
        images: chosen images of this log.
    """

    log: str | Path
    rig: Rig
    split: Split
    spacing: float
    backbone: Backbone
    images: frozenset[ListedImage] = frozenset()


def fit_pca(
    logs: Sequence[str | Path],
    rig: Rig,
    split: Split,
    backbone: Backbone,
    *,
    images: int | Sequence[ListedImage] = IMAGES,
    components: int = COMPONENTS,
    seed: int = 0,
    processes: int = 1,
    cluster: str = "",
) -> FittedPca:
    """Choose images of diverse ground and light, and fit a PCA on their patches with LiDAR points on the ground.

    Args:
        images: number of images to choose, or a list of images of the training part.
        processes: logs read at a time; 0: one per core.
        cluster: address of a Ray cluster that reads them instead (`parallel.run_all`); "" for none.

    Raises:
        LogError, RigError: a log cannot be read, or has no cameras and LiDARs.
        PerceptionError: the training part has no image or no patch with ground, or lacks a listed image.
    """
    refuse_places_without_origin(split, rig)
    logs = sorted(expanded(logs), key=drive_name)  # the chosen images do not depend on the order given
    spacing = SPACING if isinstance(images, int) else 0.0  # listed images may be close
    jobs = [Job(log, rig, split, spacing, backbone) for log in logs]
    do = partial(run_all, processes=at_a_time(processes), cluster=cluster, finished=lambda _: None)
    found = do(_find_images, jobs, description="finding images").checked()
    candidates = [candidate for of_a_log in found for candidate in of_a_log]
    log_of = [number for number, of_a_log in enumerate(found) for _ in of_a_log]
    if not candidates:
        raise PerceptionError("no image in the training part", how="give logs with cameras, or another --split")
    if isinstance(images, int):
        chosen = most_diverse(np.stack([c.statistics for c in candidates]), images, seed=seed).tolist()
    else:
        chosen = [_listed(image, candidates) for image in images]
    mine = [frozenset(candidates[i].image for i in chosen if log_of[i] == number) for number in range(len(logs))]
    jobs = [replace(job, images=listed) for job, listed in zip(jobs, mine, strict=True) if listed]
    moments = Moments.none(backbone.channels)
    for part in do(_read_features, jobs, description="features of the chosen images").checked():
        moments += part
    about = {
        "logs": [drive_name(log) for log in logs],
        "split": split.text,
        "split_drives": [list(pair) for pair in split.drives],
    }
    pca = fit(moments, backbone, components=components, **about)
    logger.info(f"{len(chosen)} of {len(candidates)} images, {moments.count:.0f} patches of ground")
    return FittedPca(pca, [candidates[i].image for i in chosen])


def _listed(image: ListedImage, candidates: Sequence[Candidate]) -> int:
    for number, (found, _) in enumerate(candidates):
        if found[:2] == image[:2] and abs(found.time - image.time) <= NEAR:
            return number
    raise PerceptionError(
        f"image '{image.drive} {image.camera} {image.time:.6f}' is not in the training part of these logs",
        how="remove it from the list; only the training part may be used",
    )


def _moment(stamp: float) -> float:
    """Round a stamp as in lists of images [s]; NumPy's rounding differs for every eighth stamp."""
    return round(float(stamp), 6)


def _find_images(job: Job, report: Report) -> list[Candidate]:
    with brought(job.log) as path:
        log, name = open_log(path, clock=job.rig.clock), drive_name(job.log)
        sensors = open_sensors(log, job.rig)
        sensors.coverage()  # refuses clocks other than the poses'
        rows = extract_rows(drive_from_log(log, job.rig))
        training = job.split.label(name, rows.world_xy) == 0
        return [
            Candidate(ListedImage(name, image.camera, _moment(image.time)), image_statistics(image.pixels))
            for image in _spaced_images(sensors, rows, training, job.spacing, report)
        ]


def _spaced_images(
    sensors: SensorLog, rows: Rows, training: Bool[np.ndarray, " N"], spacing: float, report: Report
) -> Iterator[Image]:
    for done, camera in enumerate(sensors.cameras):
        stamps = np.sort(sensors.stamps(camera))
        stamps = stamps[_in_training(stamps, rows, training)]
        kept = keyframes_by_travel(sensors.poses.at(stamps)[:, :3, 3], spacing)
        times = {_moment(stamp) for stamp in stamps[kept]}
        for image in sensors.stream([camera]):
            report((done + _share(image.time, sensors)) / len(sensors.cameras))
            if isinstance(image, Image) and _moment(image.time) in times:
                yield image


def _share(time: float, log: SensorLog) -> float:
    first, last = log.poses.span
    return float(np.clip((time - first) / (last - first), 0, 1))


def _in_training(stamps: Float[np.ndarray, " n"], rows: Rows, training: Bool[np.ndarray, " N"]) -> np.ndarray:
    row = np.searchsorted(rows.time, stamps).clip(0, len(rows.time) - 1)
    inside = (stamps >= rows.time[0]) & (stamps <= rows.time[-1])
    return np.asarray(inside & training[row] & rows.valid[row])


def _read_features(job: Job, report: Report) -> Moments:
    times, backbone = {image[1:] for image in job.images}, job.backbone

    def extract(pixels: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return np.asarray(backbone(pixels[None])[0].cpu().numpy())

    def wanted(image: Image) -> bool:
        return (image.camera, _moment(image.time)) in times

    with brought(job.log) as path:
        log = open_sensors(open_log(path, clock=job.rig.clock), job.rig)
        moments, hit = Moments.none(backbone.channels), dict[tuple[str, float], tuple[torch.Tensor, np.ndarray]]()
        for moment in replay(log, pinhole_cameras(log, backbone.patch), extract, 0, wanted=wanted):
            report(_share(moment.time, log))
            current = _ground_hits(moment)
            for key in [key for key in hit if key not in current]:
                moments = moments.add(*hit.pop(key))
            for key, (features, mask) in current.items():
                before = hit[key][1] if key in hit else np.zeros_like(mask)
                hit[key] = features, before | mask
    for features, mask in hit.values():
        moments = moments.add(features, mask)
    return moments


def _ground_hits(moment: Moment) -> dict[tuple[str, float], tuple[torch.Tensor, np.ndarray]]:
    """Return the features of each image in view, and the mask of patches with ground points of this scan."""
    if moment.projection is None:
        return {}
    ground, result = ground_points(moment), {}
    for number, (view, features) in enumerate(zip(moment.views, moment.features, strict=True)):
        mine = ground & (moment.projection.view == number)
        mask = np.zeros(features.shape[:2], bool)
        mask[moment.projection.row[mine], moment.projection.column[mine]] = True
        result[view.camera.name, view.time] = torch.from_numpy(features), mask
    return result
