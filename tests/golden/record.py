"""Results of the code as numbers for comparison with later code: `python tests/golden/record.py --out FOLDER`.

Every function returns a dict from names to arrays and texts. A text called `….sha256` is the hash of something larger,
of which `….about` (type, shape), `….numbers` (mean and the like) and `….some` (a thin selection) are kept as well: if
hashes differ, those tell by how much.

All names of the project are imported here, and nowhere else in this folder.
"""

import argparse
import hashlib
import json
import os
import platform
import re
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np
import torch
from mcap.reader import make_reader
from scipy.signal import savgol_filter

from factories import COMMANDED, VEHICLE, Situation
from feature_datasets import dataset_with_features
from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
from offpiste.core.conventions import ACTUATORS, CONTROL, FEATURE_SETS
from offpiste.core.errors import OffpisteError
from offpiste.core.state import History, ModelState, RecordedTerrain, Terrain
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.resample import extract_rows
from offpiste.dataset.splits import parse_split, write_drives
from offpiste.dataset.windows import Batch, FeaturesUnderWheels, Windows
from offpiste.dynamics import MODELS, Dynamics, Vehicle, as_callable, rollout
from offpiste.dynamics.kernels.autograd import rollout_recorded, supports
from offpiste.dynamics.kernels.model_state import to_kernel_state
from offpiste.evaluation.evaluate import EvaluatedModel, evaluate_models
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.extract import extract
from offpiste.inspection.inspect import inspect_log
from offpiste.logs import open_log
from offpiste.logs.drive import drive_from_log
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.replay import pinhole_cameras, replay
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.mapping.terrain_sampler import MapTerrain
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.perception.backbones import open_backbone
from offpiste.perception.feature_extractor import load_feature_extractor
from offpiste.perception.pca import save_pca
from offpiste.planning.controls import CONTROL_LIMITS, keep_within
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import driving_costs, driving_terms, situation_terrain, spread_model_state
from offpiste.planning.kernel import encode_map, fused_costs, fused_rollout, kernel_model_state
from offpiste.planning.mppi import Settings, improve, shift
from offpiste.rig.rig import load_rig
from offpiste.runtime.planner import Planner
from offpiste.simulation.recorder import Imperfections
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import Controller, DriveSettings, record, simulate, start_and_driver
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings
from offpiste.training.config import TrainConfig
from offpiste.training.losses import summed_loss
from offpiste.training.prediction import encoded, predict_batch
from offpiste.training.run import build, load_run
from offpiste.training.train import standardise, train
from planning.test_kernel import ground
from planning_maps import situation
from runtime.stream import parametric, settings

Results = dict[str, np.ndarray | str]

SMALL = 400
"""Arrays of up to so many numbers are kept whole."""


def digest(*parts: bytes) -> str:
    made = hashlib.sha256()
    for part in parts:
        made.update(part)
    return made.hexdigest()[:16]


