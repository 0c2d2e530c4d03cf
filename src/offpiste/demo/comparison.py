"""What both models predicted on the demo's drive, what happened, and how to say it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Float, Int

from offpiste.core.errors import DatasetError
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.model_card import driving_words, load_card
from offpiste.report.text_table import TextTable, interval, number
from offpiste.training.prediction import in_parts, roll_out
from offpiste.training.run import load_run

WHAT: Final = {"b": "b, does not see the ground", "dc": "dc, sees it"}
"""What the models are called in tables and pictures."""


@dataclass(frozen=True)
class Predictions:
    """Predictions of models from the same moments, on the map as it was.

    Attributes:
        row: of the drive at each moment.
        recorded: where the vehicle went in the next 5 s: x, y from its place at the start, in the world's axes [m].
        paths: where each model saw it go, likewise [m].
        folders: of the models.
    """

    row: Int[np.ndarray, " n"]
    recorded: Float[np.ndarray, "n T 2"]
    paths: Mapping[str, Float[np.ndarray, "n T 2"]]
    folders: Mapping[str, Path]

    def errors(self, model: str) -> Float[np.ndarray, " n"]:
        """Distance between prediction and record after 5 s [m]."""
        return np.asarray(np.linalg.norm(self.paths[model][:, -1] - self.recorded[:, -1], axis=1))


@torch.no_grad()
def predict(dataset: Dataset, folders: Mapping[str, Path]) -> Predictions:
    """Predictions of shipped models at every moment of which the dataset keeps the map.

    Raises:
        DatasetError: the drive ended before there was a moment to predict from.
    """
    try:
        windows = Windows(dataset, "test", start="causal")
        index = windows.evaluation_indices(1)
    except DatasetError as error:
        how = "take another world with --seed"
        raise DatasetError("the drive ended too early to predict 5 s", where=dataset.path, how=how) from error
    recorded: list[np.ndarray] = []
    paths: dict[str, np.ndarray] = {}
    for model, folder in folders.items():
        dynamics = load_run(folder).dynamics
        pieces = [roll_out(dynamics, windows, part, "map") for part in in_parts(index, windows, "map")]
        recorded = [batch.target[..., :2].numpy() for batch, _ in pieces]
        paths[model] = np.concatenate([trajectory.state[..., :2].numpy() for _, trajectory in pieces])
    return Predictions(windows.row_in_drive(index), np.concatenate(recorded), paths, folders)


def comparison_table(predictions: Predictions, results: Mapping[str, Mapping[str, Any]], speed: float) -> TextTable:
    """How both models predicted, and how they drove.

    Args:
        results: of the course, by model.
        speed: wanted along it [m/s].
    """
    models = tuple(results)
    rows = [("predicted place after 5 s, off by [m]", *(number(float(predictions.errors(m).mean())) for m in models))]
    for text, key, digits in (
        ("time for the course [s]", "time_s", 1),
        ("off the course, mean [m]", "mean_path_error_m", 2),
        ("off the course, at worst [m]", "worst_path_error_m", 2),
        (f"off the wanted {speed:g} m/s, mean [m/s]", "mean_speed_error_mps", 2),
    ):
        rows.append((text, *(number(float(results[m][key]), digits) for m in models)))
    rows.append(("end of the drive", *(ending(results[m]) for m in models)))
    return TextTable("This drive", ("", *(WHAT[model] for model in models)), tuple(rows))


def closing_words(predictions: Predictions) -> Iterator[str]:
    """What was gained here and what is usual, in sentences."""
    b, dc = (predictions.errors(model).mean() for model in ("b", "dc"))
    gain = 1 - dc / b
    nearer = "nearer to" if gain >= 0 else "farther from"
    yield (
        f"Here, from {len(predictions.row)} moments of the drive, dc's predictions end {abs(100 * gain):.0f} %"
        f" {nearer} where the vehicle then was: {dc:.2f} m off after 5 s instead of {b:.2f} m;"
        f" dc is nearer at {int((predictions.errors('dc') < predictions.errors('b')).sum())} of them."
    )
    card = load_card(predictions.folders["dc"])
    figures = card.over_seeds
    if figures.against_b is not None:
        low, high = (-100 * bound for bound in reversed(figures.against_b.ci95))
        yield (
            f"Usual is {-100 * figures.against_b.mean:.0f} % {interval((low, high), 0)} nearer (95 % interval):"
            f" {figures.windows} windows in {figures.levels.drives} worlds that no model had seen,"
            f" {figures.levels.seeds} training{'s' * (figures.levels.seeds > 1)} each."
            " A single drive may say otherwise."
        )
    if card.driving is not None:
        yield f"How dc drives: {driving_words(card.driving).replace('`', '')}"


def ending(result: Mapping[str, Any]) -> str:
    """How a drive along the course ended."""
    for key, text in (("rollover", "rolled over"), ("collision", "collided"), ("stuck", "stuck")):
        if result[key]:
            return text
    return (
        "reached the end" if result["finished"] else f"after {result['progress_m']:.0f} of {result['course_m']:.0f} m"
    )
