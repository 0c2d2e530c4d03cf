"""Prediction errors of windows, and models with known errors."""

from collections.abc import Callable
from itertools import count

import numpy as np
from torch import Tensor

from factories import COMMANDED
from offpiste.core.state import ModelState
from offpiste.dynamics import Dynamics
from offpiste.evaluation.errors import Errors


def errors(distance: np.ndarray, *, drives: int = 1, every: int = 25) -> Errors:
    """Windows of drives, some rows apart; all errors of a window are alike, and the loss is their square."""
    each = len(distance) // drives
    values = np.tile(distance[:, None, None], (5, 5))
    return Errors(np.repeat(np.arange(drives), each), np.tile(every * np.arange(each), drives), values, distance**2)


BASE = errors(np.random.default_rng(0).uniform(1, 3, 400))


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
