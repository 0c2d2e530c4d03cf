"""Small vehicles, windows, logs, rigs, maps and datasets that tests of several stages share."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from offpiste.core.conventions import ACTUATORS, CONTROL, DT
from offpiste.core.state import History, RecordedTerrain, Terrain
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import Split, parse_split
from offpiste.dataset.store import Dataset, StoredDrive, add_drive, create, open_dataset
from offpiste.dynamics import Hybrid, Vehicle
from offpiste.dynamics.feature_encoder import Identity
from offpiste.logs.log import Log, Samples, Topic
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.rig.rig import Rig, parse_rig

torch.set_num_threads(1)
"""Tensors here are small: threads cost more than they bring."""


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Let torch and kernels use `count` threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def drawn(*shape: int, seed: int = 0) -> Tensor:
    """Normal numbers in float64, which depend on shape and seed alone."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


VEHICLE = Vehicle(mass=800.0, wheelbase=2.2, max_steer=0.4, control=CONTROL, actuators=ACTUATORS, features=2)
"""A vehicle whose log has everything."""

COMMANDED = replace(VEHICLE, actuators=())
"""Vehicle whose log has commands only."""


def coded(vehicle: Vehicle, codes: int) -> Hybrid:
    """A hybrid with fixed weights that reads codes of this length; 0 for none.

    Its inputs are not standardised: with other weights it may saturate, so that no input has an effect.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return Hybrid(vehicle, encoder=Identity(codes - 1) if codes else None)


def unsettled(module: nn.Module, *, scale: float = 0.2) -> nn.Module:
    """The module with every parameter moved, so that no output layer is zero any more."""
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += scale * torch.randn(parameter.shape, generator=generator, dtype=parameter.dtype)
    return module


class _Run(nn.Module):
    def __init__(self, module: nn.Module, run: Callable) -> None:
        super().__init__()
        self.module, self.run = module, run

    def forward(self) -> Tensor:
        return self.run(self.module)


def gradients_agree(module: nn.Module, run: Callable) -> bool:
    """Return whether the gradients of `run(module)` equal finite differences along random directions."""
    names, values = zip(*((n, p.detach().clone()) for n, p in module.named_parameters()), strict=True)

    def call(*parameters: Tensor) -> Tensor:
        by_name = {f"module.{name}": value for name, value in zip(names, parameters, strict=True)}
        return torch.func.functional_call(_Run(module, run), by_name, ())

    return torch.autograd.gradcheck(call, [value.requires_grad_() for value in values], fast_mode=True)


def ground(slope_x: Tensor, slope_y: Tensor, codes: int = 0) -> Terrain:
    """Planes z = slope_x x + slope_y y; slopes are [..., 4], one per wheel."""
    normal = nn.functional.normalize(torch.stack((-slope_x, -slope_y, torch.ones_like(slope_x)), dim=-1), dim=-1)
    return replace(Terrain.of(normal), latent=normal.new_ones(*slope_x.shape, codes))


def flat(batch: int, steps: int, dtype: torch.dtype = torch.float64) -> Terrain:
    zeros = torch.zeros(batch, steps, 4, dtype=dtype)
    return ground(zeros, zeros)


class Situation:
    """Random but plausible windows: a past, a start, commands and ground, in float64."""

    def __init__(self, batch: int = 3, steps: int = 8, *, codes: int = 0, seed: int = 0) -> None:
        generator = torch.Generator().manual_seed(seed)

        def draw(low: list[float], high: list[float], *shape: int) -> Tensor:
            lowest, highest = torch.tensor(low, dtype=torch.float64), torch.tensor(high, dtype=torch.float64)
            return lowest + (highest - lowest) * torch.rand(*shape, len(low), generator=generator, dtype=torch.float64)

        def states(*shape: int) -> Tensor:
            return draw([-50, -50, -3, 1.5, -1, -0.5], [50, 50, 3, 10, 1, 0.5], *shape)

        def actuators(*shape: int) -> Tensor:
            return draw([0.05, -0.4, -1, 1], [1, 0.4, 1, 4], *shape)

        def controls(*shape: int) -> Tensor:
            return draw([0, 0, -1], [1, 1, 1], *shape)

        def terrain(*shape: int) -> Terrain:
            planes = ground(*draw([-0.2, -0.2], [0.2, 0.2], *shape, 4).unbind(-1))
            latent = draw([-1.0] * codes, [1.0] * codes, *shape, 4)
            normal = planes.normal.where(torch.rand(*shape, 4, 1, generator=generator) > 0.2, torch.nan)
            return replace(Terrain.of(normal), latent=latent)

        self.history = History(states(batch, 10), actuators(batch, 10), controls(batch, 10), terrain(batch, 10))
        self.state, self.actuators = states(batch), actuators(batch)
        self.controls, self.source = controls(batch, steps), RecordedTerrain(terrain(batch, steps))

    def mapped(self, change: Callable[[Tensor], Tensor]) -> "Situation":
        """Return a copy with every tensor changed, e.g. to another type or to one row."""
        other, past = copy(self), self.history

        def changed(terrain: Terrain) -> Terrain:
            known = change(terrain.known.to(terrain.normal.dtype)) > 0.5
            return Terrain(change(terrain.normal), known, change(terrain.latent))

        other.history = History(change(past.state), change(past.actuators), change(past.control), changed(past.terrain))
        other.state, other.actuators, other.controls = map(change, (self.state, self.actuators, self.controls))
        other.source = RecordedTerrain(changed(self.source.terrain))
        return other

    def filled(self, vehicle: Vehicle, value: float) -> "Situation":
        """Return a copy with `value` for channels that the vehicle's log lacks."""

        def fill(values: Tensor, names: tuple[str, ...], present: tuple[str, ...]) -> Tensor:
            absent = torch.tensor([name not in present for name in names])
            return torch.where(absent, torch.tensor(value, dtype=values.dtype), values)

        other = copy(self)
        other.history = replace(
            self.history,
            actuators=fill(self.history.actuators, ACTUATORS, vehicle.actuators),
            control=fill(self.history.control, CONTROL, vehicle.control),
        )
        other.actuators = fill(self.actuators, ACTUATORS, vehicle.actuators)
        other.controls = fill(self.controls, CONTROL, vehicle.control)
        return other


