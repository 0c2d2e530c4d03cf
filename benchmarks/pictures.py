"""The pictures of the proving ground in docs/: `python benchmarks/pictures.py [docs]`.

Four worlds from above, one frame of each camera with the LiDARs' points, a driven path.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from offpiste.core.conventions import DT
from offpiste.simulation.rendering.appearance import make_appearance
from offpiste.simulation.rendering.scene import world_scene
from offpiste.simulation.sample import Motion, VehicleSample
from offpiste.simulation.sensors.camera import Camera, project_points, render
from offpiste.simulation.sensors.lidar import Lidar
from offpiste.simulation.sensors.suite import full_suite
from offpiste.simulation.simulate import drive, start_and_driver
from offpiste.simulation.top_view import draw_top_view
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings
from offpiste.visualization.images import overlay

PRESETS = ("mojave", "halter-ranch", "dunes", "coastal-scrub")


def worlds() -> Figure:
    """The four presets from above."""
    figure = Figure(figsize=(12, 12), dpi=70, layout="constrained")
    for axes, preset in zip(figure.subplots(2, 2).flat, PRESETS, strict=True):
        draw_top_view(make_world(WorldSettings(preset)), axes)
        axes.set_title(preset)
    return figure


def path(world: World, samples: list[VehicleSample]) -> Figure:
    """Path of a drive, coloured by speed."""
    figure = Figure(figsize=(8.6, 8), dpi=80, layout="constrained")
    xy = np.array([s.position[:2] for s in samples])
    speed = np.array([np.hypot(*s.velocity[:2]) for s in samples])
    axes = figure.subplots()
    draw_top_view(world, axes)
    points = axes.scatter(*xy.T, c=speed, cmap="plasma", s=3, zorder=3)
    figure.colorbar(points, ax=axes, shrink=0.7, label="speed [m/s]")
    return figure


def sensors(world: World, sample: VehicleSample) -> Figure:
    """Images of the four cameras at one moment, and the points of both LiDARs in them."""
    scene, suite, rng = world_scene(world), full_suite(), np.random.default_rng(0)
    appearance = make_appearance(world, scene, 0)
    motion = Motion.of([sample, replace(sample, time=sample.time + 1.0)])
    clouds = [
        settings.body_from_sensor.apply(Lidar(settings).scan(scene, motion, sample.time, rng).points)
        for settings in (replace(lidar, dropout=0.0) for lidar in suite.lidars)
    ]
    points = np.concatenate(clouds)
    figure = Figure(figsize=(12, 15.2), dpi=70, layout="constrained")
    rows = figure.subplots(len(suite.cameras), 2)
    for (left, right), settings in zip(rows, suite.cameras, strict=True):
        image = render(scene, appearance, Camera(settings), sample.pose, int(rng.integers(2**31)))
        left.imshow(image)
        mount = settings.body_from_sensor
        points_camera = (points - mount.position) @ mount.rotation
        pixels, inside = project_points(points_camera, settings.model)
        right.imshow(overlay(image, pixels[inside], np.linalg.norm(points_camera[inside], axis=1)))
        left.set_ylabel(settings.name)
        for axes in (left, right):
            axes.set_xticks([])
            axes.set_yticks([])
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the three pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("docs"))
    parser.add_argument("--smoke", action="store_true", help="a short drive, to try it")
    options = parser.parse_args(arguments)
    world = make_world(WorldSettings(seed=3))
    vehicle, seconds = load_vehicle(), 3.0 if options.smoke else 120.0
    samples = list(drive(world, vehicle, *start_and_driver(world, vehicle, seed=3), steps=round(seconds / DT)))
    figures = {
        **({} if options.smoke else {"worlds": worlds()}),
        "drive": path(world, samples),
        "sensors": sensors(world, samples[min(1500, len(samples) - 1)]),
    }
    for name, figure in figures.items():
        figure.savefig(options.folder / f"{name}.jpg", pil_kwargs={"quality": 85})


if __name__ == "__main__":
    main()
