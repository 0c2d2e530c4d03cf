"""One plan improved by MPPI, on the CPU or on a GPU, from what the run time knows at that moment."""

from collections.abc import Callable
from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.state import ModelState
from offpiste.dynamics.base import Dynamics
from offpiste.planning import mppi
from offpiste.planning.device_planner import DevicePlanner
from offpiste.planning.driving_cost import Situation
from offpiste.planning.gpu import check_planner, gpu_planner, require_device
from offpiste.planning.pedal import pedals_of, with_pedal
from offpiste.runtime.prediction import Area, costs_from
from offpiste.runtime.settings import RuntimeSettings

CPU = torch.device("cpu")


class Improver(Protocol):
    """What improves plans of pedal and steering."""

    def improve(self, controls: Float[Tensor, "T 3"], model_state: ModelState, area: Area, at: Situation) -> mppi.Plan:
        """A plan of pedal and steering, from one of throttle, brake and steering.

        Raises:
            NoPlan: none can be made this time.
        """


MakeImprover = Callable[[Dynamics, RuntimeSettings, int], Improver]
"""Makes what improves plans, for a model, settings and a seed of the sampled controls."""


class PlanImprover:
    """Improves plans of pedal and steering.

    Args:
        seed: of the sampled controls.

    Raises:
        PlanningError: there is no such GPU, or no kernels can step the model there.
    """

    def __init__(self, dynamics: Dynamics, settings: RuntimeSettings, seed: int) -> None:
        self._dynamics, self._settings, self._seed = dynamics, settings, seed
        self._generator = torch.Generator().manual_seed(seed)
        self._on_gpu: DevicePlanner | None = None
        require_device(settings.device, dynamics)

    def improve(self, controls: Float[Tensor, "T 3"], model_state: ModelState, area: Area, at: Situation) -> mppi.Plan:
        """A plan of pedal and steering, from one of throttle, brake and steering.

        Raises:
            NoPlan: no sample has a finite cost.
            PlanningError: the GPU computes something else than the CPU.
        """
        settings, before, previous = self._settings, pedals_of(controls), pedals_of(at.control)
        if settings.device == "cpu":
            cost_of = with_pedal(costs_from(self._dynamics, model_state, area, at, settings.weights))
            return mppi.improve(before, cost_of, settings.sampling, self._generator, previous=previous)
        if self._on_gpu is None:
            planner = gpu_planner(self._dynamics, settings.sampling, at, settings.device, self._seed)
            check_planner(planner, before, model_state, at, settings.weights, area.codes)
            self._on_gpu = planner
        return self._on_gpu.improve(before, model_state, at, settings.weights, area.codes, previous=previous)
