"""Stages of a training that are the same for every model of one seed."""

from pathlib import Path

from offpiste.files import write_bytes

STAGES = ("actuators", "bicycle")
"""They know nothing of terrain features: what one model fitted serves all."""


def reuse_stages(runs: Path, folder: Path, seed: int) -> None:
    """Give a run the stages that a run of the same seed has fitted already; folders are called NAME-SEED.

    Args:
        runs: folder of all runs, of one dataset and with the same settings of these stages.
        folder: of the run.
    """
    for stage in STAGES:
        name = f"{stage}.safetensors"
        done = sorted(runs.glob(f"*-{seed}/{name}"))
        if done and not (folder / name).exists():
            write_bytes(folder / name, done[0].read_bytes())
