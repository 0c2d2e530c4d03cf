"""Prediction errors of windows with a given distance."""

import numpy as np

from offpiste.evaluation.errors import Errors

ROW = np.arange(0, 10_000, 25)


def errors(distance: np.ndarray) -> Errors:
    values = np.repeat(np.repeat(distance[:, None, None], 5, axis=1), 5, axis=2)
    return Errors(np.zeros(len(distance), np.int64), ROW, values, distance**2)


BASE = errors(np.random.default_rng(0).uniform(1, 3, len(ROW)))
