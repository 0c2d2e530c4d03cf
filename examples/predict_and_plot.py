"""Predict what a vehicle did in the test part of a dataset, and plot it against what happened.

python examples/predict_and_plot.py runs/b dataset.zarr
"""

import argparse

import numpy as np
import torch
from matplotlib import pyplot as plt

import offpiste


def predict_windows(run_folder: str, dataset_folder: str, count: int = 64) -> tuple[torch.Tensor, torch.Tensor]:
    """Predicted and recorded states of windows across the test part [B, 250, 6], relative to each window's start."""
    run = offpiste.load(run_folder)
    windows = offpiste.Windows(offpiste.open_dataset(dataset_folder), "test")
    chosen = np.linspace(0, len(windows) - 1, min(count, len(windows))).astype(int)
    return offpiste.predict(run, windows[chosen]).state, windows.gather(chosen).target


def draw(predicted: torch.Tensor, recorded: torch.Tensor, out: str) -> None:
    """Paths from above, and the error of the position over time."""
    figure, (above, error) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    for path, driven in zip(predicted[:12], recorded[:12], strict=True):
        above.plot(*driven[:, :2].T, color="black", linewidth=2, alpha=0.3)
        above.plot(*path[:, :2].T, color="tab:orange")
    above.set(title="12 windows: predicted on driven (grey)", xlabel="x [m]", ylabel="y [m]", aspect="equal")
    time = 0.02 * torch.arange(1, predicted.shape[1] + 1)
    away = torch.linalg.vector_norm(predicted[..., :2] - recorded[..., :2], dim=-1)
    error.plot(time, away.T, color="tab:orange", alpha=0.15)
    error.plot(time, away.median(dim=0).values, color="tab:red", label="median")
    error.set(title=f"position error of {len(away)} windows", xlabel="time [s]", ylabel="error [m]")
    error.legend()
    figure.savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", help="a folder that `offpiste train` wrote")
    parser.add_argument("dataset", help="what `offpiste extract` wrote")
    parser.add_argument("--out", default="predictions.png")
    given = parser.parse_args()
    predicted, recorded = predict_windows(given.run, given.dataset)
    draw(predicted, recorded, given.out)
    last = torch.linalg.vector_norm(predicted[:, -1, :2] - recorded[:, -1, :2], dim=-1)
    print(f"{given.out}: {len(last)} windows, {last.median():.2f} m off after 5 s in the median")
