"""The whole path on a small generated drive: log, inspect, extract, train, evaluate."""

from collections.abc import Callable
from pathlib import Path

from offpiste.dataset.make import make_dataset
from offpiste.experiments.bicycle_drive import write_drive
from offpiste.experiments.judge_runs import judge_runs
from offpiste.logs import open_log
from offpiste.logs.checks import inspect_log, render
from offpiste.rig import load_rig
from offpiste.training.config import TrainConfig
from offpiste.training.train import train


def run_demo(out: Path, *, seconds: float, epochs: int, seed: int, tell: Callable[[object], None]) -> None:
    """Make everything in `out`; what is there already from an earlier demo with the same settings is used again.

    Raises:
        OffpisteError: as the stages do; e.g. `out` holds runs of other settings.
    """
    rig, log, dataset_path = load_rig("bicycle"), out / f"drive_{seed}.parquet", out / "dataset.zarr"
    tell(f"1/5  A drive of {seconds:g} s, generated from a bicycle with known constants (no real vehicle): {log}")
    if not log.exists():
        write_drive(log, seconds, seed)
    tell(f"2/5  offpiste inspect {log} --rig bicycle")
    tell(render(inspect_log(open_log(log, clock_column=rig.clock.column), rig)))
    tell(f"3/5  offpiste extract {log} --rig bicycle --out {dataset_path}")
    dataset = make_dataset([log], rig, dataset_path, tell=tell)
    runs = []
    for model in ("b", "parametric"):
        tell(f"4/5  offpiste train {dataset_path} --model {model} --out {out / model}")
        half = max(1, epochs // 2)
        config = TrainConfig(model=model, epochs=epochs, bicycle_epochs=half, actuator_epochs=half, seed=seed)
        train(dataset, config, out / model, resume=(out / model / "config.json").exists(), tell=tell)
        runs.append(out / model)
    tell(f"5/5  offpiste evaluate {' '.join(map(str, runs))} --dataset {dataset_path} --out {out / 'report'}")
    judge_runs(runs, dataset_path, out / "report", tell=tell)
    tell("The truth here is a bicycle, so `b` can hardly beat `parametric`; on a real drive it does (docs/results.md).")
