"""Plans by pytorch_mppi with the same model, cost and map, through `as_callable`: so that planners are compared, too.

The package's own smooth variant (`KMPPI`) samples control points that a kernel interpolates; white noise at 50 Hz, as
of its `MPPI`, hardly moves a vehicle. Model and cost are stepped in torch: a plan takes seconds, and as the drive is in
lockstep, no drive depends on it. Risks of the plans are left out, since it calls costs step by step without them.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import DT
from offpiste.dynamics.base import Dynamics, as_callable
from offpiste.errors import NoPlan, OffpisteError, is_installed
from offpiste.planning import mppi
from offpiste.planning.driving_cost import Situation, terms_after
from offpiste.planning.pedal import complete, controls_of, pedals_of
from offpiste.planning.rollouts import situation_terrain
from offpiste.runtime.prediction import Area
from offpiste.runtime.settings import RuntimeSettings
from offpiste.state import ModelState

SPACING = 0.25
"""Time between control points [s]; the kernel's width is that, too."""


def check_installed() -> None:
    """Check that the package is there, before anything is driven.

    Raises:
        OffpisteError: it is not.
    """
    if not is_installed("pytorch_mppi"):
        raise OffpisteError(
            "pytorch_mppi is not installed", where="--planners", how="pip install pytorch-mppi, or leave it out"
        )


class PytorchMppi:
    """Improves plans of pedal and steering by pytorch_mppi (a `plan_improvement.Improver`).

    Args:
        settings: samples, iterations, temperature, noise and bounds are those of its `sampling`.
        seed: of the sampled controls.
    """

    def __init__(self, dynamics: Dynamics, settings: RuntimeSettings, seed: int) -> None:
        self._dynamics, self._settings = dynamics, settings
        self._random = torch.Generator().manual_seed(seed).get_state()

    def improve(self, controls: Float[Tensor, "T 3"], model_state: ModelState, area: Area, at: Situation) -> mppi.Plan:
        """A plan of pedal and steering, from one of throttle, brake and steering.

        Raises:
            NoPlan: a cost is not finite: it weighs samples by all costs.
        """
        sampling, before = self._settings.sampling, pedals_of(controls)
        first = torch.cat((model_state.pack()[0], at.state[3:5], at.control, at.control))
        planner = self._planner(before, len(first), area, at)
        with torch.random.fork_rng([]):  # it draws from torch's own generator
            torch.set_rng_state(self._random)
            for _ in range(sampling.iterations):
                planner.command(first, shift_nominal_trajectory=False)
            self._random = torch.get_rng_state()
        if not planner.cost_total.isfinite().all():
            raise NoPlan("a sample of pytorch_mppi has a cost that is not finite")
        plan = mppi.limited(planner.U[None], sampling, pedals_of(at.control))[0]
        return mppi.Plan(plan, planner.cost_total, planner.omega)

    def _planner(self, before: Float[Tensor, "T 2"], size: int, area: Area, at: Situation):  # type: ignore[no-untyped-def]
        from pytorch_mppi.mppi import KMPPI, RBFKernel

        sampling, limits, steps = self._settings.sampling, self._settings.sampling.limits, SPACING / DT
        dynamics, cost = stepwise(self._dynamics, area, at, self._settings, sampling.samples)
        planner = KMPPI(
            dynamics, cost, size, torch.diag(before.new_tensor(sampling.deviation).square()),
            num_samples=sampling.samples, horizon=len(before), lambda_=sampling.temperature,
            u_min=before.new_tensor(limits.low), u_max=before.new_tensor(limits.high), U_init=before,
            num_support_pts=round(len(before) / steps) + 1, kernel=RBFKernel(steps),
        )  # fmt: skip
        # It charges samples for their distance from 0, too, which offpiste's planner does not.
        planner._compute_action_cost = torch.zeros_like
        planner.theta = before[planner.Tk[0].round().long()]
        return planner


def stepwise(dynamics: Dynamics, area: Area, at: Situation, settings: RuntimeSettings, samples: int):  # type: ignore[no-untyped-def]
    """Dynamics and running cost for planners that call them step by step.

    Their state is the packed model state with the velocity and the control before the step, and its control.
    """
    step = as_callable(dynamics, situation_terrain(dynamics, at, samples, area.encode))

    def after(state: Tensor, pedal_and_steer: Tensor) -> Tensor:
        control = controls_of(pedal_and_steer)
        given = complete(dynamics.vehicle, control, at.gear)
        return torch.cat((step(state[:, :-8], given, 0), state[:, 3:5], state[:, -3:], control), dim=1)

    def cost(state: Tensor, _: Tensor) -> Tensor:
        terms = terms_after(state[:, :6], state[:, -8:-6], state[:, -3:], state[:, -6:-3], at, settings.weights)
        return DT * torch.stack(tuple(terms.values())).sum(dim=0)

    return after, cost
