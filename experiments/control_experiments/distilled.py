"""Distillation: an encoder learns, from far views of a cell, the code that another one makes of it in hindsight.

The mean square error makes it the expected code given what is seen from there; views that tell nothing give the mean.
"""

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from jaxtyping import Bool, Float16
from torch.nn import functional

from experiments.control_experiments.reproduced import Reproduced
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.training.run import Run

STEPS: Final = 6000
BATCH: Final = 2048
PEAK: Final = 2e-3
"""Learning rate of Adam."""


def distilled(of: Reproduced, runs: Path, seed: int) -> Run:
    """The reproduction's `cf` of a seed with an encoder that is taught by its own; it is made anew each time."""
    run = of.runs("cf")[seed]
    encoder = run.dynamics.encoder
    assert encoder is not None
    teach(encoder, *views(of.dataset, len(encoder.mean)), seed)
    return replace(run, folder=runs / f"distilled-{seed}")


def views(dataset: Dataset, read: int) -> tuple[Float16[np.ndarray, "D M F"], Bool[np.ndarray, "D M"]]:
    """The first `read` features of the cells of all drives that train, and whether they are valid, by feature set.

    Cells that hindsight does not know are left out.
    """
    train = PARTS.index("train")
    cells = [drive.rows.cells for drive in dataset.drives if (drive.part == train).all()]
    known = [(each, each.valid[0]) for each in cells if each is not None]
    features = [np.asarray(each.features)[:, there, :read] for each, there in known]
    return np.concatenate(features, axis=1), np.concatenate([each.valid[:, there] for each, there in known], axis=1)


def teach(
    encoder: FeatureEncoder,
    features: Float16[np.ndarray, "D M F"],
    valid: Bool[np.ndarray, "D M"],
    seed: int,
    *,
    steps: int = STEPS,
) -> None:
    """Fit an encoder to its own codes in hindsight, from views of all distances, missing ones too."""
    rng = np.random.default_rng(seed)
    teacher = deepcopy(encoder).requires_grad_(False)
    optimiser = torch.optim.Adam(encoder.parameters(), lr=PEAK)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    sets, cells = valid.shape
    for _ in range(steps):
        cell, view = rng.integers(0, cells, BATCH), rng.integers(0, sets, BATCH)
        there = torch.from_numpy(valid[view, cell])
        seen, hindsight = (
            torch.from_numpy(features[at, cell].astype(np.float32)) for at in (view, np.zeros_like(view))
        )
        wanted = teacher(hindsight, torch.ones_like(there))
        optimiser.zero_grad()
        functional.mse_loss(encoder(seen, there), wanted).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
