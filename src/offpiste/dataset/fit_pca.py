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

SPACING = 2.0  # distance between candidate images of a camera [m]


class ListedImage(NamedTuple):
    """Image of a log, by its drive, camera and stamp [s]."""

    drive: str
    camera: str
    time: float


def write_image_list(path: Path, images: Iterable[ListedImage]) -> None:
    """Write a list of images."""
    write_text(path, "".join(f"{image.drive} {image.camera} {image.time:.6f}\n" for image in images))


class FittedPca(NamedTuple):
    """PCA and the images it was fitted on."""

    pca: PrincipalComponents
    images: list[ListedImage]


@dataclass(frozen=True)
class Job:
    """Search for candidate images in a log, or computation of the chosen images' features."""

    log: str | Path
    rig: Rig
    split: Split
    backbone: Backbone
    images: frozenset[ListedImage] = frozenset()  # chosen from this log


def fit_pca(
    logs: Sequence[str | Path],
    rig: Rig,
    split: Split,
    backbone: Backbone,
    *,
    images: int = IMAGES,
    components: int = COMPONENTS,
    seed: int = 0,
    processes: int = 1,
    cluster: str = "",
) -> FittedPca:
    """Choose images of diverse ground and light, and fit a PCA on their patches with LiDAR points on the ground.

    Raises `PerceptionError` if the training part has no image or no patch with ground.

    Args:
        images: number of images to choose.
        processes: logs read at a time; 0: one per core.
        cluster: address of a Ray cluster that reads them instead (`parallel.run_all`); "" for none.
    """
    refuse_places_without_origin(split, rig)
    logs = sorted(expanded(logs), key=drive_name)  # the chosen images do not depend on the order given
    jobs = [Job(log, rig, split, backbone) for log in logs]
    do = partial(run_all, processes=at_a_time(processes), cluster=cluster, finished=lambda _: None)
    found = do(_find_images, jobs, description="finding images").checked()
    candidates = [(job, *candidate) for job, of_a_log in zip(jobs, found, strict=True) for candidate in of_a_log]
    if not candidates:
        raise PerceptionError("no image in the training part", how="give logs with cameras, or another --split")
    statistics = np.stack([each for _, _, each in candidates])
    chosen = [candidates[i] for i in most_diverse(statistics, images, seed=seed)]
    mine = [frozenset(image for of, image, _ in chosen if of is job) for job in jobs]
    jobs = [replace(job, images=listed) for job, listed in zip(jobs, mine, strict=True) if listed]
    moments = Moments.none(backbone.channels)
    for part in do(_read_features, jobs, description="features of the chosen images").checked():
        moments += part
    about = {
        "logs": [drive_name(log) for log in logs],
        "split": split.text,
        "split_drives": list(map(list, split.drives)),
    }
    pca = fit(moments, backbone, components=components, **about)
    logger.info(f"{len(chosen)} of {len(candidates)} images, {moments.count:.0f} patches of ground")
    return FittedPca(pca, [image for _, image, _ in chosen])


def _moment(stamp: float) -> float:
    """Round a stamp alike from arrays and images [s]; NumPy's rounding differs for every eighth stamp."""
    return round(float(stamp), 6)


def _find_images(job: Job, report: Report) -> list[tuple[ListedImage, Float[np.ndarray, " k"]]]:
    """Return the candidate images of a log and their `image_statistics`."""
    with brought(job.log) as path:
        log, name = open_log(path, clock=job.rig.clock), drive_name(job.log)
        sensors = open_sensors(log, job.rig)
        sensors.coverage()  # refuses clocks other than the poses'
        rows = extract_rows(drive_from_log(log, job.rig))
        training = job.split.label(name, rows.world_xy) == 0
        return [
            (ListedImage(name, image.camera, _moment(image.time)), image_statistics(image.pixels))
            for image in _spaced_images(sensors, rows, training, report)
        ]


def _spaced_images(sensors: SensorLog, rows: Rows, training: Bool[np.ndarray, " N"], report: Report) -> Iterator[Image]:
    for done, camera in enumerate(sensors.cameras):
        stamps = np.sort(sensors.stamps(camera))
        row = np.searchsorted(rows.time, stamps).clip(0, len(rows.time) - 1)
        inside = (stamps >= rows.time[0]) & (stamps <= rows.time[-1])
        stamps = stamps[inside & training[row] & rows.valid[row]]
        kept = keyframes_by_travel(sensors.poses.at(stamps)[:, :3, 3], SPACING)
        times = {_moment(stamp) for stamp in stamps[kept]}
        for image in sensors.stream([camera]):
            report((done + _share(image.time, sensors)) / len(sensors.cameras))
            if isinstance(image, Image) and _moment(image.time) in times:
                yield image


def _share(time: float, log: SensorLog) -> float:
    first, last = log.poses.span
    return float(np.clip((time - first) / (last - first), 0, 1))


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
