"""A drive of a bicycle with known constants, written as a table like any log: what the demo runs on.

The vehicle obeys the parametric model, on rolling ground and with unmodelled pushes; the log has sensor noise. It
stands in for a real drive until there is a proving ground.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from jaxtyping import Float

from offpiste.conventions import DT
from offpiste.dynamics import Parametric, Vehicle
from offpiste.files import write_whole
from offpiste.rig import load_rig
from offpiste.trajectory import Carry, Terrain


class Noise(NamedTuple):
    """Standard deviations.

    Attributes:
        push: unmodelled acceleration, correlated over half a second [m/s^2].
        position: [m].
        heading: [rad].
        actuator: of brake pressure; of the steering angle [rad] and engine speed [1000 rev/min] in proportion.
    """

    push: float = 0.15
    position: float = 0.01
    heading: float = 0.002
    actuator: float = 0.005


_NOISE = Noise()


def known_vehicle() -> Parametric:
    """The vehicle that is to be learned: the parametric model at its initial constants, some of them moved."""
    rig = load_rig("bicycle").vehicle
    everything = ("throttle", "brake", "steer"), ("brake", "steer", "steer_rate", "engine_rpm")
    return Parametric(Vehicle(rig.mass, rig.wheelbase, rig.max_steer, *everything)).requires_grad_(False)


def ground_height(xy: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " N"]:
    """Elevation [m]: rolling ground with slopes of up to about 10 degrees."""
    x, y = xy.T
    return 2.0 * np.sin(x / 23) * np.cos(y / 31) + 0.8 * np.sin(x / 11 + y / 17)


def ground_normal(xy: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 3"]:
    """Unit normals of the ground, by central differences of a centimetre."""
    step = 0.01
    dx, dy = np.array([[step, 0.0]]), np.array([[0.0, step]])
    slope_x = (ground_height(xy + dx) - ground_height(xy - dx)) / (2 * step)
    slope_y = (ground_height(xy + dy) - ground_height(xy - dy)) / (2 * step)
    normal = np.stack((-slope_x, -slope_y, np.ones_like(slope_x)), axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def simulate_drive(seconds: float, seed: int, noise: Noise = _NOISE) -> dict[str, Float[np.ndarray, " N"]]:
    """The columns of a log at 50 Hz, in the units of the rig `bicycle`."""
    rng = np.random.default_rng(seed)
    rows = round(seconds / DT)
    vehicle = known_vehicle()
    step = vehicle.stepper()
    wander = _wander(rows, rng)
    push = noise.push * _smooth_noise(rows, 3, 0.5, rng)

    carry = Carry(
        torch.tensor([[0.0, 0, 0, 3, 0, 0]]),
        torch.tensor([[0.0, 0, 0, 1.5]]),
        torch.zeros(1, vehicle.actuators.hidden),
        torch.zeros(1, vehicle.actuators.hidden),
    )
    states, actuators, controls = [], [], []
    with torch.no_grad():
        for row in range(rows):
            control = torch.tensor([_drive(wander[row], float(carry.state[0, 3]))], dtype=torch.float32)
            states.append(carry.state[0].numpy())
            actuators.append(carry.actuators[0].numpy())
            controls.append(control[0].numpy())
            normal = torch.as_tensor(ground_normal(carry.state[:, :2].numpy().astype(float)), dtype=torch.float32)
            terrain = Terrain(normal[:, None].expand(1, 4, 3), torch.zeros(1, 4, 0))
            carry = step(carry, control, terrain)
            carry.state[0, 3:] += DT * torch.as_tensor(push[row], dtype=torch.float32)
    return _log(np.array(states, float), np.array(actuators, float), np.array(controls, float), noise, rng)


def write_drive(path: Path, seconds: float, seed: int) -> None:
    """Simulate a drive and write it as a Parquet table."""
    table = pa.table(simulate_drive(seconds, seed))
    write_whole(path, lambda partial: pq.write_table(table, partial))


def _log(
    state: Float[np.ndarray, "N 6"],
    actuators: Float[np.ndarray, "N 4"],
    control: Float[np.ndarray, "N 3"],
    noise: Noise,
    rng: np.random.Generator,
) -> dict[str, Float[np.ndarray, " N"]]:
    def noisy(column: Float[np.ndarray, " N"], sigma: float) -> Float[np.ndarray, " N"]:
        return column + sigma * rng.standard_normal(len(column))

    return {
        "time": 1000.0 + DT * np.arange(len(state)),
        "x": noisy(state[:, 0], noise.position),
        "y": noisy(state[:, 1], noise.position),
        "z": noisy(ground_height(state[:, :2]), noise.position),
        "heading": np.degrees(noisy(state[:, 2], noise.heading)),
        "throttle": 100 * control[:, 0],
        "brake": 100 * control[:, 1],
        "steer": control[:, 2],
        "brake_pressure": noisy(actuators[:, 0], noise.actuator),
        "steer_angle": np.degrees(noisy(actuators[:, 1], 0.4 * noise.actuator)),
        "engine_rpm": 1000 * noisy(actuators[:, 3], 4 * noise.actuator),
    }


def _wander(rows: int, rng: np.random.Generator) -> Float[np.ndarray, "N 3"]:
    """What the driver has in mind: a speed [m/s], a steering command, and how hard to brake."""
    slow = _smooth_noise(rows, 3, 3.0, rng)
    speed = np.clip(6 + 3 * slow[:, 0], 0.5, 13)
    return np.column_stack((speed, np.clip(0.45 * slow[:, 1], -1, 1), 0.5 + 0.2 * slow[:, 2]))


def _drive(mind: Float[np.ndarray, " 3"], vx: float) -> tuple[float, float, float]:
    """Throttle, brake and steering towards what the driver has in mind; gentler steering at speed."""
    wanted, steer, brake = (float(v) for v in mind)
    lack = wanted - vx
    throttle = float(np.clip(0.3 + 0.25 * lack, 0, 1)) if lack > -1 else 0.0
    return throttle, float(np.clip(-brake * (lack + 1) / 2, 0, 1)), steer * min(1.0, 4 / max(vx, 1))


def _smooth_noise(rows: int, columns: int, seconds: float, rng: np.random.Generator) -> Float[np.ndarray, "N k"]:
    """First-order Gauss-Markov noise with unit variance and the given time constant."""
    keep = np.exp(-DT / seconds)
    fresh = rng.standard_normal((rows, columns)) * np.sqrt(1 - keep**2)
    value, out = rng.standard_normal(columns), np.empty((rows, columns))
    for row in range(rows):
        value = keep * value + fresh[row]
        out[row] = value
    return out
