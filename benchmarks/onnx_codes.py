"""Images to codes as ONNX: what float16 and int8 lose, in codes and in predicted positions, and times beside torch.

`python benchmarks/onnx_codes.py LOG [--rig proving_ground] [--images 32] [--turns 15]`. Half of the log's images
calibrate int8, the others measure. Positions: the 16 drives of the parity file over flat ground whose cells, 1 m wide,
have the codes of an image's patches, once with those of the float32 graph and once with the others'. Times: one image,
in turns in one run, medians; processor time counts that of all threads, and others on the machine hardly change it.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import onnxruntime
import torch
from torch import Tensor

from offpiste.conventions import HORIZON_STEPS
from offpiste.dynamics import Dynamics, rollout
from offpiste.export.formats import ImageOptions, export_run
from offpiste.export.onnx_files import encoder_of, extractor_of
from offpiste.export.onnx_graphs import SIZE, ImageToCodes
from offpiste.export.onnx_precision import codes_of, loss_of
from offpiste.export.parity import parity_case, past_of
from offpiste.logs.opening import open_log
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.terrain_sampler import MapStack, MapTerrain, as_codes, last_cells
from offpiste.perception.camera import make_pinhole_camera
from offpiste.rig.rig import load_rig
from offpiste.training.run import Run, pretrained

GRAPHS = ("codes.onnx", "codes-float16.onnx", "codes-int8.onnx")


def pictures_of(log: Path, rig_name: str, count: int) -> list[np.ndarray]:
    """Rectified images of the first camera, spread over a log."""
    rig = load_rig(rig_name)
    sensors = open_sensors(open_log(log, clock=rig.clock), rig)
    name, camera = next(iter(sensors.cameras.items()))
    rectify = make_pinhole_camera(camera, 1, size=SIZE).rectifier
    index = np.linspace(0, len(sensors.stamps(name)) - 1, count).round().astype(int)
    return [rectify(image.pixels) for image in sensors.picked({name: index})]


def positions(dynamics: Dynamics, codes: Tensor) -> Tensor:
    """Where the parity file's drives are after 5 s, over ground with the codes of images' patches."""
    case = parity_case(dynamics)
    tiled = codes.repeat(1, 4, 3, 1)
    ny, nx = tiled.shape[1:3]
    origin = torch.tensor([[-nx / 2, -ny / 2]], dtype=torch.float64).expand(len(tiled), 2)
    ground = MapStack(1.0, origin, last_cells([(ny, nx)] * len(tiled)), torch.zeros(len(tiled), ny, nx, 2), tiled)
    drives = len(case.start)
    encode = as_codes(dynamics.encoder.missing())
    numbers = torch.arange(drives) % len(tiled)
    source = MapTerrain(ground, numbers, torch.zeros(drives, 2, dtype=torch.float64), case.wheels, encode)
    start = dynamics.start(past_of(dynamics, case), case.start[:, :6], case.start[:, 6:])
    return rollout(dynamics, start, case.controls, source).state[:, HORIZON_STEPS - 1, :2]


def print_losses(run: Run, folder: Path, images: Tensor) -> None:
    """What each graph loses on images that it was not calibrated with."""
    wanted = codes_of(folder / GRAPHS[0], images)
    places = positions(run.dynamics, wanted)
    print("| graph | codes: root mean square (largest) | of their spread | position after 5 s: mean (largest) [m] |")
    print("|---|---|---|---|")
    for name in GRAPHS[1:]:
        found = codes_of(folder / name, images)
        loss, apart = loss_of(found, wanted), (positions(run.dynamics, found) - places).norm(dim=-1)
        print(
            f"| `{name}` | {loss.rms:.4f} ({loss.largest:.3f}) | {100 * loss.rms / loss.spread:.1f} % | "
            f"{apart.mean():.4f} ({apart.max():.4f}) |"
        )


def print_times(run: Run, folder: Path, image: Tensor, turns: int) -> None:
    """Medians of one image, in turns."""
    extractor, encoder = extractor_of(run), encoder_of(run)
    module = ImageToCodes(extractor, encoder).eval()

    def as_the_run_time() -> None:
        features = torch.from_numpy(extractor.extract(image[0].numpy())).flatten(0, 1)
        encoder(features, torch.ones(len(features), dtype=torch.bool))

    ways: dict[str, Callable[[], Any]] = {
        "torch, the same operations": lambda: module(image),
        "the run time's compiled loops, then the encoder in torch": as_the_run_time,
    }
    for name in GRAPHS:
        session = onnxruntime.InferenceSession(str(folder / name), providers=["CPUExecutionProvider"])
        ways[f"onnxruntime, `{name}`"] = lambda session=session: session.run(None, {"images": image.numpy()})
    clocks = time.perf_counter, time.process_time
    taken: dict[str, list[list[float]]] = {name: [] for name in ways}
    for turn in range(turns + 2):
        for name, way in ways.items():
            before = [clock() for clock in clocks]
            way()
            if turn >= 2:
                taken[name].append([1e3 * (clock() - began) for clock, began in zip(clocks, before, strict=True)])
    medians = {name: np.median(values, axis=0) for name, values in taken.items()}
    first = next(iter(medians.values()))
    print("| way | time [ms] | processor time [ms] | of the first |\n|---|---|---|---|")
    for name, (elapsed, used) in medians.items():
        print(f"| {name} | {elapsed:.0f} | {used:.0f} | {used / first[1]:.2f} |")


@torch.no_grad()
def main() -> None:
    """Export, compare, time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--rig", default="proving_ground")
    parser.add_argument("--images", type=int, default=32)
    parser.add_argument("--turns", type=int, default=15)
    given = parser.parse_args()
    pictures = pictures_of(given.log, given.rig, given.images)
    run = pretrained("proving-ground/dc")
    with TemporaryDirectory() as made:
        calibrating, folder = Path(made) / "pictures", Path(made) / "export"
        calibrating.mkdir()
        for number, picture in enumerate(pictures[::2]):
            cv2.imwrite(str(calibrating / f"{number:03}.png"), picture[..., ::-1])
        export_run("pretrained:proving-ground/dc", folder, "onnx", ImageOptions(calibrating))
        images = torch.from_numpy(np.stack(pictures[1::2]))
        print_losses(run, folder, images)
        print_times(run, folder, images[:1], given.turns)


if __name__ == "__main__":
    main()