def summarised(name: str, array: np.ndarray | torch.Tensor, *, keep: int = SMALL) -> Results:
    """A large array: its hash, shape, a few numbers of it, and a selection."""
    if isinstance(array, torch.Tensor):
        array = array.detach().cpu().numpy()
    array = np.ascontiguousarray(array)
    known = array[np.isfinite(array)].astype(np.float64) if array.size else np.zeros(0)
    numbers = [known.mean(), known.std(), known.min(), known.max()] if known.size else [np.nan] * 4
    flat = array.ravel()
    # An odd step that is no multiple of the last axes: the selection runs through all columns.
    step = max(1, -(-len(flat) // keep)) | 1 if len(flat) > keep else 1
    some = flat[::step]
    return {
        f"{name}.sha256": digest(array.tobytes()),
        f"{name}.about": json.dumps([str(array.dtype), list(array.shape), int(array.size - known.size)]),
        f"{name}.numbers": np.array(numbers),
        f"{name}.some": some.copy() if some.dtype.kind in "iub" else some.astype(np.float64),
    }


def parts(name: str, thing: object, *, keep: int = SMALL) -> Results:
    """All arrays of a dataclass or named tuple, by their order: their names may change."""
    names = [f.name for f in fields(thing)] if is_dataclass(thing) else thing._fields  # type: ignore[attr-defined]
    found: Results = {}
    for number, attribute in enumerate(names):
        value = getattr(thing, attribute)
        if isinstance(value, np.ndarray | torch.Tensor):
            found |= summarised(f"{name}.{number}", value, keep=keep)
        elif isinstance(value, float | int):
            found[f"{name}.{number}"] = np.array(float(value))
        elif value is not None and (is_dataclass(value) or hasattr(value, "_fields")):
            found |= parts(f"{name}.{number}", value, keep=keep)
    return found


_TEMPORARY = tempfile.TemporaryDirectory(prefix="golden-")
TEMPORARY = Path(_TEMPORARY.name)


def recorded_data() -> Path | None:
    """The folder of recorded logs, or None where there is none."""
    folder = Path(os.environ.get("OFFPISTE_DATA") or Path(__file__).parents[3] / "shared" / "data")
    return folder if folder.is_dir() else None


def filled(module: torch.nn.Module, rebuilt: torch.nn.Module, *, seed: int = 0) -> torch.nn.Module:
    """Set every parameter in the order of registration, independent of its name and its initial value.

    Args:
        rebuilt: the same module from another seed; parameters equal in both are constants, which are moved only.
    """
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter, other in zip(module.parameters(), rebuilt.parameters(), strict=True):
            drawn = torch.randn(parameter.shape, generator=generator, dtype=torch.float64)
            kept = torch.where(parameter == other, parameter, torch.zeros_like(parameter)).double()
            parameter.copy_((kept + (0.1 * drawn if (parameter == other).all() else 0.2 * drawn)).to(parameter.dtype))
    return module


def made(name: str, vehicle: Vehicle, seed: int = 0) -> Dynamics:
    return filled(build(name, vehicle, seed=1), build(name, vehicle, seed=2), seed=seed)


FEATURES = 5
STEPS, WINDOWS = 30, 20


def batch_of(vehicle: Vehicle) -> Batch:
    """Windows on random ground, float64."""
    at = Situation(WINDOWS, STEPS, seed=3).filled(vehicle, float("nan"))
    draw = np.random.default_rng(4)
    cells = 60
    features = draw.normal(size=(cells + 1, vehicle.features))
    valid = draw.random(cells + 1) > 0.2
    features[~valid], valid[-1] = np.nan, False
    target = at.state[:, None] + torch.as_tensor(0.5 * draw.normal(size=(WINDOWS, STEPS, 6)))
    return Batch(
        history=at.history,
        state=at.state,
        actuators=at.actuators,
        control=at.controls,
        terrain=at.source.terrain,
        target=target,
        target_actuators=torch.zeros(WINDOWS, STEPS, 4, dtype=torch.float64),
        ground=FeaturesUnderWheels(
            torch.as_tensor(features),
            torch.as_tensor(valid),
            torch.as_tensor(draw.integers(0, cells + 1, (WINDOWS, 10, 4))),
            torch.as_tensor(draw.integers(0, cells + 1, (WINDOWS, STEPS, 4))),
        ),
    )


def as_type(batch: Batch, dtype: torch.dtype) -> Batch:
    def change(value: object) -> object:
        if isinstance(value, torch.Tensor):
            return value.to(dtype) if value.is_floating_point() else value
        if is_dataclass(value) and not isinstance(value, type):
            return replace(value, **{f.name: change(getattr(value, f.name)) for f in fields(value)})
        return value

    return change(batch)


def thinned(values: np.ndarray, count: int) -> list[float]:
    """Size, norm, sum and up to `count` numbers of an array."""
    flat = values.ravel()
    return [float(len(flat)), np.linalg.norm(flat), flat.sum(), *flat[:: max(1, len(flat) // count) | 1][:count]]


def learned(name: str, dynamics: Dynamics, trajectory: object, batch: Batch) -> Results:
    """Predictions, losses and the gradients of all parameters in the order of registration."""
    dtype = batch.state.dtype
    scale = torch.tensor([2.0, 0.1, 0.5, 0.2, 0.3], dtype=dtype)
    losses = summed_loss(trajectory.state, batch.target, scale, torch.tensor([1.0, 0.5, 2.0, 1.0, 1.5], dtype=dtype))
    found = summarised(f"{name}.state", trajectory.state, keep=180) | summarised(
        f"{name}.actuators", trajectory.actuators, keep=60
    )
    found[f"{name}.losses"] = losses.detach().double().numpy()
    wanted = [p for p in dynamics.parameters() if p.requires_grad]
    if not wanted or not losses.requires_grad:
        return found
    kept = []
    for gradient in torch.autograd.grad(losses.mean(), wanted, allow_unused=True):
        kept += thinned(np.zeros(1) if gradient is None else gradient.double().numpy(), 8)
    found[f"{name}.gradients"] = np.array(kept)
    return found


def models() -> Results:
    """Every model: eager in float64 with gradients, and by the kernels where they can."""
    whole = replace(VEHICLE, features=FEATURES)
    commanded = replace(COMMANDED, features=FEATURES)
    steering = Vehicle(900.0, 2.4, 0.5, ("steer",), (), rear_axle=1.1, features=FEATURES, pca=3, codes=2)
    cases = [(name, "whole", whole) for name in MODELS]
    cases += [(name, "commanded", commanded) for name in ("kinematic", "parametric", "b", "lstm", "dc")]
    cases += [(name, "steering", steering) for name in ("kinematic", "parametric", "b", "df", "cf")]
    found: Results = {"names": json.dumps(sorted(MODELS))}
    for name, which, vehicle in cases:
        batch, label = batch_of(vehicle), f"{name}.{which}"
        dynamics = made(name, vehicle).double()
        found[f"{label}.parameters"] = np.array([p.numel() for p in dynamics.parameters()], int)
        standardised(dynamics, batch)
        read = encoded(dynamics, batch)
        model_state = dynamics.start(read.history, read.state, read.actuators)
        found |= summarised(f"{label}.carry", torch.nan_to_num(to_kernel_state(model_state)), keep=120)
        source = RecordedTerrain(read.terrain)
        found |= learned(f"{label}.eager", dynamics, rollout(dynamics, model_state, read.control, source), read)
        call, packed = as_callable(dynamics, source), model_state.pack()
        for step in range(3):
            packed = call(packed, read.control[:, step], step)
        after = to_kernel_state(ModelState.unpack(packed))
        found |= summarised(f"{label}.callable", torch.nan_to_num(after), keep=60)

        dynamics, batch = dynamics.float(), as_type(batch, torch.float32)
        if dynamics.actuators is not None:
            dynamics.actuators.requires_grad_(False)
        able = supports(dynamics, torch.device("cpu"), torch.float32)
        found[f"{label}.kernel"] = str(able)
        if not able:
            continue
        read = encoded(dynamics, batch)
        model_state = dynamics.start(read.history, read.state, read.actuators)
        found |= learned(
            f"{label}.kernel", dynamics, rollout_recorded(dynamics, model_state, read.control, read.terrain), read
        )
        with torch.no_grad():
            found |= summarised(f"{label}.predict", predict_batch(dynamics, batch).state, keep=60)
    return found


def standardised(dynamics: Dynamics, batch: Batch) -> None:
    """Standardise the inputs as training does."""

    class Fake(Windows):
        def __init__(self) -> None: ...

        def every(self, stride: int, *, phase: int = 0) -> np.ndarray:
            return np.arange(WINDOWS)

        def __len__(self) -> int:
            return WINDOWS

        def gather(self, index: np.ndarray, *rest: object) -> Batch:
            return batch

        def features_at_starts(self) -> tuple[torch.Tensor, torch.Tensor]:
            return batch.ground.features, batch.ground.valid

    standardise(dynamics, Fake())


WORLD = WorldSettings("mojave", seed=3, size=120.0, resolution=0.5)


def messages(name: str, log: Path) -> Results:
    """The hash of all messages of each topic, in order, with their stamps; and how topics are described."""
    hashes: dict[str, hashlib._Hash] = {}
    counts: dict[str, int] = {}
    described: dict[str, str] = {}
    with log.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            made = hashes.setdefault(channel.topic, hashlib.sha256())
            made.update(message.log_time.to_bytes(8, "little") + message.publish_time.to_bytes(8, "little"))
            made.update(message.data)
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            text = f"{schema.name} {schema.encoding} {channel.message_encoding} ".encode() + schema.data
            described[channel.topic] = digest(text)
    found: Results = {f"{name}.topics": json.dumps(sorted(counts.items()))}
    for topic in sorted(hashes):
        found[f"{name}{topic}.sha256"] = hashes[topic].hexdigest()[:16]
        found[f"{name}{topic}.type.sha256"] = described[topic]
    return found


@cache
def light_drive() -> tuple[Path, object]:
    out = TEMPORARY / "light" / "drive.mcap"
    return out, simulate(DriveSettings(WORLD, 8.0, seed=1, sensors="light"), out)


@cache
def blind_drives() -> list[tuple[Path, object]]:
    """Drives without cameras and LiDARs; the last has the start and the commands of the one before on other ground."""
    found = []
    flaws = Imperfections(0.02, 0.1, 0.5, 20.0)
    for name, settings_ in (
        ("dunes", DriveSettings(replace(WORLD, preset="dunes", seed=5), 14.0, seed=2, sensors="none")),
        ("flaws", DriveSettings(WORLD, 3.0, seed=4, sensors="none", imperfections=flaws)),
    ):
        out = TEMPORARY / "blind" / f"{name}.mcap"
        found.append((out, simulate(settings_, out)))
    asked = DriveSettings(replace(WORLD, preset="halter-ranch", seed=6), 14.0, seed=3, sensors="none")
    world, other = make_world(asked.world), make_world(replace(asked.world, seed=asked.world.seed + 1_000_003))
    ground = replace(world, kinds=other.kinds, wetness=other.wetness, properties=other.properties)
    start, driver = start_and_driver(world, load_vehicle(), seed=3)
    memory = Remembering(driver)
    for name, driven_on, controller in (("ranch", world, memory), ("ranch-twin-1", ground, Replay(memory.commands))):
        out = TEMPORARY / "blind" / f"{name}.mcap"
        found.append((out, record(asked, driven_on, load_vehicle(), start, controller, out, steps=700)))
    return found


@dataclass
class Remembering:
    """A driver whose commands are kept."""

    driver: Controller
    commands: list[np.ndarray] = field(default_factory=list)

    @property
    def stuck(self) -> bool:
        return self.driver.stuck

    def command(self, sample: VehicleSample) -> np.ndarray:
        self.commands.append(self.driver.command(sample))
        return self.commands[-1]


@dataclass
class Replay:
    """Commands of another drive, open loop."""

    commands: list[np.ndarray]
    stuck: bool = False
    row: int = 0

    def command(self, sample: VehicleSample) -> np.ndarray:
        self.row += 1
        return self.commands[min(self.row, len(self.commands)) - 1]


def simulated_log() -> Results:
    found: Results = {}
    full = TEMPORARY / "full.mcap"
    looked = simulate(DriveSettings(WORLD, 0.4, seed=7, sensors="full"), full)
    for log, driven in [light_drive(), (full, looked), *blind_drives()]:
        name = log.stem if log != full else "full"
        found |= messages(name, log)
        found[f"{name}.metres"] = np.array([driven.seconds, driven.metres, len(driven.events)])
        found |= summarised(f"{name}.path", driven.path, keep=100)
        found |= summarised(f"{name}.speed", driven.speed, keep=50)
    return found


@cache
def pca_file() -> Path:
    out = TEMPORARY / "pca.safetensors"
    fitted = fit_pca(
        [light_drive()[0]],
        load_rig("proving_ground"),
        parse_split("blocks:1,0,0"),
        open_backbone("filterbank"),
        images=4,
        components=8,
    )
    save_pca(out, fitted.pca)
    return out


def map_layers() -> Results:
    """The map after 20 scans of a simulated drive, and after random scans with every fusion rule."""
    rig, look = load_rig("proving_ground"), load_feature_extractor(pca_file())
    found: Results = {
        "pca.mean": np.asarray(look.pca.mean, np.float64),
        "pca.basis": np.asarray(look.pca.basis, np.float64)[:60],
        "pca.variance": np.asarray(look.pca.variance, np.float64),
    }
    sensors = open_sensors(open_log(light_drive()[0]), rig)
    cameras = pinhole_cameras(sensors, look.patch)
    for number, moment in enumerate(replay(sensors, cameras, look.extract, look.channels), start=1):
        if number in (1, 10):
            found |= summarised(f"scan.{number}.points", moment.points_world, keep=100)
            for view, seen in enumerate(moment.features):
                found |= summarised(f"scan.{number}.look.{view}", seen, keep=150)
            for view, pixels in enumerate(moment.images):
                found |= summarised(f"scan.{number}.image.{view}", pixels, keep=100)
        if number == 20:
            found |= parts("drive", moment.layers)
            break
    for rule in ("closest", "latest", "average"):
        found |= parts(f"made.{rule}", random_map(rule), keep=200)
    stack = situation(random_map("closest")).ground
    draw = torch.Generator().manual_seed(1)
    state = 8 * torch.rand(50, 6, generator=draw, dtype=torch.float64) - 4
    at = MapTerrain(stack, torch.zeros(50, dtype=torch.long), torch.zeros(50, 2, dtype=torch.float64), WHEELS)
    found |= parts("lookup", at.at(0, state))
    return found


WHEELS = torch.tensor([[1.1, 0.8], [1.1, -0.8], [-1.1, 0.8], [-1.1, -0.8]], dtype=torch.float64)


def random_map(rule: str) -> TerrainLayers:
    pipeline = MapPipeline(6, MapSettings(VoxelSettings(reach=4.0, capacity=50_000, rule=rule)))
    rng = np.random.default_rng(0)
    for step in range(6):
        vehicle = np.array([0.7 * step, -0.3 * step, 0.05 * step])
        points = vehicle + rng.uniform(-4, 4, (2000, 3)) * [1, 1, 0.1]
        points[:40, 2] += 2.5
        features = rng.normal(size=(2000, 6)).astype(np.float32)
        pipeline.add(FeatureCloud(points, vehicle + np.array([0, 0, 1.8]), features, rng.random(2000) < 0.66), vehicle)
        pipeline.add(FeatureCloud(points[:100] + 0.05, vehicle), vehicle)
    return pipeline.layers()


def dataset() -> Results:
    """Dataset of a simulated drive: rows, features by distance, snapshots of the map, windows."""
    made = extract(
        [light_drive()[0]],
        load_rig("proving_ground"),
        TEMPORARY / "visual.zarr",
        split=write_drives(TEMPORARY / "visual.txt", [("drive", "test")]),
        pca=pca_file(),
    )
    (drive,) = made.drives
    found: Results = parts("rows", drive.rows) | summarised("part", drive.part)
    found["names"] = json.dumps([list(made.features), list(FEATURE_SETS), list(CONTROL), list(ACTUATORS)])
    found["min_hindsight"] = np.array(made.min_hindsight)
    kept = drive.snapshots
    found |= parts("snapshots", kept)
    found |= {
        key: value
        for number, name in enumerate(kept.cells)
        for key, value in summarised(f"cells.{number}", np.asarray(kept.cells[name][:])).items()
    }
    windows = Windows(made, "test")
    found["windows"] = np.asarray(windows.rows, int)
    found |= parts("gathered", windows.gather(np.arange(len(windows))[:: max(1, len(windows) // 4)]), keep=150)
    (path, _), _, (other, _), _ = blind_drives()
    oracle = extract(
        [path, other],
        load_rig("proving_ground"),
        TEMPORARY / "oracle.zarr",
        split="blocks:0.5,0.25,0.25",
        features="ground-truth",
    )
    for number, one in enumerate(oracle.drives):
        found |= parts(f"oracle.{number}", one.rows, keep=150)
        found |= summarised(f"oracle.{number}.part", one.part, keep=50)
        if one.load_map is not None:
            found |= parts(f"oracle.{number}.map", one.load_map(), keep=100)
    return found


def recorded_dataset() -> Results:
    """Rows of recorded drives."""
    found: Results = {}
    for path, rig in recorded_logs():
        if rig is None or "down_meadows" in path.name:
            continue
        if rig.startswith("dart") and path not in (sorted(path.parent.glob("*.csv"))[0],):
            continue
        preset = load_rig(rig)
        log = open_log(path, clock=preset.clock)
        drive = drive_from_log(log, preset)
        found[f"{path.name}.notes"] = json.dumps(sorted(number for note in drive.notes for number in numbers(note)))
        found |= parts(path.name, extract_rows(drive), keep=300)
    return found


def plan() -> Results:
    """Three updates of MPPI, and the costs of one set of samples, by the kernel and without it."""
    found: Results = {}
    weights = CostWeights(lateral_limit=0.25, rollover=20.0)
    planned = Settings(CONTROL_LIMITS, (0.3, 0.1, 0.3), samples=96, temperature=3.0, rest=(0.3, 0.0, 0.0))
    at = situation(ground(), hazards=Hazards(obstacle=50.0), state=(-3.0, 1, 0.3, 8, 0.2, 0.1))
    found |= parts("prices", at.costs) | {"prices.3": np.array(at.costs.outside[0])}
    for name, vehicle in (
        ("parametric", COMMANDED), ("b", COMMANDED), ("dc", COMMANDED), ("b", VEHICLE),
    ):  # fmt: skip
        label = f"{name}.{len(vehicle.actuators)}"
        dynamics = made(name, replace(vehicle, features=2)).eval().requires_grad_(False)
        standardised(dynamics.double(), batch_of(dynamics.vehicle))
        dynamics.float()
        past = carry_at(dynamics, at.state)
        encoder = dynamics.encoder
        codes = encode_map(at.ground, encoder)
        costs = {
            "fused": fused_costs(dynamics, past, at, weights, codes),
            "eager": driving_costs(dynamics, past, at, weights, encoder),
        }
        for reading, cost_of in costs.items():
            controls = torch.tensor([0.4, 0.0, 0.0]).repeat(50, 1)
            generator = torch.Generator().manual_seed(5)
            for update in range(3):
                previous = torch.tensor([0.3, 0.0, 0.0])
                better = improve(controls, cost_of, planned, generator, previous=previous)
                smooth = savgol_filter(better.controls.numpy(), 9, 3, axis=0, mode="nearest")  # as recorded
                controls = keep_within(CONTROL_LIMITS, planned.dt, torch.from_numpy(smooth)[None], previous)[0]
                found[f"{label}.{reading}.{update}.controls"] = controls.double().numpy()[::3]
                found |= summarised(f"{label}.{reading}.{update}.costs", better.costs, keep=24)
                controls = shift(controls, 5)
        draw = torch.Generator().manual_seed(9)
        drawn = torch.rand(24, 40, 3, generator=draw) * torch.tensor([0.8, 0.2, 1.0]) - torch.tensor([0.0, 0.0, 0.5])
        price, states = fused_rollout(dynamics, past, drawn, at, weights, codes)
        found[f"{label}.fused.price"] = price.double().numpy()
        found |= summarised(f"{label}.fused.states", states, keep=150)
        source = situation_terrain(at, len(drawn), encoder)
        trajectory = rollout(dynamics, spread_model_state(past, len(drawn)), drawn, source)
        found |= summarised(f"{label}.eager.states", trajectory.state, keep=150)
        terms = driving_terms(trajectory, drawn, at, weights)
        found[f"{label}.eager.terms"] = torch.stack(tuple(terms.values())).double().numpy()
        after = kernel_model_state(dynamics, past, drawn[0, :8], at, codes)
        found |= summarised(f"{label}.carry", torch.nan_to_num(to_kernel_state(after)), keep=60)
    return found


def carry_at(dynamics: Dynamics, state: torch.Tensor) -> ModelState:
    """After a fifth of a second at the same state."""
    present = torch.tensor([name in dynamics.vehicle.actuators for name in ACTUATORS])
    actuators = torch.where(present, torch.tensor([0.1, 0.05, 0.0, 1.5]), torch.nan)
    codes = dynamics.encoder.missing() if dynamics.encoder is not None else torch.zeros(0)
    flat = torch.tensor([0.0, 0.0, 1.0]).expand(1, 10, 4, 3)
    history = History(
        state.expand(1, 10, 6),
        actuators.expand(1, 10, 4),
        torch.tensor([0.3, 0.0, 0.05]).expand(1, 10, 3),
        replace(Terrain.of(flat), latent=codes.expand(1, 10, 4, -1)),
    )
    return dynamics.start(history, state[None], actuators[None])


NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
RIG_WORDS = re.compile(r'\[?[a-z_]+(?:\.\w+)+\]?|"[^"]*"')


def numbers(text: str) -> list[float]:
    return [float(found) for found in NUMBER.findall(text)]


def recorded_logs() -> Iterable[tuple[Path, str | None]]:
    """All recorded logs, without a rig and with the preset for them."""
    folder = recorded_data()
    assert folder is not None
    for path in sorted((folder / "tartandrive2" / "drives").iterdir()):
        yield from ((path, None), (path, "tartandrive2"))
    for path in sorted((folder / "bags").iterdir()):
        yield path, None
    for path in sorted((folder / "dart").glob("*/*.csv")):
        yield path, "dart_filtered" if "slippery" in path.parent.name else "dart"
    yield from ((path, None) for path in sorted((folder / "dart").glob("*/*.csv"))[:12:6])
    for path in sorted(folder.glob("kitti_raw/*/*_sync")):
        yield from ((path, None), (path, "kitti"))


def findings() -> Results:
    """Findings of `inspect` in every recorded log without their texts: severities, positions, numbers, rig lines."""
    found: Results = {}
    for path, rig in recorded_logs():
        label = f"{path.name}.{rig or 'no rig'}"
        preset = load_rig(rig) if rig else None
        try:
            clock = {"clock": preset.clock} if preset else {}
            log = open_log(path, **clock)
            inspection = inspect_log(log, preset, sensors=True)
        except OffpisteError as error:
            found[f"{label}.error"] = json.dumps(numbers(str(error).replace(str(path), "")))
            continue
        names = {row.name for row in inspection.topics}
        if preset is not None:
            names |= set(preset.channels) | set(preset.cameras) | set(preset.lidars)
        structure = sorted(
            [
                finding.severity,
                [part for part in finding.where.split(", ") if re.split(r"[\[.]", part)[0] in names],
                sorted(numbers(finding.evidence)),
                sorted(numbers(finding.remedy)),
                sorted(RIG_WORDS.findall(finding.remedy)),
            ]
            for finding in inspection.findings
        )
        found[f"{label}.findings"] = json.dumps(structure)
        found[f"{label}.scores"] = np.sort([finding.score for finding in inspection.findings])
        found[f"{label}.usable"] = str(inspection.usable)
        summary = [getattr(inspection.summary, f.name) for f in fields(inspection.summary)]
        found[f"{label}.summary"] = np.array(summary, float)
        rows = [[row.name, row.type, row.count] for row in inspection.topics]
        found[f"{label}.topics"] = json.dumps(rows)
        found[f"{label}.rates"] = np.array([[row.rate, row.seconds] for row in inspection.topics], float)
        if preset is None:
            with suppress(OffpisteError):
                found[f"{label}.draft"] = json.dumps(tomllib.loads(draft_rig(log)), sort_keys=True)
    return found


def training() -> Results:
    """Short trainings: weights in the order of registration, losses of every epoch, and what an evaluation finds."""
    made = dataset_with_features(TEMPORARY / "seen.zarr", rows=700)
    found: Results = {}
    quick = TrainConfig(epochs=2, bicycle_epochs=1, actuator_epochs=1, stride=20, batch=32, codes=3, seed=11)
    runs = []
    for name in ("b", "dc", "lstm"):
        folder = TEMPORARY / "runs" / name
        dynamics = train(made, replace(quick, model=name), folder)
        found |= trained(name, dynamics, folder)
        runs.append(folder)
    parts_of = [("dunes", "train"), ("ranch", "validation"), ("ranch-twin-1", "test")]
    split = write_drives(TEMPORARY / "real.txt", parts_of)
    logs = [path for path, _ in blind_drives() if path.stem != "flaws"]
    real = extract(logs, load_rig("proving_ground"), TEMPORARY / "real.zarr", split=split)
    for name in ("b", "kinematic"):
        folder = TEMPORARY / "runs" / f"real-{name}"
        found |= trained(f"real-{name}", train(real, replace(quick, model=name, epochs=1), folder), folder)
    loaded = [load_run(folder) for folder in runs[:2]]
    evaluation = evaluate_models(
        [EvaluatedModel(run.model, run.dynamics, seed=run.seed) for run in loaded],
        made,
        scale=loaded[0].scale,
        feature_sets=("hindsight", "20"),
        stride=20,
    )
    for case, errors in evaluation.errors.items():
        label = " ".join(map(str, msgspec.structs.astuple(case)))
        found |= parts(f"errors {label}", errors, keep=60)
    metrics = msgspec.to_builtins(evaluation.metrics)
    kept = {key: metrics[key] for key in metrics if key not in ("made", "dataset", "split", "bands")}
    found["evaluation"] = np.array(list(all_numbers(kept)), float)
    return found


def all_numbers(content: object) -> Iterable[float]:
    """In the order of a JSON document."""
    if isinstance(content, dict):
        for value in content.values():
            yield from all_numbers(value)
    elif isinstance(content, list | tuple):
        for value in content:
            yield from all_numbers(value)
    elif isinstance(content, int | float) and not isinstance(content, bool):
        yield float(content)


def trained(label: str, dynamics: Dynamics, folder: Path) -> Results:
    kept = []
    for tensor in [*dynamics.parameters(), *dynamics.buffers()]:
        kept += thinned(tensor.detach().double().numpy(), 6)
    found: Results = {f"{label}.weights": np.array(kept)}
    record = folder / "metrics.jsonl"
    lines = [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []
    found[f"{label}.losses"] = np.array([[line["train_loss"], line["validation_loss"]] for line in lines], float)
    found[f"{label}.stages"] = json.dumps([[line["stage"], line["epoch"]] for line in lines])
    found[f"{label}.scale"] = load_run(folder).scale.double().numpy()
    return found


def closed_loop() -> Results:
    """A drive of 2.4 s by the planner, in lockstep: controls, path, predictions, messages."""
    asked = CourseDriveSettings(
        WORLD,
        seconds=2.4,
        course=CourseSettings(speed=5.0, length=60.0, candidates=6),
        runtime=settings(),
    )
    out = TEMPORARY / "closed-loop"
    driven = drive_course(Planner("parametric", Path("nowhere"), parametric()), asked, out)
    found = messages("log", out / "drive.mcap")
    found |= summarised("controls", np.stack([c.command for c in driven.driving.controls]))
    found["modes"] = json.dumps([c.mode for c in driven.driving.controls])
    found |= parts("course", driven.chosen.course, keep=100)
    found["surprise"] = np.array(driven.chosen.surprise)
    found |= parts("trace", driven.trace, keep=100)
    for number, prediction in enumerate(driven.runtime.predictions[:6]):
        found |= parts(f"prediction.{number}", prediction, keep=60)
    return found


GROUPS: dict[str, Callable[[], Results]] = {
    "models": models,
    "simulated_log": simulated_log,
    "map_layers": map_layers,
    "dataset": dataset,
    "recorded_dataset": recorded_dataset,
    "plan": plan,
    "findings": findings,
    "training": training,
    "closed_loop": closed_loop,
}
RECORDED = ("recorded_dataset", "findings")
"""Groups that need recorded logs."""


STRICT = ("simulated_log", "closed_loop")
"""Groups whose hashes are of messages, and have to be the same on the machine that made them."""


def machine() -> dict[str, str]:
    """Hashes are only promised where this is the same."""
    info = Path("/proc/cpuinfo")
    lines = [line.partition(":") for line in (info.read_text().splitlines() if info.exists() else ())]
    described = {key.strip(): value.strip() for key, _, value in reversed(lines)}
    # A virtual machine's name says little: processors of one name compute with other instructions, and in other blocks.
    processor = [described.get(key, "") for key in ("model name", "cpu family", "model", "stepping", "cache size")]
    packages = ("numpy", "scipy", "torch", "mujoco", "embreex", "opencv-python-headless")
    return {
        "processor": " ".join(processor) if any(processor) else platform.processor(),
        "instructions": hashlib.sha256(described.get("flags", "").encode()).hexdigest()[:16],
        "OpenBLAS": os.environ.get("OPENBLAS_CORETYPE", "of the processor"),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def write(folder: Path, group: str, results: Results) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {key: value for key, value in results.items() if isinstance(value, np.ndarray)}
    texts = {key: value for key, value in results.items() if isinstance(value, str)}
    # One array for all of a type: an entry of its own for each would be mostly headers.
    kinds: dict[str, list[str]] = {}
    for key, value in arrays.items():
        kinds.setdefault("numbers" if value.dtype.kind == "f" else "whole", []).append(key)
    packed = {
        kind: np.concatenate([arrays[key].ravel().astype(float if kind == "numbers" else np.int64) for key in keys])
        for kind, keys in kinds.items()
    }
    np.savez_compressed(folder / f"{group}.npz", **packed)
    index = {kind: [[key, list(arrays[key].shape)] for key in keys] for kind, keys in kinds.items()}
    written = {"texts": texts, "arrays": index}
    (folder / f"{group}.json").write_text(json.dumps(written, separators=(",", ":")).replace('],["', '],\n["') + "\n")


def read(folder: Path, group: str) -> Results:
    index = json.loads((folder / f"{group}.json").read_text())
    results: Results = dict(index["texts"])
    with np.load(folder / f"{group}.npz") as packed:
        for kind, keys in index["arrays"].items():
            ends = np.cumsum([int(np.prod(shape)) for _, shape in keys])
            for (key, shape), values in zip(keys, np.split(packed[kind], ends[:-1]), strict=True):
                results[key] = values.reshape(shape)
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("groups", nargs="*", default=list(GROUPS))
    asked = parser.parse_args()
    for group in asked.groups:
        began = time.perf_counter()
        if group in RECORDED and recorded_data() is None:
            print(f"{group}: no recorded logs, left as it was")
            continue
        results = GROUPS[group]()
        write(asked.out, group, results)
        print(f"{group}: {len(results)} results in {time.perf_counter() - began:.1f} s", flush=True)
    if not {*STRICT} & {*asked.groups}:
        return  # the machine that is named made those
    asked.out.mkdir(parents=True, exist_ok=True)
    (asked.out / "machine.json").write_text(json.dumps(machine(), indent=1) + "\n")


if __name__ == "__main__":
    main()
