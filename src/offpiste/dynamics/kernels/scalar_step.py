"""One step of a model without its networks, as functions of plain scalars by their names in `layout`.

What the eager model does around the physics on batches (turning the normal, choosing measured inputs, forward Euler)
is written here once more for scalars; tests compare both.
"""

from offpiste.core.conventions import DT, STATE
from offpiste.dynamics import bicycle
from offpiste.dynamics.bicycle import Constants, DriveTrain, Elementary, Force, Scalar, forces, rates, reduced_inputs
from offpiste.dynamics.kernels import layout

Values = dict[str, Scalar]
"""Quantities by their names in `layout`."""


def drive_train(v: Values, f: Elementary) -> DriveTrain:
    """`torch_physics.drive_train` with switches; slots of absent actuators are 0."""

    def pick(switch: str, measured: Scalar, reduced: Scalar) -> Scalar:
        return v[switch] * measured + (1 - v[switch]) * reduced

    def command(name: str) -> Scalar:
        return v[layout.CONTROLS[layout.COMMANDS.index(name)]]

    reduced = reduced_inputs(command, v["vx"], v["max_steer"], f)
    measured = {
        name: pick(f"{name}_measured", v[actuator], getattr(reduced, name))
        for name, actuator in layout.MEASURED.items()
    }
    return reduced._replace(**measured)


def body_normal(v: Values, f: Elementary) -> tuple[Scalar, Scalar, Scalar]:
    """Return the mean normal in the body frame."""
    x, y, z = (v[name] for name in layout.NORMAL)
    return bicycle.body_normal(x, y, z, v["yaw"], f)


def sense(v: Values, f: Elementary) -> Values:
    """Return the computed inputs of the networks: the normal in the body frame and the parametric forces."""
    inputs, normal = drive_train(v, f), body_normal(v, f)
    constants = Constants(*(v[name] for name in Constants._fields))
    force = forces(v["vx"], v["vy"], v["yaw_rate"], inputs, normal[2], constants, f)
    return dict(zip(layout.BODY_NORMAL + layout.FORCE, (*normal, *force), strict=True))


def advance(v: Values, f: Elementary) -> Values:
    """Corrected forces to rates, actuators' lags, forward Euler."""
    normal = body_normal(v, f)
    constants = Constants(*(v[name] for name in Constants._fields))
    force = Force(*(v[name] + v[more] for name, more in zip(layout.FORCE, layout.CORRECTION, strict=True)))
    steer = drive_train(v, f).steer
    motion = rates(v["yaw"], v["vx"], v["vy"], v["yaw_rate"], steer, normal[0], normal[1], force, constants, f)
    return _forward_euler(v, dict(zip(STATE, motion, strict=True)) | _lag_rates(v, f))


def actuate(v: Values, f: Elementary) -> Values:
    """Actuators' lags alone, along a recorded speed, and forward Euler."""
    return _forward_euler(v, _lag_rates(v, f))


def _lag_rates(v: Values, f: Elementary) -> Values:
    change: Values = {}
    for one in layout.LAGGING:
        command = v[layout.CONTROLS[layout.COMMANDS.index(one.actuator.follows)]]
        own = {name: v[f"{one.label}_{name}"] for name in one.lag.constants}
        changes = list(one.lag.change(tuple(v[name] for name in one.columns), command, v["vx"], own, f))
        if one.lag.residual:
            changes[-1] += v[f"{one.label}_residual"]
        change |= {name: v[f"{one.label}_lags"] * rate for name, rate in zip(one.columns, changes, strict=True)}
    return change


def _forward_euler(v: Values, change: Values) -> Values:
    stepped = zip(layout.NEXT, layout.STEPPED, strict=True)
    return {after: v[name] + DT * change[name] for after, name in stepped if name in change}


def cell(v: Values, f: Elementary) -> Values:
    """One unit of an LSTM from its gates, in the order of `torch.nn.LSTMCell`."""

    def sigmoid(x: Scalar) -> Scalar:
        return (1 + f.tanh(x / 2)) / 2

    memory = sigmoid(v["forget_gate"]) * v["memory"] + sigmoid(v["input_gate"]) * f.tanh(v["cell_gate"])
    return {"next_hidden": sigmoid(v["output_gate"]) * f.tanh(memory), "next_memory": memory}
