"""Small worlds and short drives for tests of the vehicle."""

from dataclasses import replace

import numpy as np

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.world import Bushes, Trees, WorldSettings
from synthetic_drive import bare_world

PLAIN = (0.6, 6.0, 0.05, 0.02)
"""Friction, cornering stiffness, rolling resistance, sinkage drag."""


def flat_world(
    *, properties=PLAIN, slope=0.0, side_slope=0.0, size=(240.0, 120.0), resolution=1.0, trees=(), bushes=(), bumps=None
):
    """A plane with its centre at the origin, of one ground.

    slope, side_slope: dz/dx and dz/dy; trees: (x, y, trunk radius); bushes: (x, y, radius, drag); bumps: z(x) to add.
    """
    nx, ny = (round(length / resolution) + 1 for length in size)
    x = np.arange(nx) * resolution - size[0] / 2
    y = np.arange(ny)[:, None] * resolution - size[1] / 2
    elevation = slope * x + side_slope * y + (0.0 if bumps is None else bumps(x))
    kinds = np.zeros((len(GROUND_KINDS), ny, nx))
    kinds[2] = 1
    trees, bushes = np.array(trees, float).reshape(-1, 3), np.array(bushes, float).reshape(-1, 4)
    return bare_world(
        elevation,
        (-size[0] / 2, -size[1] / 2),
        float(resolution),
        settings=WorldSettings(preset="uniform", size=float(size[0]), resolution=float(resolution)),
        kinds=kinds,
        properties=np.broadcast_to(np.array(properties, float), (ny, nx, 4)).copy(),
        trees=Trees(np.pad(trees[:, :2], ((0, 0), (0, 1))), trees[:, 2], trees[:, 2] * 5, trees[:, 2] * 20),
        bushes=Bushes(np.pad(bushes[:, :2], ((0, 0), (0, 1))), bushes[:, 2], bushes[:, 2], bushes[:, 3]),
    )


def vehicle_on(world=None, *, parameters=None, x=0.0, y=0.0, yaw=0.0, speed=0.0):
    """The shipped side-by-side on a world, `flat_world()` by default."""
    world, parameters = world or flat_world(), parameters or load_vehicle()
    return VehicleSimulation(world, parameters, x=float(x), y=float(y), yaw=float(yaw), speed=float(speed))


def drive(vehicle, seconds, command):
    """Samples after each step; `command`: (throttle, brake, steer) or a function of the last sample that gives them."""
    samples = [vehicle.sample()]
    for _ in range(round(seconds / 0.02)):
        vehicle.step(*map(float, command(samples[-1]) if callable(command) else command))
        samples.append(vehicle.sample())
    return samples


def cruise(speed, steer=0.0):
    """Commands that keep a speed [m/s]."""
    return lambda sample: (float(np.clip(0.2 + 0.5 * (speed - np.linalg.norm(sample.velocity)), 0, 1)), 0.0, steer)


def with_tree_ahead(world, start, distance, radius=0.2):
    """The world with a single tree ahead of a start, and the tree's place."""
    ahead = np.array((start.x, start.y)) + distance * np.array((np.cos(start.yaw), np.sin(start.yaw)))
    tree = Trees(np.array([[*ahead, 0.0]]), np.array([radius]), np.array([1.5]), np.array([6.0]))
    return replace(world, trees=tree), ahead
