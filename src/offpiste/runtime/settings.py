"""Settings of the run time."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from offpiste.core.conventions import DT, PERCEPTION_LATENCY
from offpiste.core.errors import PlanningError
from offpiste.mapping.replay import MapperSettings
from offpiste.planning import mppi
from offpiste.planning.caution import AsPredicted, Risk
from offpiste.planning.controls import PEDAL_LIMITS, Limits
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.rig.outputs import CommandLimits, Timeouts
from offpiste.runtime.backing_out import BackingOutSettings

_SAMPLING: Final = mppi.Settings(
    PEDAL_LIMITS, (0.15, 0.15), samples=512, temperature=3.0, iterations=2,
    wide=0.3, fresh=0.1, fresh_width=5.0, rest=(0.4, 0.0),
)  # fmt: skip
"""Settings of MPPI for pedal and steer."""


@dataclass(frozen=True)
class RuntimeSettings:
    """Settings; raises `PlanningError` if latency or 1 / plan_rate is out of range or no multiple of `DT`."""

    plan_rate: float = 10.0  # plans per second [Hz]
    latency: float = PERCEPTION_LATENCY  # from the data of a plan to its first control [s]; a multiple of `DT`
    sampling: mppi.Settings = _SAMPLING
    weights: CostWeights = field(default_factory=lambda: CostWeights(path=5.0, slide=3.0))
    hazards: Hazards = field(default_factory=Hazards)
    risk: Risk = field(default_factory=AsPredicted)  # treatment of the spread of predictions in the costs
    replay: MapperSettings = field(default_factory=MapperSettings)  # of the map, as in the model's dataset
    timeouts: Timeouts = field(default_factory=Timeouts)  # ages of inputs at which the mode changes
    backing_out: BackingOutSettings = field(default_factory=BackingOutSettings)  # for models with a gear
    speed: float | None = None  # speed limit of plans [m/s]; None for no limit
    slow: float = 3.0  # speed limit while scans are late [m/s]
    stop: float = 0.5  # brake of a controlled stop [0..1]
    forget: float = 1.0  # age since its start from which a plan is no longer continued [s]
    gear: float = 1.0  # engaged at the start; 1 forward, -1 reverse
    standstill: float = 0.3  # speed below which the vehicle counts as standing [m/s]
    arrived: float = 2.0  # distance from its end at which the course is finished [m]
    margin: float = 8.0  # margin around the part of the map that a plan can reach [m]
    remember: float = 600.0  # duration for which predictions are kept, at 120 kB/s [s]
    device: str = "cpu"  # of encoder and planning, or "cuda" (extra `cuda`); not of the feature extractor

    def __post_init__(self) -> None:
        if not 0 <= self.latency <= 1 or not _is_steps(self.latency):
            raise PlanningError(f"invalid latency of {self.latency:g} s", how=f"give a multiple of {DT} from 0 to 1")
        longest = self.timeouts.plan
        if not self.plan_rate > 0 or not _is_steps(1 / self.plan_rate) or 1 / self.plan_rate > longest:
            how = f"choose 1 / plan_rate as a multiple of {DT} s, at most {longest:g} s (timeouts.plan)"
            raise PlanningError(f"invalid plan rate of {self.plan_rate:g} Hz", how=how)

    def highest_speed(self, *, slow: bool) -> float:
        """Return the speed limit of plans [m/s]."""
        limit = np.inf if self.speed is None else self.speed
        return min(limit, self.slow) if slow else limit


def keeping_to(settings: RuntimeSettings, limits: CommandLimits) -> RuntimeSettings:
    """Return settings whose plans respect the limits of commands.

    The rate of the pedal is limited to that of the brake: a throttle slower than planned only delays the vehicle, but
    a brake slower than planned does not stop it in time.
    """
    planned = settings.sampling.limits
    pedal, steer = planned.rate or (np.inf, np.inf)
    within = Limits(
        low=(max(planned.low[0], -limits.brake), max(planned.low[1], -limits.steer)),
        high=(min(planned.high[0], limits.throttle), min(planned.high[1], limits.steer)),
        rate=(min(pedal, limits.brake_rate), min(steer, limits.steer_rate)),
    )
    speed = min(settings.highest_speed(slow=False), limits.speed)
    sampling = replace(settings.sampling, limits=within)
    return replace(settings, sampling=sampling, speed=speed if np.isfinite(speed) else None)


def _is_steps(seconds: float) -> bool:
    return abs(seconds / DT - round(seconds / DT)) < 1e-6
