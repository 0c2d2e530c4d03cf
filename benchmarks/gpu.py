"""Parity and times on an NVIDIA GPU; `gpu.sh` runs every stage in a process of its own.

`python benchmarks/gpu.py [STAGE ...] [--device cuda] [--out FILE] [--small]`. Stages: `plans` (rollouts with map and
cost, whole plans, and the packing and copying in them), `spread` (both with the predictions' spread), `images`
(features of images), `training` (rollouts forward and back), `train` (trainings on the CPU and on the device, whose
validation losses must agree; with `--alone` on the device only). Without a stage it prints the device.
"""

import argparse
import json
import platform
from collections.abc import Sequence
from pathlib import Path

import torch
from gpu_planning import of_images, of_plans, of_spread
from gpu_timing import Row
from gpu_training import of_train, of_training

from offpiste.core.errors import OffpisteError
from offpiste.training.run import load_run

STAGES = {
    "plans": of_plans,
    "spread": of_spread,
    "images": of_images,
    "training": of_training,
    "train": of_train,
}


def opened(name: str) -> torch.device:
    """A device; one line where there is none."""
    device = torch.device(name)
    if device.type == "cuda" and not torch.cuda.is_available():
        built = f"was built for CUDA {torch.version.cuda}" if torch.version.cuda else "was built without CUDA"
        raise SystemExit(f"no GPU '{name}': torch {torch.__version__} {built}, and sees none here")
    return device


def main(arguments: Sequence[str] | None = None) -> None:
    """Check, time, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "stages", nargs="*", metavar="STAGE", help=f"any of {', '.join(STAGES)}; without one, print the device"
    )
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--out", type=Path, default=Path("gpu.json"))
    small = "few samples, no graph: for memcheck, or without a GPU"
    parser.add_argument("--small", "--smoke", action="store_true", help=small)
    parser.add_argument("--turns", type=int, default=30)
    parser.add_argument("--dataset", type=Path, help="of the stage `train`, with features")
    parser.add_argument("--epochs", type=int, default=10, help="of bicycle and model on that dataset")
    parser.add_argument("--batch", type=int, nargs="+", default=[128], help="windows a step of the stage `train`")
    parser.add_argument("--alone", action="store_true", help="train on the device only, not on the CPU as well")
    given = parser.parse_args(arguments)
    if given.small:
        given.turns = 2
    if unknown := set(given.stages) - set(STAGES):
        parser.error(f"no stage {', '.join(sorted(unknown))}")
    device = opened(given.device)
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.processor()
    print(f"{name}, torch {torch.__version__}, CUDA {torch.version.cuda}", flush=True)
    rows: list[Row] = []
    for stage in given.stages:
        dynamics = load_run("pretrained:proving-ground/dc").dynamics.requires_grad_(False)
        for row in STAGES[stage](dynamics, device, given):
            rows.append(row)
            given.out.write_text(json.dumps(rows, indent=2) + "\n")
            print(row, flush=True)


if __name__ == "__main__":
    try:
        main()
    except OffpisteError as error:
        raise SystemExit(str(error)) from error
