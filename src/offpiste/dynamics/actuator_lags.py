"""Delay models of actuators as functions of plain scalars, with elementary functions as arguments (see `bicycle`)."""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from offpiste.core.channels import ACTUATORS, Actuator, actuator_columns
from offpiste.dynamics.bicycle import Elementary, Scalar
from offpiste.dynamics.vehicle import Vehicle

Values = tuple[Scalar, ...]
"""Value of an actuator and, of a second-order lag, its rate."""

Constants = Mapping[str, Scalar]
"""Constants of one lag by name."""

Change = Callable[[Values, Scalar, Scalar, Constants, Elementary], Values]
"""Function from an actuator's values, its command, vx [m/s] and the lag's constants to d(values)/dt."""


class Lag(NamedTuple):
    """Delay model.

    Attributes:
        change: d(values)/dt.
        constants: lower bound, upper bound and initial value of each constant.
        residual: whether a network corrects the last derivative.
    """

    change: Change
    constants: Mapping[str, tuple[float, float, float]]
    residual: bool = False


def first_order(values: Values, command: Scalar, vx: Scalar, c: Constants, f: Elementary) -> Values:
    """Return the derivative of a first-order lag.

    Constants: rate [1/s].
    """
    (value,) = values
    return (c["rate"] * (command - value),)


def apply_release(values: Values, command: Scalar, vx: Scalar, c: Constants, f: Elementary) -> Values:
    """Return the derivative of a first-order lag with different rates for applying and releasing: brake pressure.

    Constants: apply, release [1/s].
    """
    (brake,) = values
    return (c["apply"] * f.maximum(command - brake, 0 * brake) - c["release"] * f.maximum(brake - command, 0 * brake),)


def second_order(values: Values, command: Scalar, vx: Scalar, c: Constants, f: Elementary) -> Values:
    """Return the derivatives of a second-order lag behind gain u + offset: the steering angle and its rate.

    Constants: gain, offset [rad], natural frequency [rad/s], damping ratio.
    """
    steer, rate = values
    wanted = c["gain"] * command + c["offset"]
    return rate, c["frequency"] * (c["frequency"] * (wanted - steer) - 2 * c["damping"] * rate)


def engine(values: Values, command: Scalar, vx: Scalar, c: Constants, f: Elementary) -> Values:
    """Return the derivative of the engine speed, a first-order lag behind idle + t u_th + s |vx| + b u_th |vx|.

    Constants: rate [1/s], idle [1000 rev/min], throttle (t), speed (s), both (b).
    """
    (revolutions,) = values
    speed = f.maximum(vx, -vx)
    target = c["idle"] + c["throttle"] * command + c["speed"] * speed + c["both"] * command * speed
    return (c["rate"] * (target - revolutions),)


LAGS: Final[dict[str, Lag]] = {
    "first-order": Lag(first_order, {"rate": (0.1, 40.0, 8.0)}),
    "apply-release": Lag(apply_release, {"apply": (0.1, 40.0, 8.0), "release": (0.1, 40.0, 8.0)}, residual=True),
    "second-order": Lag(
        second_order,
        {
            "gain": (0.0, 1.5, 0.5),
            "offset": (-0.3, 0.3, 0.0),
            # Forward Euler at 0.02 s is stable for frequency < 2 damping / dt.
            "frequency": (0.5, 20.0, 8.0),
            "damping": (0.4, 1.5, 0.8),
        },
        residual=True,
    ),
    "engine": Lag(
        engine,
        {
            "rate": (0.1, 40.0, 4.0),
            "idle": (0.0, 3.0, 1.0),
            "throttle": (-10.0, 10.0, 3.0),
            "speed": (-1.0, 1.0, 0.1),
            "both": (-1.0, 1.0, 0.0),
        },
    ),
}
"""Delay models by name (`offpiste.core.channels.Actuator.lag`); extensions may add their own."""


class Lagging(NamedTuple):
    """Actuator with its delay model.

    Attributes:
        columns: the actuator and, of a second-order lag, its rate.
    """

    actuator: Actuator
    columns: tuple[str, ...]
    lag: Lag

    @property
    def label(self) -> str:
        """Prefix of the names of its constants and networks."""
        return self.actuator.label

    def steps(self, vehicle: Vehicle) -> bool:
        """Return whether the vehicle's log has both the actuator and the command that it follows."""
        return self.actuator.name in vehicle.actuators and self.actuator.follows in vehicle.control


def lagging(actuators: tuple[Actuator, ...] = ACTUATORS) -> tuple[Lagging, ...]:
    """Return the actuators that lag behind a command, in order, each with its rate."""
    return tuple(
        Lagging(one, (one.name, *(rate.name for rate in actuators if rate.rate_of == one.name)), LAGS[one.lag])
        for one in actuators
        if not one.rate_of
    )


def lagging_of(vehicle: Vehicle) -> tuple[Lagging, ...]:
    """Return `lagging` of the columns of a vehicle's datasets."""
    return lagging(actuator_columns(vehicle.actuators))
