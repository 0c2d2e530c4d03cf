"""Delay models of the actuators that a log records: parametric lags, some with a learned residual.

Fitted before the terradynamics and frozen while those train (paper, section "Hybrid Vehicle Dynamics Model"). An
actuator that the log does not record has no model here: `offpiste.dynamics.inputs` gives its reduced form.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.core.conventions import DT
from offpiste.core.state import History, ModelState
from offpiste.dynamics.actuator_lags import Constants, lagging_of
from offpiste.dynamics.bicycle import Elementary
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.vehicle import Vehicle

TORCH = Elementary(torch.sin, torch.cos, torch.tanh, torch.atan, torch.maximum)

LagConstants = dict[str, Constants]
"""Constants of all lags, by the actuator's label."""


class Actuators(nn.Module):
    """The actuators that the log records, stepped together.

    Residuals are added to the last derivative of a lag, such as d(pressure)/dt [1/s] and d(steer_rate)/dt [rad/s^2];
    they see the actuator, its command and the forward speed.
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
        """The residual networks by the actuator's label."""
        return {name: network for name, network in self.residuals.items() if isinstance(network, Compensator)}

    @property
    def hidden(self) -> int:
        """Width of the recurrent state of all residuals."""
        return sum(network.hidden for network in self.networks.values())

    def flat_constants(self) -> Float[Tensor, " K"]:
        """The lags' constants inside their ranges, in the order of the table of channels."""
        return self.low + self.width * torch.sigmoid(self.raw)

    def constants(self) -> LagConstants:
        """The lags' constants, each a scalar tensor inside its range."""
        result: dict[str, dict[str, Tensor]] = {}
        for (label, name), value in zip(self.constant_names, self.flat_constants().unbind(), strict=True):
            result.setdefault(label, {})[name] = value
        return dict(result)

    def residual_inputs(
        self,
        actuators: Float[Tensor, "*B A"],
        control: Float[Tensor, "*B U"],
        vx: Float[Tensor, "*B"],
    ) -> dict[str, Float[Tensor, "*B I"]]:
        """What each residual network sees: the actuator and its rate, its command, the forward speed."""
        measured = dict(zip(self._columns, actuators.unbind(-1), strict=True))
        commands = dict(zip(self._controls, control.unbind(-1), strict=True))
        return {
            one.label: torch.stack(
                (*(measured[name] for name in one.columns), commands[one.actuator.follows], vx), dim=-1
            )
            for one in self._stepped
            if one.lag.residual
        }

    def start(self, history: History) -> tuple[Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """Recurrent state of the residuals after the history."""
        inputs = self.residual_inputs(history.actuators, history.control, history.state[..., 3])
        started = [self.networks[name].start(value) for name, value in inputs.items()]
        nothing = history.state[:, 0, :0]  # len() would fix the batch of a traced graph
        return (
            torch.cat([nothing, *(hidden for hidden, _ in started)], dim=-1),
            torch.cat([nothing, *(cell for _, cell in started)], dim=-1),
        )

    def step(
        self,
        constants: LagConstants,
        actuators: Float[Tensor, "B A"],
        control: Float[Tensor, "B U"],
        vx: Float[Tensor, " B"],
        hidden: Float[Tensor, "B S"],
        cell: Float[Tensor, "B S"],
    ) -> tuple[Float[Tensor, "B A"], Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """Forward Euler over `conventions.DT`; slots of absent actuators pass through unread."""
        if not self._stepped:
            return actuators, hidden, cell
        measured = dict(zip(self._columns, actuators.unbind(-1), strict=True))
        commands = dict(zip(self._controls, control.unbind(-1), strict=True))
        extra, hidden, cell = self._residuals(actuators, control, vx, hidden, cell)
        for one in self._stepped:
            values = tuple(measured[name] for name in one.columns)
            changes = list(one.lag.change(values, commands[one.actuator.follows], vx, constants[one.label], TORCH))
            if one.lag.residual:
                changes[-1] = changes[-1] + extra[one.label]
            measured |= {
                name: value + DT * change for name, value, change in zip(one.columns, values, changes, strict=True)
            }
        return torch.stack([measured[name] for name in self._columns], dim=-1), hidden, cell

    def rollout(
        self,
        start: Float[Tensor, "B A"],
        hidden: Float[Tensor, "B S"],
        cell: Float[Tensor, "B S"],
        controls: Float[Tensor, "B T U"],
        speed: Float[Tensor, "B T"],
    ) -> Float[Tensor, "B T A"]:
        """The actuators after each step, along a forward speed that is given.

        Args:
            start: the actuators before the first step.
            hidden, cell: from `start`.
            controls, speed: during each step.
        """
        constants, state, predicted = self.constants(), start, []
        for control, vx in zip(controls.unbind(1), speed.unbind(1), strict=True):
            state, hidden, cell = self.step(constants, state, control, vx, hidden, cell)
            predicted.append(state)
        return torch.stack(predicted, dim=1)

    def advance(
        self,
        constants: LagConstants,
        model_state: ModelState,
        control: Float[Tensor, "B U"],
        state: Float[Tensor, "B 6"],
        hidden: Float[Tensor, "B H"],
        cell: Float[Tensor, "B H"],
    ) -> ModelState:
        """The model state one step later, of a model that keeps the actuators' recurrent state behind its own.

        Args:
            state, hidden, cell: of the model itself, one step later.
        """
        own = hidden.shape[-1]
        actuators, hidden_lags, cell_lags = self.step(
            constants,
            model_state.actuators,
            control,
            model_state.state[:, 3],
            model_state.hidden[:, own:],
            model_state.cell[:, own:],
        )
        return ModelState(state, actuators, torch.cat((hidden, hidden_lags), -1), torch.cat((cell, cell_lags), -1))

    def _residuals(
        self, actuators: Tensor, control: Tensor, vx: Tensor, hidden: Tensor, cell: Tensor
    ) -> tuple[dict[str, Tensor], Tensor, Tensor]:
        if not self.residuals:
            return {}, hidden, cell
        networks = self.networks
        sizes = [network.hidden for network in networks.values()]
        extra, hiddens, cells = {}, [], []
        inputs = self.residual_inputs(actuators, control, vx)
        for name, h, c in zip(networks, hidden.split(sizes, -1), cell.split(sizes, -1), strict=True):
            out, next_h, next_c = networks[name](inputs[name], h, c)
            extra[name] = out[..., 0]
            hiddens.append(next_h)
            cells.append(next_c)
        return extra, torch.cat(hiddens, dim=-1), torch.cat(cells, dim=-1)
