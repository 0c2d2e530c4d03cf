"""Prediction errors of windows, and models with known errors."""

from collections.abc import Callable
from itertools import count

import numpy as np
from torch import Tensor

from factories import COMMANDED
from offpiste.core.state import ModelState
from offpiste.dynamics import Dynamics
from offpiste.evaluation.errors import Errors

ROW = np.arange(0, 10_000, 25)


def errors(distance: np.ndarray) -> Errors:
    values = np.repeat(np.repeat(distance[:, None, None], 5, axis=1), 5, axis=2)
    return Errors(np.zeros(len(distance), np.int64), ROW, values, distance**2)


BASE = errors(np.random.default_rng(0).uniform(1, 3, len(ROW)))


def changed(base: type[Dynamics], change: Callable[[Tensor, Tensor, int], Tensor]) -> Dynamics:
    """A model that reads the ground and whose states are `change(moved, before, step)` after each step, from 1 on."""

    class Changed(base):
        reads_terrain = True

        def stepper(self):
            move, steps = super().stepper(), count(1)

            def step(model_state, control, terrain):
                moved = move(model_state, control, terrain)
                state = change(moved.state, model_state.state, next(steps))
                return ModelState(state, moved.actuators, moved.recurrent)

            return step

    return Changed(COMMANDED)
