"""How much faster than real time the proving ground runs: medians over several runs, on a world with hills (`--world`).

`python benchmarks/simulate.py [--seconds 20] [--runs 5] [--parts]`. The vehicle alone: rigid bodies, tyres, drive train
and a sample every 0.02 s. The profiles: driver, vehicle, sensors, coding and the file, without the seconds that making
a world takes. Peak memory: of the process, after each line. `--parts`: processor time of an image and a scan alone.
"""

import argparse
import resource
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from offpiste.core.conventions import DT
from offpiste.logs.ros.writer import McapWriter
from offpiste.simulation.messages import image_message
from offpiste.simulation.recorder import Recorder
from offpiste.simulation.rendering.appearance import make_appearance
from offpiste.simulation.rendering.scene import BLOCK, Scene, world_scene
from offpiste.simulation.sample import Motion, Pose
from offpiste.simulation.sensors.camera import Camera, render
from offpiste.simulation.sensors.lidar import Lidar
from offpiste.simulation.sensors.suite import Sensing, observed, sensor_suite
from offpiste.simulation.simulate import drive, start_and_driver
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings


def physics(world: World, seconds: float, *, sampled: bool) -> float:
    """Real time over computing time of a vehicle that circles at moderate speed."""
    x, y = np.array(world.origin) + world.settings.size / 2
    vehicle = VehicleSimulation(world, load_vehicle(), x=float(x), y=float(y), yaw=0.0, speed=5.0)
    begin = time.perf_counter()
    for _ in range(round(seconds / DT)):
        vehicle.step(0.3, 0.0, 0.4)
        if sampled:
            vehicle.sample()
    return seconds / (time.perf_counter() - begin)


def recorded(world: World, sensing: Sensing | None, seconds: float, file: Path) -> float:
    """Real time over computing time of a drive that is recorded."""
    parameters = load_vehicle()
    start, driver = start_and_driver(world, parameters, seed=3)
    begin, rows = time.perf_counter(), 0
    with McapWriter(file) as writer:
        recorder = Recorder(writer, parameters.rolling_radius, np.random.default_rng(0))
        samples = drive(world, parameters, start, driver, steps=round(seconds / DT))
        for sample, messages in observed(samples, sensing, recorder.sensor_stamp_ns):
            recorder.vehicle(sample)
            for topic, message in messages:
                recorder.sensor(topic, message)
            rows += 1
    return rows * DT / (time.perf_counter() - begin)


def parts(world: World, runs: int) -> None:
    """Print the processor time of an image, its parts and a scan of `light` [ms], all from one place of a drive."""
    parameters, suite, rng = load_vehicle(), sensor_suite("light"), np.random.default_rng(0)
    scene = world_scene(world, threads=1)
    appearance = make_appearance(world, scene, 0)
    start, driver = start_and_driver(world, parameters, seed=3)
    samples = list(drive(world, parameters, start, driver, steps=200))[-6:]
    pose, camera, lidar, motion = samples[-1].pose, Camera(suite.cameras[0]), suite.lidars[0], Motion.of(samples)
    image, scanner = render(scene, appearance, camera, pose, 0), Lidar(lidar)
    for name, part in {
        "rays of an image": lambda: _cast_all(scene, camera, pose),
        "image, rays included": lambda: render(scene, appearance, camera, pose, 0),
        "its JPEG": lambda: image_message(image, 0, "camera"),
        "scan": lambda: scanner.scan(scene, motion, samples[0].time, rng),
    }.items():
        part()
        taken = []
        for _ in range(runs):
            begin = time.process_time()
            part()
            taken.append(1e3 * (time.process_time() - begin))
        print(f"{name:22} {statistics.median(taken):6.1f} ms of a core", flush=True)


def _cast_all(scene: Scene, camera: Camera, pose: Pose) -> None:
    """Cast the rays of an image as `render` does, block after block."""
    origin, turned = pose.apply(camera.origin[None]), np.ascontiguousarray(pose.rotation.T, np.float32)
    for first in range(0, len(camera.rays), BLOCK):
        block = slice(first, first + BLOCK)
        scene.cast(origin, camera.rays[block] @ turned, camera.own.part(block))


def report(name: str, ratios: list[float]) -> None:
    """A line: the median, how far runs differ, and memory."""
    spread = f"{min(ratios):.2g} to {max(ratios):.2g} in {len(ratios)} runs"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{name:22} {statistics.median(ratios):6.2f} x real time ({spread}); peak memory {peak:.2f} GiB", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line a part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of driving in a run")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--parts", action="store_true", help="measure an image and a scan instead")
    parser.add_argument("--world", default="mojave", help="preset of the world")
    parser.add_argument("--smoke", action="store_true", help="one short run of each part, to try it")
    options = parser.parse_args(arguments)
    if options.smoke:
        options.seconds, options.runs = 1.0, 1
    world = make_world(WorldSettings(preset=options.world, seed=3))
    if options.parts:
        parts(world, options.runs)
        return
    physics(world, DT, sampled=True)  # compiles
    for name, sampled in (("physics alone", False), ("physics and samples", True)):
        report(name, [physics(world, options.seconds, sampled=sampled) for _ in range(options.runs)])
    for profile, share in (("none", 1.0), ("light", 0.5), ("full", 0.1))[: 2 if options.smoke else None]:
        suite = sensor_suite(profile)
        sensing = Sensing(world, suite, np.random.default_rng(0)) if suite.lidars else None
        with tempfile.TemporaryDirectory() as folder:
            files = [Path(folder) / f"{run}.mcap" for run in range(options.runs + 1)]
            recorded(world, sensing, 1.0, files[-1])  # compiles
            ratios = [recorded(world, sensing, share * options.seconds, file) for file in files[:-1]]
            report(f"recorded, {profile}", ratios)


if __name__ == "__main__":
    main()
