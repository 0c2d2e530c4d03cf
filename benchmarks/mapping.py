"""Times of inserting a scan into the map, flattening it, and reading the ground under wheels.

`python benchmarks/mapping.py [--threads 2]`. A vehicle drives 0.5 m between scans of 100,000 points over rolling
ground, a third of the view ending at walls of bushes; the map is +-60 m in cells of 0.2 m. Times are medians, in
brackets the best one and the processor time of all threads, median and best.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch

from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.mapping.terrain_sampler import sample_maps, stack_maps
from offpiste.mapping.voxel_map import VoxelMap, VoxelSettings
from offpiste.mapping.voxels_to_layers import Flattener, FlattenSettings

RINGS, TURN = 64, 1563
SCANS = 40


def scan(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A spinning LiDAR's points around it (at 1.8 m), ring by ring, and their distances."""
    azimuth = np.linspace(-np.pi, np.pi, TURN, endpoint=False)
    elevation = np.radians(np.linspace(-25, 2, RINGS))[:, None]
    sector = np.where(rng.random(TURN // 20 + 1) < 0.3, rng.uniform(8, 70, TURN // 20 + 1), 79)
    bush = np.repeat(sector, 20)[:TURN]
    with np.errstate(divide="ignore"):
        ground = np.where(elevation < 0, 1.8 / np.tan(-elevation), np.inf)
    flat = np.minimum(ground * (1 + 0.02 * np.sin(9 * azimuth)), bush)
    points = np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), flat * np.tan(elevation) + 1.8), axis=2)
    points += rng.normal(0, 0.02, points.shape)
    return points.reshape(-1, 3), np.linalg.norm(points - [0, 0, 1.8], axis=2).ravel().astype(np.float32)


def timed(task: Callable[[], object]) -> np.ndarray:
    """What one run takes by the clock, and of all threads' processor time [ms]."""
    began, busy = time.perf_counter(), time.process_time()
    task()
    return 1e3 * np.array([time.perf_counter() - began, time.process_time() - busy])


def summary(name: str, times: list[np.ndarray]) -> str:
    """Median and best, by the clock and of processor time."""
    (clock, busy), (best, least) = np.median(times, axis=0), np.min(times, axis=0)
    return f"{name:24} {clock:6.1f} ms (best {best:5.1f}; processor {busy:5.1f}, best {least:5.1f})"


def mapping(channels: int, threads: int, scans: int) -> None:
    """Insertion, flattening and lookup."""
    rng = np.random.default_rng(0)
    held = VoxelMap(channels, VoxelSettings(threads=threads))
    flattener = Flattener(held, FlattenSettings())
    layers = flattener.layers()
    points, distance = scan(rng)
    features, has = rng.normal(size=(len(points), channels)).astype(np.float32), rng.random(len(points)) < 0.8
    inserting, flattening = [], []
    for number in range(scans):
        place = np.array([0.5 * number, 0.0])
        seen = points + np.array([*place, 0.0])
        seen[:, 2] += 0.5 * np.sin(0.1 * seen[:, 0]) + 0.5 * np.cos(0.07 * seen[:, 1])
        held.recentre(place, 0.0)
        inserting.append(timed(partial(held.insert, seen, features, has, distance)))
        flattening.append(timed(partial(flattener.layers, layers)))
    layers = flattener.layers(layers)
    about = f"{layers.observed.mean():.0%} of the cells observed, {layers.known.mean():.0%} known"
    print(f"\n{channels} features, {len(points)} points; {held.occupied} voxels, {about}")
    print(summary("insert", inserting[2:]))
    print(summary("flatten 600 x 600", flattening[2:]))
    print(summary("insert + flatten", [a + b for a, b in zip(inserting, flattening, strict=True)][2:]))
    wheels(layers)


def wheels(layers: TerrainLayers) -> None:
    """The ground under four wheels of 1024 x 250 poses."""
    rng = np.random.default_rng(1)
    stack = stack_maps([layers.terrain_map()])
    heading, along = rng.uniform(-np.pi, np.pi, (1024, 1)), np.linspace(0, 30, 250)
    pose = np.stack((along * np.cos(heading) + 20, along * np.sin(heading)), axis=2)[..., None, :]
    corner = np.array([[1.0, 0.7], [1.0, -0.7], [-1.0, 0.7], [-1.0, -0.7]])
    place = torch.as_tensor((pose + corner).reshape(-1, 2), dtype=torch.float32)
    number, offset = torch.zeros(len(place), dtype=torch.long), torch.zeros(len(place), 2, dtype=torch.float64)
    sample = partial(sample_maps, stack, number, place, offset)
    sample()
    print(summary("look up 1024 x 250 x 4", [timed(sample) for _ in range(5)]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--smoke", action="store_true", help="few scans, to try it")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    for channels in (4,) if options.smoke else (4, 40):
        mapping(channels, options.threads, 5 if options.smoke else SCANS)


if __name__ == "__main__":
    main()
