"""The whole path on the proving ground: simulate, inspect, extract, train, evaluate."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from offpiste.dataset.make import make_dataset
from offpiste.experiments.judge_runs import judge_runs
from offpiste.experiments.recorded import simulate_once
from offpiste.files import write_text
from offpiste.logs import open_log
from offpiste.logs.checks import inspect_log, render
from offpiste.rig import load_rig
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world import WorldSettings
from offpiste.training.config import TrainConfig
from offpiste.training.train import train

PARTS = ("train", "train", "train", "train", "validation", "test", "test")
"""Of the drives, each in a world of its own."""

MODELS = ("df", "b", "parametric")


@dataclass(frozen=True)
class DemoSettings:
    """How much is simulated and trained.

    Attributes:
        seconds: of each drive.
        epochs: passes over the training windows.
        seed: of everything.
        size, resolution: of the worlds [m].
    """

    seconds: float = 120.0
    epochs: int = 8
    seed: int = 0
    size: float = 320.0
    resolution: float = 0.25


def run_demo(out: Path, settings: DemoSettings, *, tell: Callable[[object], None]) -> None:
    """Make everything in `out`; what is there already from an earlier demo with the same settings is used again.

    Raises:
        OffpisteError: as the stages do; e.g. `out` holds runs of other settings.
    """
    rig = load_rig("proving_ground")
    logs = [out / "logs" / f"mojave-{settings.seed + number}.mcap" for number in range(len(PARTS))]
    tell(f"1/5  offpiste simulate: {len(logs)} drives of {settings.seconds:g} s (no real vehicle), without cameras")
    for number, log in enumerate(logs):
        world = WorldSettings(seed=settings.seed + number, size=settings.size, resolution=settings.resolution)
        simulate_once(DriveSettings(world, settings.seconds, seed=number, sensors="none"), log, tell=tell)
    tell(f"2/5  offpiste inspect {logs[0]} --rig proving_ground")
    tell(render(inspect_log(open_log(logs[0]), rig)))
    parts, dataset_path = out / "parts.txt", out / "dataset.zarr"
    tell(f"3/5  offpiste extract … --rig proving_ground --features ground-truth --split drives:{parts}")
    write_text(parts, "".join(f"{log.stem} {part}\n" for log, part in zip(logs, PARTS, strict=True)))
    dataset = make_dataset(logs, rig, dataset_path, split=f"drives:{parts}", features="ground-truth", tell=tell)
    runs = []
    for model in MODELS:
        tell(f"4/5  offpiste train {dataset_path} --model {model} --out {out / model}")
        config = TrainConfig(
            model=model,
            epochs=settings.epochs,
            bicycle_epochs=settings.epochs,
            actuator_epochs=max(1, settings.epochs // 2),
            seed=settings.seed,
        )
        train(dataset, config, out / model, resume=(out / model / "config.json").exists(), tell=tell)
        runs.append(out / model)
    tell(f"5/5  offpiste evaluate {' '.join(map(str, runs))} --dataset {dataset_path} --out {out / 'report'}")
    judge_runs(runs, dataset_path, out / "report", tell=tell)
    tell(
        "`df` is an oracle here: it is told the true friction and resistance under each wheel, where cameras will have"
        " to guess. `map` is what a planner can do: the ground is read where the prediction goes, not the drive."
    )
