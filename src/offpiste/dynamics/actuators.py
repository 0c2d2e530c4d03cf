"""Delay models of brake, steering and engine: parametric lags, the first two with a learned residual.

Fitted before the terradynamics and frozen while those train (paper, section "Hybrid Vehicle Dynamics Model"). An
actuator that the log does not record has no model here: `offpiste.dynamics.inputs` gives its reduced form.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.conventions import DT
from offpiste.dynamics.bicycle import Elementary, Scalar
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.vehicle import Vehicle
from offpiste.state import History


class LagConstants(NamedTuple):
    """Constants of the lags.

    Attributes:
        brake_apply, brake_release: how fast pressure follows a rising and a falling command [1/s].
        steer_gain, steer_offset: road-wheel angle at rest = gain u + offset [rad].
        steer_frequency: natural frequency [rad/s].
        steer_damping: damping ratio.
        engine_rate: how fast the engine takes its speed [1/s].
        engine_idle: lowest engine speed [1000 rev/min].
        engine_throttle, engine_speed, engine_both: target = idle + t u_th + s |vx| + b u_th |vx| [1000 rev/min].
    """

    brake_apply: Scalar
    brake_release: Scalar
    steer_gain: Scalar
    steer_offset: Scalar
    steer_frequency: Scalar
    steer_damping: Scalar
    engine_rate: Scalar
    engine_idle: Scalar
    engine_throttle: Scalar
    engine_speed: Scalar
    engine_both: Scalar


def brake_rate(brake: Scalar, command: Scalar, c: LagConstants, f: Elementary) -> Scalar:
    """d(pressure)/dt [1/s]: a first-order lag, applying and releasing at their own speeds."""
    return c.brake_apply * f.maximum(command - brake, 0 * brake) - c.brake_release * f.maximum(
        brake - command, 0 * brake
    )


def steer_acceleration(steer: Scalar, steer_rate: Scalar, command: Scalar, c: LagConstants) -> Scalar:
    """d(steer_rate)/dt [rad/s^2]: a second-order lag behind the commanded angle."""
    wanted = c.steer_gain * command + c.steer_offset
    return c.steer_frequency * (c.steer_frequency * (wanted - steer) - 2 * c.steer_damping * steer_rate)


def engine_rate(engine: Scalar, throttle: Scalar, vx: Scalar, c: LagConstants, f: Elementary) -> Scalar:
    """d(engine speed)/dt [1000 rev/min/s]: follows what throttle and speed ask for."""
    speed = f.maximum(vx, -vx)
    target = c.engine_idle + c.engine_throttle * throttle + c.engine_speed * speed + c.engine_both * throttle * speed
    return c.engine_rate * (target - engine)


TORCH = Elementary(torch.sin, torch.cos, torch.tanh, torch.atan, torch.maximum)

_RANGES = {
    "brake_apply": (0.1, 40.0, 8.0),
    "brake_release": (0.1, 40.0, 8.0),
    "steer_gain": (0.0, 1.5, 0.5),
    "steer_offset": (-0.3, 0.3, 0.0),
    # Forward Euler at 0.02 s is stable for frequency < 2 damping / dt.
    "steer_frequency": (0.5, 20.0, 8.0),
    "steer_damping": (0.4, 1.5, 0.8),
    "engine_rate": (0.1, 40.0, 4.0),
    "engine_idle": (0.0, 3.0, 1.0),
    "engine_throttle": (-10.0, 10.0, 3.0),
    "engine_speed": (-1.0, 1.0, 0.1),
    "engine_both": (-1.0, 1.0, 0.0),
}


class Actuators(nn.Module):
    """The actuators that the log records, stepped together.

    Residuals are added to d(pressure)/dt [1/s] and to d(steer_rate)/dt [rad/s^2]; they see the actuator, its command
    and the forward speed. The engine has none: its speed is predicted from throttle and speed.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self.vehicle = vehicle
        low, high, initial = (torch.tensor(column) for column in zip(*_RANGES.values(), strict=True))
        self.low: Tensor
        self.width: Tensor
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("width", high - low, persistent=False)
        self.raw = nn.Parameter(torch.logit((initial - low) / (high - low)))
        self.residuals = nn.ModuleDict()
        if "brake" in vehicle.actuators and "brake" in vehicle.control:
            self.residuals["brake"] = Compensator(3, 1)
        if "steer" in vehicle.actuators and "steer" in vehicle.control:
            self.residuals["steer"] = Compensator(4, 1)

    @property
    def networks(self) -> dict[str, Compensator]:
        """The residual networks by actuator."""
        return {name: network for name, network in self.residuals.items() if isinstance(network, Compensator)}

    @property
    def hidden(self) -> int:
        """Width of the recurrent state of all residuals."""
        return sum(network.hidden for network in self.networks.values())

    def constants(self) -> LagConstants:
        """The lags' constants, each a scalar tensor inside its range."""
        return LagConstants(*(self.low + self.width * torch.sigmoid(self.raw)).unbind())

    def residual_inputs(
        self,
        actuators: Float[Tensor, "*B 4"],
        control: Float[Tensor, "*B 3"],
        vx: Float[Tensor, "*B"],
    ) -> dict[str, Float[Tensor, "*B I"]]:
        """What each residual network sees."""
        brake, steer, steer_rate, _ = actuators.unbind(-1)
        _, brake_command, steer_command = control.unbind(-1)
        seen = {"brake": (brake, brake_command, vx), "steer": (steer, steer_rate, steer_command, vx)}
        return {name: torch.stack(seen[name], dim=-1) for name in self.residuals}

    def start(self, history: History) -> tuple[Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """Recurrent state of the residuals after the history."""
        inputs = self.residual_inputs(history.actuators, history.control, history.state[..., 3])
        started = [self.networks[name].start(value) for name, value in inputs.items()]
        nothing = history.state.new_zeros(len(history.state), 0)
        return (
            torch.cat([nothing, *(hidden for hidden, _ in started)], dim=-1),
            torch.cat([nothing, *(cell for _, cell in started)], dim=-1),
        )

    def step(
        self,
        constants: LagConstants,
        actuators: Float[Tensor, "B 4"],
        control: Float[Tensor, "B 3"],
        vx: Float[Tensor, " B"],
        hidden: Float[Tensor, "B S"],
        cell: Float[Tensor, "B S"],
    ) -> tuple[Float[Tensor, "B 4"], Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """Forward Euler over `conventions.DT`; slots of absent actuators pass through unread."""
        if not self.vehicle.actuators:
            return actuators, hidden, cell
        brake, steer, steer_rate, engine = actuators.unbind(-1)
        throttle, brake_command, steer_command = control.unbind(-1)
        extra, hidden, cell = self._residuals(actuators, control, vx, hidden, cell)

        if "brake" in self.vehicle.actuators and "brake" in self.vehicle.control:
            brake = brake + DT * (brake_rate(brake, brake_command, constants, TORCH) + extra["brake"])
        if "steer" in self.vehicle.actuators and "steer" in self.vehicle.control:
            acceleration = steer_acceleration(steer, steer_rate, steer_command, constants) + extra["steer"]
            steer, steer_rate = steer + DT * steer_rate, steer_rate + DT * acceleration
        if "engine_rpm" in self.vehicle.actuators and "throttle" in self.vehicle.control:
            engine = engine + DT * engine_rate(engine, throttle, vx, constants, TORCH)
        return torch.stack((brake, steer, steer_rate, engine), dim=-1), hidden, cell

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