HEAD = """
name = "small"
absent = ["brake_pressure", "steer_angle", "steer_rate", "engine_rpm"]
[vehicle]
mass = 800.0
max_steer = 0.4
pose_point = "the rear axle"
wheel_positions = [[2.2, 0.6], [2.2, -0.6], [0.0, 0.6], [0.0, -0.6]]
"""
WITHOUT_COMMANDS = HEAD.replace("absent = [", 'absent = ["throttle", "brake", "steer", ')
RIG = f"""{HEAD}
[channels.position]
topic = "odometry"
fields = ["x", "y", "z"]
[channels.orientation]
topic = "odometry"
fields = ["qx", "qy", "qz", "qw"]
[channels.throttle]
topic = "pedals"
fields = ["throttle"]
[channels.brake]
topic = "pedals"
fields = ["brake"]
[channels.steer]
topic = "steering"
fields = ["steer"]
"""


def small_rig(more: str = "") -> Rig:
    """A rig that reads `MemoryLog`s; `more` is TOML to append."""
    return parse_rig(RIG + more, where="small.toml")


def tilted_map(
    rise: tuple[float, float], shape: tuple[int, int], origin: tuple[float, float], resolution: float
) -> TerrainMap:
    """The plane z = rise[0] x + rise[1] y; feature 0 is the number of a cell's column, feature 1 that of its row."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(float)
    z = rise[0] * (origin[0] + resolution * column) + rise[1] * (origin[1] + resolution * row)
    return TerrainMap(np.array(origin), resolution, z, np.stack((column, row), axis=-1).astype(np.float32))


class MemoryLog(Log):
    """Topics given as (stamps, columns by field)."""

    has_clock_unit = True

    def __init__(self, **topics: tuple[np.ndarray, dict[str, np.ndarray]]) -> None:
        self.path, self.data = Path("in-memory"), topics

    @property
    def topics(self) -> dict[str, Topic]:
        return {name: Topic(name, "memory", len(time), tuple(f)) for name, (time, f) in self.data.items()}

    def _read(self, topic: Topic, fields: list[str], stamps: str) -> Samples:
        time, columns = self.data[topic.name]
        return Samples(time, np.column_stack([columns[field] for field in fields]))


def small_log(time: np.ndarray, **columns: np.ndarray) -> MemoryLog:
    """A log for `small_rig` at these stamps: at rest in the origin, without commands, but for the given columns."""
    topics = {
        "odometry": ("x", "y", "z", "qx", "qy", "qz", "qw"),
        "pedals": ("throttle", "brake"),
        "steering": ("steer",),
    }
    columns = {"qw": np.ones(len(time))} | columns
    named = {topic: {name: columns.get(name, 0 * time) for name in names} for topic, names in topics.items()}
    return MemoryLog(**{topic: (time, values) for topic, values in named.items()})


def circle_rows(rows: int, *, speed: float = 5.0, yaw_rate: float = 0.5, seed: int = 0) -> Rows:
    """A drive round a circle, with random commands and no recorded actuators."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(rows)
    yaw = yaw_rate * time
    place = speed / yaw_rate * np.stack((np.sin(yaw), 1 - np.cos(yaw)), axis=1)
    state = np.column_stack((place, yaw, np.full(rows, speed), np.zeros(rows), np.full(rows, yaw_rate)))
    normal = np.zeros((1, rows, 4, 3), dtype=np.float32)
    normal[..., 2] = 1
    known = (state + rng.normal(0, 0.01, state.shape)).astype(np.float32)
    actuators = np.full((rows, 4), np.nan, dtype=np.float32)
    control = rng.uniform((0, 0, -1), 1, (rows, 3)).astype(np.float32)
    return Rows(
        time=time,
        origin=np.array([100.0, -50.0]),
        state=state.astype(np.float32),
        state_causal=known,
        actuators=actuators,
        actuators_causal=actuators.copy(),
        control=control,
        control_causal=control.copy(),
        normal=normal,
        normal_causal=normal[0, :, 0].copy(),
        valid=np.ones(rows, dtype=bool),
    )


def stored_dataset(
    path: Path,
    drives: Mapping[str, Rows],
    split: str | Split,
    features: tuple[str, ...] = (),
    *,
    rig: Rig | None = None,
    **more: object,
) -> Dataset:
    """A dataset in a folder; `more` are arguments of `add_drive` for each of the drives."""
    split = parse_split(split) if isinstance(split, str) else split
    create(path, rig or small_rig(), split, features)
    for name, rows in drives.items():
        add_drive(path, name, rows, split, **{"notes": (), **more})
    return open_dataset(path)


def circle_dataset(path: Path, rows: Rows, split: str = "blocks:0.4,0.3,0.3") -> Dataset:
    """A dataset of one drive, without features."""
    return stored_dataset(path, {"circle": rows}, split)


def dataset_in_memory(drives: Mapping[str, Rows], split: str | Split) -> Dataset:
    """A dataset without a folder."""
    split = parse_split(split) if isinstance(split, str) else split
    stored = (StoredDrive(name, rows, split.label(name, rows.world_xy), ()) for name, rows in drives.items())
    return Dataset(Path("memory"), small_rig(), split, tuple(stored))
