"""Does it help to learn from the errors of the last seconds? Slow context on days, floors and loads that never trained.

Models are trained on some drives and predict others, as they are and with slow context (`dynamics.slow_context`):
real drives across days and floors, and the proving ground with another load and wet. Settings are the defaults
throughout. They were chosen with TartanDrive 2 in view, before any of the others was tried: that one is no test.
`python -m experiments.slow_context ../shared/data --out slow-context`
"""

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np
import torch
import tyro

from experiments.command import run
from experiments.control_experiments.models import trained_seeds
from experiments.surfaces.labels import extract_floors, held_out, recordings
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.splits import Split, write_drives
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics.slow_context import SHIFTED, ContextSettings
from offpiste.evaluation.context import errors_with_context
from offpiste.evaluation.errors import prediction_errors
from offpiste.evaluation.intervals import PairedDifference, Sampling, relative
from offpiste.files import write_text
from offpiste.progress import track
from offpiste.report.text_table import TextTable, number
from offpiste.reproduction.tables import percent
from offpiste.rig.rig import load_rig
from offpiste.simulation.recordings import Recording, simulate_all
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world.world import WorldSettings
from offpiste.training.config import TrainConfig
from offpiste.training.short_errors import short_errors

logger = logging.getLogger("experiments")

FLOORS: Final = ("tape and tiles", "rubbery floor", "slippery floor")
FIRST_SEED: Final = 12_500
"""First seed of the worlds, which nothing else uses."""

LOADED: Final = {"mass": 1.35, "com_height": 1.1, "front_share": 0.9, "pitch_inertia": 1.3, "yaw_inertia": 1.3}
"""A load of 400 kg over the rear axle: factors of the vehicle's parameters."""

WET: Final = 0.9
"""Mean wetness of a world after rain."""

ABOUT: Final = (
    "Distance after 5 s on drives that never trained, as the model is and with slow context at its default settings, "
    "the same windows; 95 % intervals over drives, blocks of 10 s and seeds. Worse: share of windows whose error grew."
)


@dataclass(frozen=True)
class Line:
    """A model on drives that never trained."""

    trained: str
    tested: str
    model: str
    windows: int
    error: float
    with_context: float
    difference: PairedDifference
    worse: float
    shifts: tuple[float, ...]


