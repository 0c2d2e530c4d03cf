"""Small valid inputs of every kind, and the commands that read them."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import zarr
from safetensors import safe_open
from safetensors.numpy import save_file

from feature_datasets import dataset_with_features
from kitti_drive import kitti_drive
from offpiste.cli import main
from offpiste.training.config import TrainConfig
from offpiste.training.run import build, save_run, vehicle_of
from sensor_bags import raw_image
from sensor_drive import SIDE, STATIC, clouds, good_drive, images, poses, written
from tests.fuzz.mutations import Generator, mutate_message, mutate_values
from tests.fuzz.recordings import CONTAINERS, absurd, driven, rig_text
from tests.fuzz.seals import seal_dataset, seal_run, seal_tensors

Rewrite = Callable[[Path, Generator], str]
"""Rewrites an input through its format with absurd content, and returns a description."""


@dataclass(frozen=True)
class Sound:
    """Valid input.

    Attributes:
        kind: kind in the summary.
        files: file or folder to copy.
        commands: commands with the placeholders `{input}` and `{out}`.
        input: argument of the commands, relative to the copy; "" for all.
        rewrite: rewriting of the copy; without it only bytes and text are mutated.
        share: relative frequency.
        recorded: part of a real drive.
        seal: writes new checksums.
    """

    kind: str
    files: Path
    commands: tuple[str, ...]
    input: str = ""
    rewrite: Rewrite | None = None
    share: float = 1.0
    recorded: bool = False
    seal: Callable[[Path], None] | None = None


def run_command(line: str, **places: object) -> None:
    """Run a command of offpiste."""
    main([word.format(**places) for word in line.split()])


def _made(line: str, **places: object) -> None:
    """Run a command that must succeed."""
    try:
        run_command(line, **places)
    except SystemExit as exit_:
        if exit_.code:
            raise RuntimeError(f"{line.format(**places)} failed") from exit_


QUICK = "--epochs 1 --bicycle-epochs 1 --actuator-epochs 1 --stride 100 --batch 2"
EXTRACT = "extract {input} --out {out}/d.zarr --force --processes 1"


def make_corpus(folder: Path, data: Path | None) -> list[Sound]:
    """Write all valid inputs into a new folder, including small parts of recorded drives in `data`."""
    folder.mkdir(parents=True)
    sound = [*_tables(folder), *_sensors(folder), *_kitti(folder), *_learned(folder), *_texts(folder)]
    return [*sound, *(_recorded(folder, data) if data is not None else ())]


def _tables(folder: Path) -> list[Sound]:
    result = []
    for kind, container in CONTAINERS.items():
        place, rig = folder / kind, folder / f"{kind}.toml"
        place.mkdir()
        container.write(driven(), place / container.name)
        rig.write_text(rig_text(kind))

        def rewrite(copy: Path, rng: Generator, container=container) -> str:
            recording, how = absurd(driven(), rng)
            target = copy / container.name
            shutil.rmtree(target) if target.is_dir() else target.unlink()
            container.write(recording, target)
            return how

        given = f"--rig {rig}"
        commands = (
            f"inspect {{input}} {given}",
            "inspect {input}",
            f"{EXTRACT} {given}",
            f"{EXTRACT} {given} --split places:5",
            "inspect {input} --write-rig {out}/drafted.toml",
        )
        result.append(Sound(kind, place, commands, container.name, rewrite))
        if kind in ("csv", "ros1"):
            log = place / container.name
            lines = (f"inspect {log} --rig {{input}}", f"extract {log} --rig {{input}} --force --out {{out}}/d.zarr")
            result.append(Sound("rig", rig, lines))
    return result


def _sensors(folder: Path) -> list[Sound]:
    place = folder / "sensors"
    place.mkdir()
    log, rig, pca = good_drive(place) / "good.mcap", place / "rig.toml", folder / "p.pca"
    cv2.imwrite(str(place / "mask.png"), np.full((SIDE, SIDE), 0, np.uint8))
    rig.write_text(rig.read_text().replace('info = "/info"', 'info = "/info"\nmask = "mask.png"'))
    fit = "fit-pca {log} --rig {rig} --backbone filterbank --images 4 --components 3 --split blocks:1,0,0 --out {pca}"
    _made(fit, log=log, rig=rig, pca=pca)
    rigs = folder / "sensor-rig"
    rigs.mkdir()
    for name in ("rig.toml", "mask.png"):
        shutil.copy(place / name, rigs / name)
    only = folder / "sensor-log"
    only.mkdir()
    shutil.copy(log, only / "good.mcap")
    options = "--split blocks:1,0,0"
    extract = f"extract {{log}} --rig {{rig}} --pca {{pca}} {options} --force --processes 1 --out {{{{out}}}}/d.zarr"
    fit = f"fit-pca {{log}} --rig {{rig}} --backbone filterbank --images 4 --components 3 {options} --out {{{{out}}}}/p"
    view = "view {log} --rig {rig} --seconds 1:2 --no-rrd --out {{out}}/v"
    inspect = "inspect {log} --rig {rig}"

    def lines(*commands: str, **changed: object) -> tuple[str, ...]:
        return tuple(command.format(**{"log": log, "rig": rig, "pca": pca} | changed) for command in commands)

    of_log = lines(extract, extract, fit, inspect, view, log="{input}")
    of_pca = lines(extract, extract, view + " --pca {{input}}", pca="{input}")
    return [
        Sound("sensors", only, of_log, "good.mcap", _absurd_drive, 2),
        Sound("rig", rigs, lines(extract, inspect, fit, rig="{input}"), "rig.toml", share=2),
        Sound("pca", pca, of_pca, rewrite=_absurd_tensors, share=2, seal=seal_tensors),
    ]


def _absurd_drive(copy: Path, rng: Generator) -> str:
    """A sensor drive with an absurd field in all messages of a topic: the same, or another one in each."""
    messages = [*STATIC, *images(), *clouds(), *poses()]
    if rng.random() < 0.3:
        encoding = str(rng.choice(("rgb8", "mono8", "bayer_rggb8", "16UC1", "")))
        picture = np.zeros((SIDE, SIDE, 3) if encoding == "rgb8" else (SIDE, SIDE), np.uint8)
        shown = [(t, "/image", raw_image(t, encoding, picture)) for t in np.arange(0.05, 6, 0.25)]
        messages = [*STATIC, *shown, *clouds(), *poses()]
    topic, seed, varies = str(rng.choice(sorted({m[1] for m in messages}))), rng.integers(2**32), rng.random() < 0.5
    how = ""
    for n, (at, name, message) in enumerate(messages):
        if name == topic:
            changed, how = mutate_message(message, np.random.default_rng(seed + n * varies))
            messages[n] = at, name, changed
    (copy / "good.mcap").unlink()
    written(copy / "good.mcap", messages)
    return f"{topic} {how}{', and others' * varies}"


def _absurd_tensors(copy: Path, rng: Generator) -> str:
    """A safetensors file with absurd values in one tensor, or another shape or type."""
    with safe_open(copy, framework="numpy") as file:
        tensors, about = {name: file.get_tensor(name) for name in file.keys()}, file.metadata()  # noqa: SIM118
    name = str(rng.choice(sorted(tensors)))
    values, how = mutate_values(tensors[name], rng)
    flat = tensors[name].reshape(-1)
    others = {"cut": flat[:-1], "flat": flat, "empty": flat[:0], "ints": values.astype(np.int32)}
    if rng.random() < 0.3:
        how = str(rng.choice(sorted(others)))
        values = others[how]
    save_file({**tensors, name: np.ascontiguousarray(values)}, copy, metadata=about)
    return f"{name} {how}"


def _kitti(folder: Path) -> list[Sound]:
    day, rng, frames = folder / "kitti", np.random.default_rng(0), 40
    calibration = f"S_rect_02: {SIDE} {SIDE}\nP_rect_02: 30 0 27.5 2 0 30 27.5 0 0 0 1 0"
    drive = kitti_drive(day, frames, 0.1, calibration)
    for frame in range(0, frames, 4):
        picture = rng.integers(0, 255, (SIDE, SIDE, 3), dtype=np.uint8)
        cv2.imwrite(str(drive / "image_02" / "data" / f"{frame:010d}.png"), picture)
        points = np.column_stack((rng.uniform(-15, 15, (400, 2)), np.full(400, -1.7), rng.random(400)))
        points.astype("<f4").tofile(drive / "velodyne_points" / "data" / f"{frame:010d}.bin")
    rig = "--rig kitti --split blocks:1,0,0"
    commands = (
        "inspect {input} --rig kitti",
        f"{EXTRACT} {rig}",
        f"{EXTRACT} {rig} --pca {folder}/p.pca",
        f"fit-pca {{input}} {rig} --backbone filterbank --images 4 --out {{out}}/p",
    )
    return [Sound("kitti", day, commands, "drive_sync", _absurd_oxts, 1.5)]


def _absurd_oxts(copy: Path, rng: Generator) -> str:
    """OXTS rows or scans with absurd numbers."""
    drive = copy / "drive_sync"
    if rng.random() < 0.3:
        path = sorted((drive / "velodyne_points" / "data").iterdir())[int(rng.integers(10))]
        values, how = mutate_values(np.fromfile(path, "<f4").reshape(-1, 4), rng)
        values.tofile(path)
        return f"scan {how}"
    paths = sorted((drive / "oxts" / "data").iterdir())
    rows, how = mutate_values(np.array([np.loadtxt(path) for path in paths]), rng)
    for path, row in zip(paths, rows.tolist(), strict=True):
        path.write_text(" ".join(map(repr, row)))
    return f"oxts {how}"


def _learned(folder: Path) -> list[Sound]:
    dataset = dataset_with_features(folder / "data.zarr", rows=560)
    for model in ("b", "dc"):
        save_run(
            folder / model, build(model, vehicle_of(dataset), seed=0), TrainConfig(model=model), dataset, torch.ones(5)
        )
    report = "--out {out}/report"
    of_dataset = (
        f"train {{input}} --model b --out {{out}}/run {QUICK}",
        f"train {{input}} --model dc --out {{out}}/run {QUICK}",
        f"evaluate {folder}/b --dataset {{input}} --lookup recorded {report}",
        f"evaluate {folder}/dc --dataset {{input}} {report}",
        "check {input}",
        "view {input} --out {out}/v",
    )
    of_run = (
        f"evaluate {{input}} --dataset {folder}/data.zarr --lookup recorded {report}",
        f"evaluate {{input}} --dataset {folder}/data.zarr --lookup map {report}",
        "check {input}",
    )
    return [
        Sound("dataset", dataset.path, of_dataset, rewrite=_absurd_dataset, share=2.5, seal=seal_dataset),
        *(Sound("run", folder / name, of_run, rewrite=_absurd_run, share=1.2, seal=seal_run) for name in ("b", "dc")),
    ]


def _absurd_dataset(copy: Path, rng: Generator) -> str:
    """One array of one drive with absurd values."""
    drive = str(rng.choice(sorted(p.name for p in copy.iterdir() if (p / "zarr.json").exists())))
    group = zarr.open_group(copy / drive, mode="r+")
    names = sorted(name for name, member in group.members(max_depth=None) if isinstance(member, zarr.Array))
    name = str(rng.choice(names))
    values, how = mutate_values(np.asarray(group[name][...]), rng)
    group[name][...] = values
    return f"{drive}/{name} {how}"


def _absurd_run(copy: Path, rng: Generator) -> str:
    return _absurd_tensors(copy / "model.safetensors", rng)


def _texts(folder: Path) -> list[Sound]:
    log, rig = folder / "csv" / "drive.csv", folder / "csv.toml"
    split = folder / "split.txt"
    split.write_text("drive train\nother test\nthird validation\n")
    world = folder / "world.toml"
    world.write_text((Path(__file__).parents[2] / "examples/extending/salt_flat.toml").read_text())
    lines = (f"extract {log} --rig {rig} --force --out {{out}}/d.zarr --split drives:{{input}}",)
    drive = "simulate --world {input} --sensors none --seconds 1 --out {out}/s.mcap"
    course = f"drive {folder}/b --world {{input}} --seconds 0.2 --out {{out}}/c"
    return [Sound("split", split, lines, share=0.4), Sound("world", world, (drive, drive, course), share=0.4)]


def _recorded(folder: Path, data: Path) -> list[Sound]:
    """Small parts of real drives."""
    result = []
    for bag in ("PlotJuggler_tilt_laser.bag", "evo_nav2_turtlebot.mcap", "rosbag2_only_topics.mcap"):
        if (data / "bags" / bag).is_file():
            commands = ("inspect {input}", "inspect {input} --write-rig {out}/drafted.toml")
            kind = "ros1" if bag.endswith(".bag") else "mcap"
            shutil.copyfile(data / "bags" / bag, folder / bag)
            result.append(Sound(kind, folder / bag, commands, recorded=True))
    return result
