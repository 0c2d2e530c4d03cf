"""Planning on an NVIDIA GPU (extra `cuda`), checked against the CPU before the first plan."""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.errors import PlanningError, extra
from offpiste.core.state import ModelState
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.kernels.autograd import supports
from offpiste.dynamics.kernels.coverage import uncovered
from offpiste.native.cuda_kernels import cuda_kernels
from offpiste.planning import mppi
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.device_planner import HOW, TOLERANCE, DevicePlanner, bounds_of, captured, model_controls
from offpiste.planning.driving_cost import Situation
from offpiste.planning.header.cost_text import plan_text
from offpiste.planning.header.costs import costs_by_kernels
from offpiste.planning.kernel import Codes, fused_costs

CHECKED: Final = 64
"""Number of samples for the comparison."""


def gpu_planner(
    dynamics: Dynamics, settings: mppi.Settings, situation: Situation, device: str, seed: int
) -> DevicePlanner:
    """Return a planner on a GPU.

    Args:
        situation: example of the situations to come, with their cost layers and caution.

    Raises:
        MissingExtra: cuda-core is not installed.
        PlanningError: there is no such GPU.
    """
    place = gpu_of(device)
    kernels = cuda_kernels(plan_text(dynamics, situation.costs.table, situation.caution, lanes=True), place)
    return DevicePlanner(kernels, dynamics, settings, torch.Generator(place).manual_seed(seed), captured)


def require_device(name: str, dynamics: Dynamics) -> None:
    """Check early that a device can plan with a model.

    Raises:
        PlanningError: there is no such GPU, or the kernels do not support the model.
        MissingExtra: cuda-core is not installed.
    """
    if name == "cpu":
        return
    gpu_of(name)
    with extra("cuda"):
        import cuda.core  # noqa: F401
    with torch.no_grad():
        if not supports(dynamics, torch.device("cpu"), torch.float32):
            reason = uncovered(dynamics) or "it is not in float32, or differs from its kernels"
            raise PlanningError(f"no kernels for this model on a GPU: {reason}", how="plan on the CPU: device='cpu'")


def gpu_of(name: str) -> torch.device:
    """Return the GPU of a name.

    Raises:
        PlanningError: there is no such GPU.
    """
    try:
        place = torch.device(name)
    except RuntimeError:
        place = torch.device("cpu")
    if place.type != "cuda" or not (place.index or 0) < torch.cuda.device_count():
        raise PlanningError(f"no GPU '{name}' for planning", how="plan on the CPU, or install torch for CUDA")
    return place


def check_planner(
    planner: DevicePlanner,
    plan: Float[Tensor, "T U"],
    model_state: ModelState,
    situation: Situation,
    weights: CostWeights,
    codes: Codes,
) -> None:
    """Compare limits and costs of samples around a plan with the CPU's.

    Raises:
        PlanningError: they differ.
    """
    settings, dynamics, device = planner.settings, planner.dynamics, planner.device
    draws = mppi.sample(plan, settings, torch.Generator().manual_seed(0))[:: max(settings.samples // CHECKED, 1)]
    sampled = mppi.limited(draws, settings)
    _check_limits(planner, draws, sampled)
    controls = model_controls(sampled).contiguous()
    wanted = fused_costs(dynamics, model_state, situation, weights, codes)(controls)
    there = ModelState(*(part.to(device) for part in vars(model_state).values()))
    cost_of = costs_by_kernels(planner.kernels, dynamics, there, situation, weights, codes)
    found = cost_of(controls.to(device)).cpu()
    finite = wanted.isfinite()
    difference = float(
        ((found - wanted).abs() / wanted.abs().clamp(min=1e-6))[finite].median()
    )  # NaN if none is finite
    if not torch.equal(found.isfinite(), finite) or not difference < TOLERANCE:
        what = f"costs on {device} differ from those on the CPU, by {difference:.1e} in the median"
        raise PlanningError(what, how=HOW)


def _check_limits(planner: DevicePlanner, draws: Float[Tensor, "K T U"], limited: Float[Tensor, "K T U"]) -> None:
    """Compare the bounds and rates of the kernel with `mppi.limited`."""
    samples, steps, count = draws.shape
    by_step = draws.permute(1, 2, 0).contiguous().to(planner.device)
    bounds = bounds_of(planner.settings, None).to(planner.device)
    planner.kernels.launch("offpiste_keep_within", count * samples, by_step, bounds, count, steps)
    difference = float((by_step.permute(2, 0, 1).cpu() - limited).abs().max())
    if not difference < TOLERANCE:
        what = f"limits of controls on {planner.device} differ from those on the CPU, by {difference:.1e}"
        raise PlanningError(what, how=HOW)