@dataclass(frozen=True)
class Study:
    """Slow context on days, floors and loads that never trained; trainings and drives that are there stay."""

    data: tyro.conf.Positional[Path]
    """Folder of the recorded data."""
    out: Path = Path("slow-context")
    """Folder of all outputs."""
    seeds: int = 3
    """Runs of each model."""
    models: tuple[str, ...] = ("parametric", "b")
    """Models with physical constants."""
    stride: int = 25
    """Rows between the windows that are tested."""
    parts: tuple[str, ...] = ("days", "floors", "loads")
    """Which comparisons are made."""
    context: ContextSettings = field(default_factory=ContextSettings)
    """Settings of the context."""
    train: TrainConfig = field(default_factory=TrainConfig)
    """Settings of all trainings."""
    floors_batch: int = 64
    """Batch on DART's floors, whose recordings are short."""

    def run(self) -> str:
        """Train, predict, and return the table."""
        cases: Mapping[str, Callable[[], list[tuple[str, str, Dataset, Dataset]]]] = {
            "days": self._days,
            "floors": self._floors,
            "loads": self._loads,
        }
        lines = [line for part in self.parts for case in cases[part]() for line in self._compare(*case)]
        text = table(lines).markdown()
        write_text(self.out / "slow-context.md", text)
        return text

    def _compare(self, trained: str, tested: str, learned_on: Dataset, dataset: Dataset) -> list[Line]:
        folder, lines = self.out / "runs" / re.sub(r"\W+", "-", trained), []
        train, windows = Windows(learned_on, "train"), Windows(dataset, "test")
        index = windows.every(self.stride)
        for model in self.models:
            before, after, shifts = [], [], []
            batch = self.floors_batch if trained in FLOORS else self.train.batch
            for one in trained_seeds(learned_on, replace(self.train, model=model, batch=batch), folder, self.seeds):
                noise = short_errors(one.dynamics, train, self.context).noise
                weights = torch.tensor(one.weights.in_order())
                before.append(
                    prediction_errors(
                        one.dynamics, windows, index, weights=weights, lookup="recorded", scale=one.scale
                    ).distance()
                )
                found, shift = errors_with_context(
                    one.dynamics,
                    windows,
                    index,
                    noise,
                    lookup="recorded",
                    scale=one.scale,
                    weights=weights,
                    settings=self.context,
                    track=track,
                )
                after.append(found.distance())
                shifts.append(shift.mean(axis=0))
            base, mine = np.array(before), np.array(after)
            lines.append(
                Line(
                    trained,
                    tested,
                    model,
                    len(index),
                    float(base.mean()),
                    float(mine.mean()),
                    relative(mine, base, Sampling().on(found)),
                    float((mine > base).mean()),
                    tuple(np.mean(shifts, axis=0)),
                )
            )
            logger.info(f"{trained} -> {tested}, {model}: {base.mean():.3f} m, with context {mine.mean():.3f} m")
        return lines

    def _days(self) -> list[tuple[str, str, Dataset, Dataset]]:
        drives = {}
        for name in ("turnpike", "down_meadows"):
            log = next((self.data / "tartandrive2" / "drives").glob(f"*{name}*"))
            drives[name] = make_dataset([log], load_rig("tartandrive2"), self.out / f"{name}.zarr", force=True)
        return [(a, b, drives[a], _all_tested(drives[b])) for a, b in (tuple(drives), tuple(drives)[::-1])]

    def _floors(self) -> list[tuple[str, str, Dataset, Dataset]]:
        dataset, floors = extract_floors(recordings(self.data / "dart"), self.out / "dart.zarr")
        cases = []
        for floor, name in enumerate(FLOORS):
            others = [drive for drive, own in floors.items() if own != floor]
            split = held_out(dataset, others)
            cases.append((name, "the other two floors", split, split))
        return cases

    def _loads(self) -> list[tuple[str, str, Dataset, Dataset]]:
        shipped = resources.files("offpiste.simulation")
        vehicle = changed((shipped / "vehicle/side_by_side.toml").read_text("utf-8"), LOADED)
        world = re.sub(
            r"(?m)^wetness *=.*", f"wetness = {WET}", (shipped / "world/presets/mojave.toml").read_text("utf-8")
        )
        write_text(self.out / "loaded.toml", vehicle)
        write_text(self.out / "wet.toml", world)
        usual, loaded, wet = "mojave", str(self.out / "loaded.toml"), str(self.out / "wet.toml")
        trained = self._driven("usual", usual, "", range(FIRST_SEED, FIRST_SEED + 8))
        tested = {
            "the same": (usual, ""),
            "loaded by 400 kg": (usual, loaded),
            "wet": (wet, ""),
            "loaded and wet": (wet, loaded),
        }
        seeds = range(FIRST_SEED + 8, FIRST_SEED + 14)
        return [
            ("proving ground", name, trained, _all_tested(self._driven(name, where, what, seeds)))
            for name, (where, what) in tested.items()
        ]

    def _driven(self, name: str, world: str, vehicle: str, seeds: range) -> Dataset:
        """Drives of 100 s without sensors, each in a world of its own; the last quarter of them validates."""
        folder = self.out / re.sub(r"\W+", "-", name)
        drives = [
            Recording(
                DriveSettings(WorldSettings(world, seed), 100.0, seed, "none", vehicle=vehicle), folder / f"{seed}.mcap"
            )
            for seed in seeds
        ]
        folder.mkdir(parents=True, exist_ok=True)
        simulate_all(drives, 1)
        parts = ["train"] * (3 * len(drives) // 4) + ["validation"] * (len(drives) - 3 * len(drives) // 4)
        split = write_drives(folder / "parts.txt", zip((drive.log.stem for drive in drives), parts, strict=True))
        logs = [drive.log for drive in drives]
        return make_dataset(logs, load_rig("proving_ground"), folder / "dataset.zarr", split=split, force=True)


def _all_tested(dataset: Dataset) -> Dataset:
    parts = tuple((drive.name, "test") for drive in dataset.drives)
    return dataset.relabelled(Split("drives:all", "drives", drives=parts))


def changed(text: str, factors: Mapping[str, float]) -> str:
    """A TOML text with some of its numbers multiplied.

    Raises:
        KeyError: there is no such number.
    """
    for name, factor in factors.items():
        found = re.search(rf"(?m)^{name} *= *([0-9.e+-]+)", text)
        if found is None:
            raise KeyError(name)
        text = text[: found.start(1)] + f"{float(found[1]) * factor:.6g}" + text[found.end(1) :]
    return text


def table(lines: Sequence[Line]) -> TextTable:
    """A line a model and a comparison."""
    rows = [
        (
            line.trained,
            line.tested,
            line.model,
            number(line.error),
            number(line.with_context),
            percent(line.difference),
            f"{100 * line.worse:.0f} %",
            f"{line.windows}",
            ", ".join(f"{name} {shift:+.2f}" for name, shift in zip(SHIFTED, line.shifts, strict=True)),
        )
        for line in lines
    ]
    names = (
        "trained on",
        "tested on",
        "model",
        "error [m]",
        "with context",
        "difference",
        "worse",
        "windows",
        "shifts",
    )
    return TextTable("Slow context", names, tuple(rows), ABOUT)


if __name__ == "__main__":
    run(Study)
