"""Training from a dataset of the paper's size: memory it takes, and how fast windows are read from disk.

`python benchmarks/train_paper_size.py [FOLDER] [--drives 50]` makes a dataset of noise, 10 km a drive (500 km: about
9 GB on disk, some minutes), then in a process of its own reads batches of 1024 random windows, each with a feature
set of its own, and takes steps of `dc` from random places; prints windows/s, what the parts of a step take, and peak
resident memory. Files that were just written may still be in the page cache; `--cold` drops each file's pages
beforehand.

`--whole` trains `dc` from beginning to end instead, with all windows in every epoch (`--drives 21`: 2 million windows),
and prints what each stage took: for a GPU, `--device cuda --batch 16384`.
"""

import json
import os
import resource
import subprocess
import sys
import time
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import tyro

from offpiste.conventions import ACTUATORS, CONTROL, DT, FEATURE_SETS
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.place import drive_names
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import Split
from offpiste.dataset.store import add_drive, create
from offpiste.rig.rig import load_rig

ROWS, CELLS, FEATURES = 100_000, 130_000, 40
"""Of a drive: 2000 s at 5 m/s, and as many cells as the proving ground's drives have for it."""


def noise(rng: np.random.Generator) -> Rows:
    """A drive straight on at 5 m/s over ground that is noise."""
    state = np.zeros((ROWS, 6), np.float32)
    state[:, 0], state[:, 3] = 5 * DT * np.arange(ROWS), 5
    state[:, 3:] += rng.normal(0, 0.1, (ROWS, 3))
    normal = rng.normal(0, 0.1, (len(FEATURE_SETS), ROWS, 4, 3)).astype(np.float32)
    normal[..., 2] = 1
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    # Wheels reach new cells all the time and return to none.
    index = (np.arange(ROWS)[:, None] * (CELLS - 8) // ROWS + np.array([6, 4, 2, 0])).astype(np.int32)
    shape = (len(FEATURE_SETS), CELLS)
    far = np.full(shape, 20, np.float32)
    cells = Cells(index, rng.normal(size=(*shape, FEATURES)).astype(np.float16), rng.random(shape) < 0.7, far, far)
    actuators = rng.uniform(0, 1, (ROWS, len(ACTUATORS))).astype(np.float32)
    control = rng.uniform(0, 1, (ROWS, len(CONTROL))).astype(np.float32)
    return Rows(
        time=DT * np.arange(ROWS),
        origin=np.zeros(2),
        state=state,
        state_causal=state,
        actuators=actuators,
        actuators_causal=actuators,
        control=control,
        control_causal=control,
        normal=normal,
        normal_causal=normal[0, :, 0],
        valid=np.ones(ROWS, bool),
        cells=cells,
    )


def make(path: Path, drives: int) -> None:
    """The dataset; drives that are there stay."""
    names = [f"drive-{number:03}" for number in range(drives)]
    parts = tuple((name, "validation" if name == names[-1] else "train") for name in names)
    split = Split("drives:noise", "drives", drives=parts)
    create(path, load_rig("proving_ground"), split, tuple(f"pca{n}" for n in range(FEATURES)), "noise")
    rows = noise(np.random.default_rng(0))
    missing = sorted(set(names) - set(drive_names(path)))
    with get_context("fork").Pool(os.cpu_count()) as pool:
        pool.map(partial(_add, path, rows, split), missing, chunksize=1)


def _add(path: Path, rows: Rows, split: Split, name: str) -> None:
    add_drive(path, name, rows, split, ())


def forget(path: Path) -> None:
    """Drop the page cache of a dataset's files."""
    for file in (f for f in path.rglob("*") if f.is_file()):
        handle = os.open(file, os.O_RDONLY)
        os.fsync(handle)
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
        os.close(handle)


def resident() -> float:
    """Peak of this process [GiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def read_and_train(path: Path, seconds: float, batch: int, device: str) -> None:
    """Draw windows for some seconds, then take whole steps; a wait after each part tells what it takes."""
    import torch
    from train import by_kernel, make_trainer

    from offpiste.dataset.feature_sets import per_trajectory
    from offpiste.training.batches import draw_sets
    from offpiste.training.terrain_sources import encoded

    began = time.perf_counter()
    trainer = make_trainer(path, batch, torch.device(device))
    windows, rng = trainer.windows, trainer.rng
    print(
        f"opened {len(windows)} windows in {time.perf_counter() - began:.0f} s, peak {resident():.2f} GiB", flush=True
    )
    began, processor, count = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - began < seconds:
        index = rng.choice(len(windows), batch)
        windows.gather(index, draw_sets(per_trajectory, windows, index, rng))
        count += batch
    wall, processor = time.perf_counter() - began, time.process_time() - processor
    print(
        f"read {count} windows: {count / wall:.0f} a second, {count / processor:.0f} a second of processor time, "
        f"peak {resident():.2f} GiB",
        flush=True,
    )
    steps, taken = 0, dict[str, list[float]]()
    began = at = time.perf_counter()

    def mark(part: str) -> None:
        nonlocal at
        if device != "cpu":
            torch.cuda.synchronize()
        before, at = at, time.perf_counter()
        taken.setdefault(part, []).append(1e3 * (at - before))

    while time.perf_counter() - began < seconds:
        trainer.step(mark, encoded, by_kernel(trainer.model))
        steps += 1
    wall = time.perf_counter() - began
    print(f"{steps} steps of {batch} windows: {steps * batch / wall:.0f} a second, peak {resident():.2f} GiB")
    print("a step [ms]: " + ", ".join(f"{part} {np.median(times):.1f}" for part, times in taken.items()))


def train_whole(path: Path, folder: Path, batch: int, epochs: int, device: str) -> None:
    """Train `dc` with all windows in every epoch; print what opening, reading in and each stage took."""
    from offpiste.dataset.store import open_dataset
    from offpiste.training.config import TrainConfig
    from offpiste.training.train import train

    began = time.perf_counter()
    dataset = open_dataset(path)
    print(f"opened in {time.perf_counter() - began:.1f} s", flush=True)
    config = TrainConfig("dc", epochs=epochs, bicycle_epochs=epochs, batch=batch, stride=1, device=device)
    train(dataset, config, folder)
    whole, stages = time.perf_counter() - began, {}
    for line in map(json.loads, (folder / "metrics.jsonl").read_text("utf-8").splitlines()):
        stages.setdefault(line["stage"], []).append(line["seconds"])
    for stage, seconds in stages.items():
        print(f"{stage}: {len(seconds)} epochs, {sum(seconds):.1f} s, an epoch {np.median(seconds):.2f} s")
    print(f"dc, {epochs} epochs on {device}, batches of {batch}: {whole:.1f} s in all")


def main(
    folder: tyro.conf.Positional[Path] = Path("paper-size"),
    drives: int = 50,
    seconds: float = 60.0,
    batch: int = 1024,
    cold: bool = False,
    made: bool = False,
    whole: bool = False,
    epochs: int = 30,
    device: str = "cpu",
) -> None:
    """Make the dataset, then measure in another process.

    Args:
        folder: for the dataset; nothing deletes it.
        drives: of 10 km each; the last one validates.
        seconds: of reading, and of training.
        batch: windows a step.
        cold: drop the dataset from the page cache beforehand.
        made: it is there; measure in this process.
        whole: train `dc` from beginning to end.
        epochs: of bicycle and model, of a whole training.
        device: that trains.
    """
    path = folder / "dataset.zarr"
    if made and whole:
        return train_whole(path, folder / f"run-{batch}", batch, epochs, device)
    if made:
        return read_and_train(path, seconds, batch, device)
    make(path, drives)
    size = sum(f.stat().st_size for f in path.rglob("*") if f.is_file()) / 1e9
    print(f"{path}: {drives * ROWS * 5 * DT / 1000:.0f} km, {size:.1f} GB", flush=True)
    if cold:
        forget(path)
    given = [str(folder), "--seconds", str(seconds), "--batch", str(batch), "--made"]
    given += ["--device", device, *(["--whole", "--epochs", str(epochs)] if whole else [])]
    subprocess.run([sys.executable, __file__, *given], check=True)


if __name__ == "__main__":
    tyro.cli(main)
