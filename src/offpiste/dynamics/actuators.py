"""Delay models of the recorded actuators on batches: parametric lags, some with a learned residual.

They are fitted before the terradynamics and then frozen (paper, section "Hybrid Vehicle Dynamics Model"). Actuators
that are not recorded have a reduced form instead (`offpiste.dynamics.bicycle.reduced_inputs`).
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.core.conventions import DT
from offpiste.core.state import History
from offpiste.dynamics.actuator_lags import Constants, lagging_of
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.torch_physics import TORCH
from offpiste.dynamics.vehicle import Vehicle

LagConstants = dict[str, Constants]
"""Constants of all lags by the actuator's label."""


class Actuators(nn.Module):
    """Delay models of all recorded actuators.

    Residuals are added to the last derivative of a lag, such as d(pressure)/dt [1/s] and d(steer_rate)/dt [rad/s^2].
    They read the actuator, its command and the forward speed.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self.vehicle = vehicle
        self._columns, self._controls = vehicle.actuator_columns, vehicle.control_columns
        every = lagging_of(vehicle)
        self._stepped = [one for one in every if one.steps(vehicle)]
        self.constant_names = [(one.label, name) for one in every for name in one.lag.constants]
        ranges = [bounds for one in every for bounds in one.lag.constants.values()]
        low, high, initial = (torch.tensor(column) for column in zip(*ranges, strict=True))
        self.low: Tensor
        self.width: Tensor
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("width", high - low, persistent=False)
        self.raw = nn.Parameter(torch.logit((initial - low) / (high - low)))
        self.residuals = nn.ModuleDict()
        for one in self._stepped:
            if one.lag.residual:
                self.residuals[one.label] = Compensator(len(one.columns) + 2, 1)

    @property
    def networks(self) -> dict[str, Compensator]:
        """Residual networks by the actuator's label."""
        return {name: network for name, network in self.residuals.items() if isinstance(network, Compensator)}

    @property
    def recurrent_size(self) -> int:
        """Length of the recurrent states of all residuals."""
        return sum(network.state_size for network in self.networks.values())

    def flat_constants(self) -> Float[Tensor, " K"]:
        """Return the lags' constants inside their ranges, in the order of `constant_names`."""
        return self.low + self.width * torch.sigmoid(self.raw)

    def constants(self) -> LagConstants:
        """Return the lags' constants, each a scalar tensor inside its range."""
        result: dict[str, dict[str, Tensor]] = {}
        for (label, name), value in zip(self.constant_names, self.flat_constants().unbind(), strict=True):
            result.setdefault(label, {})[name] = value
        return dict(result)

    def residual_inputs(
        self, actuators: Float[Tensor, "*B A"], control: Float[Tensor, "*B U"], vx: Float[Tensor, "*B"]
    ) -> dict[str, Float[Tensor, "*B I"]]:
        """Return the inputs of each residual network: the actuator and its rate, its command, the forward speed."""
        measured = dict(zip(self._columns, actuators.unbind(-1), strict=True))
        commands = dict(zip(self._controls, control.unbind(-1), strict=True))
        return {
            one.label: torch.stack(
                (*(measured[name] for name in one.columns), commands[one.actuator.follows], vx), dim=-1
            )
            for one in self._stepped
            if one.lag.residual
        }

    def start(self, history: History) -> Float[Tensor, "B R"]:
        """Return the recurrent state of the residuals after the history."""
        inputs = self.residual_inputs(history.actuators, history.control, history.state[..., 3])
        nothing = history.state[:, 0, :0]  # len() would fix the batch size of a traced graph
        return torch.cat([nothing, *(self.networks[name].start(value) for name, value in inputs.items())], dim=-1)

    def step(
        self,
        constants: LagConstants,
        actuators: Float[Tensor, "B A"],
        control: Float[Tensor, "B U"],
        vx: Float[Tensor, " B"],
        recurrent: Float[Tensor, "B R"],
    ) -> tuple[Float[Tensor, "B A"], Float[Tensor, "B R"]]:
        """Return actuators and recurrent state after a step of forward Euler; absent actuators are neither read nor
        changed.
        """
        if not self._stepped:
            return actuators, recurrent
        measured = dict(zip(self._columns, actuators.unbind(-1), strict=True))
        commands = dict(zip(self._controls, control.unbind(-1), strict=True))
        residuals, recurrent = self._residuals(actuators, control, vx, recurrent)
        for one in self._stepped:
            values = tuple(measured[name] for name in one.columns)
            changes = list(one.lag.change(values, commands[one.actuator.follows], vx, constants[one.label], TORCH))
            if one.lag.residual:
                changes[-1] = changes[-1] + residuals[one.label]
            measured |= {
                name: value + DT * change for name, value, change in zip(one.columns, values, changes, strict=True)
            }
        return torch.stack([measured[name] for name in self._columns], dim=-1), recurrent

    def rollout(
        self,
        start: Float[Tensor, "B A"],
        recurrent: Float[Tensor, "B R"],
        controls: Float[Tensor, "B T U"],
        speed: Float[Tensor, "B T"],
    ) -> Float[Tensor, "B T A"]:
        """Return the actuators after each step, along a given forward speed.

        Args:
            start: actuators before the first step.
            recurrent: from `start`.
            controls, speed: during each step.
        """
        constants, state, predicted = self.constants(), start, []
        for control, vx in zip(controls.unbind(1), speed.unbind(1), strict=True):
            state, recurrent = self.step(constants, state, control, vx, recurrent)
            predicted.append(state)
        return torch.stack(predicted, dim=1)

    def _residuals(
        self, actuators: Tensor, control: Tensor, vx: Tensor, recurrent: Tensor
    ) -> tuple[dict[str, Tensor], Tensor]:
        residuals, after, networks = {}, [recurrent[:, :0]], self.networks
        inputs = self.residual_inputs(actuators, control, vx)
        before = recurrent.split([network.state_size for network in networks.values()], dim=-1) if networks else ()
        for (name, network), state in zip(networks.items(), before, strict=True):
            residual, state = network(inputs[name], state)
            residuals[name] = residual[..., 0]
            after.append(state)
        return residuals, torch.cat(after, dim=-1)
