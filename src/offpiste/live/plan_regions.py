"""Where the vehicle will be with a probability while it follows a plan, for runs that have a spread."""

from typing import Final

import numpy as np
import torch
from jaxtyping import Float

from offpiste.core.state import Terrain
from offpiste.dynamics.base import Dynamics
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.controls import complete
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction, coded_area
from offpiste.uncertainty.spread import EVERY, INTERVAL, Moments, Spread, radius, spread_inputs

WITHIN: Final = 0.8
"""Probability with which the vehicle is within a region."""
_POINTS: Final = 24
"""Points of a region's outline."""


class PlanRegions:
    """Regions of plans: ellipses in the predicted heading, one for each second.

    Args:
        spread: of the model's predictions (`offpiste calibrate`).
        wheels: positions in the body frame [m].
    """

    def __init__(self, dynamics: Dynamics, spread: Spread, wheels: Float[np.ndarray, "4 2"]) -> None:
        self._dynamics, self._spread = dynamics.eval().requires_grad_(False), spread
        self._wheels = torch.as_tensor(wheels, dtype=torch.float32)

    @torch.no_grad()
    def outlines(
        self, layers: TerrainLayers, plan: TimedPlan, prediction: Prediction
    ) -> tuple[Float[np.ndarray, "_ 2"], ...]:
        """Closed lines x, y [m].

        Args:
            layers: of the map, with the model's codes as features.
        """
        offset = prediction.state[0, :2].copy()
        # The state before the first step is not handed over: the one after it stands for it.
        states = np.concatenate((prediction.state[:1], prediction.state[EVERY - 1 : -1 : EVERY]))
        moments = torch.as_tensor(states - np.concatenate((offset, np.zeros(4))), dtype=torch.float32)
        area = coded_area(layers, self._dynamics.encoder)
        under = area.terrain(torch.from_numpy(offset), self._wheels, len(moments)).at(0, moments)
        terrain = Terrain(under.normal[None], under.known[None], under.latent[None])
        control = complete(self._dynamics.vehicle, plan.controls[: len(prediction.state) : EVERY], plan.gear)
        inputs = spread_inputs(self._dynamics.vehicle, Moments(moments[None], control[None], terrain))
        axes = radius(WITHIN, float(self._spread.freedom)) * self._spread(inputs)[0].double().numpy()
        each = round(1 / INTERVAL)
        ends = prediction.state[EVERY - 1 :: EVERY][each - 1 :: each]
        return tuple(_ellipse(state, half) for state, half in zip(ends, axes[each - 1 :: each], strict=True))


def _ellipse(state: Float[np.ndarray, " 6"], half: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "P 2"]:
    """Outline around a state; half axes along and across its heading [m]."""
    angle = np.linspace(0, 2 * np.pi, _POINTS + 1)
    along, across = half[0] * np.cos(angle), half[1] * np.sin(angle)
    cos, sin = np.cos(state[2]), np.sin(state[2])
    return state[:2] + np.stack((cos * along - sin * across, sin * along + cos * across), axis=1)
