"""The vehicle against the textbook, on flat uniform ground."""

import numpy as np
import pytest
from msgspec.structs import replace

from offpiste.core.conventions import GRAVITY
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.ground import property_table
from simulation.drives import cruise, drive, flat_world, vehicle_on

PARAMETERS = load_vehicle()
NEUTRAL = replace(PARAMETERS, clutch_gain=1e-12)
DRY, WET = property_table()
KINDS = ("loose_sand", "dirt_trail", "mud")
GROUNDS = [pytest.param(DRY[GROUND_KINDS.index(kind)], id=kind) for kind in KINDS]
SOAKED = [pytest.param(WET[GROUND_KINDS.index(kind)], id=f"soaked {kind}") for kind in KINDS]
WEIGHT = PARAMETERS.mass * GRAVITY


@pytest.mark.parametrize("ground", GROUNDS + SOAKED)
def test_braking_distance_is_that_of_locked_wheels(ground):
    # v^2 / (2 mu g): friction bounds the whole horizontal force, rolling resistance of locked wheels included.
    # Measured from the moment all wheels slide; before it, pressure builds up.
    samples = drive(vehicle_on(flat_world(properties=ground), x=-100, speed=12.0), 6, (0, 1, 0))
    sliding = next(s for s in samples if (s.truth.slip_ratio < -0.5).all())
    assert sliding.time < 0.35
    stop, speed = samples[-1], sliding.velocity[0]
    assert abs(stop.velocity).max() < 1e-2
    distance = stop.position[0] - sliding.position[0]
    assert distance == pytest.approx(speed**2 / (2 * ground[0] * GRAVITY), rel=0.03)
    whole = stop.position[0] + 100
    assert whole == pytest.approx(12.0**2 / (2 * ground[0] * GRAVITY), rel=0.10)


@pytest.mark.parametrize("ground", GROUNDS)
def test_cornering_reaches_friction_and_never_exceeds_it(ground):
    keep = cruise(8.0)
    samples = drive(
        vehicle_on(flat_world(properties=ground), x=-20, y=-20, speed=8.0),
        9,
        lambda s: (*keep(s)[:2], min(s.time / 8, 1)),
    )
    velocity = np.array([s.velocity for s in samples])
    acceleration = (velocity[10:] - velocity[:-10]) / 0.2  # over 0.2 s
    course = velocity[5:-5, :2] / np.linalg.norm(velocity[5:-5, :2], axis=1)[:, None]
    lateral = course[:, 0] * acceleration[:, 1] - course[:, 1] * acceleration[:, 0]
    assert 0.8 < max(lateral) / (ground[0] * GRAVITY) < 1.0


@pytest.mark.parametrize("ground", GROUNDS)
def test_coasts_down_by_its_resistance(ground):
    p = NEUTRAL
    samples = drive(vehicle_on(flat_world(properties=ground), parameters=p, x=-100, speed=12.0), 3, (0, 0, 0))
    first, last = samples[50].velocity[0], samples[150].velocity[0]
    v = (first + last) / 2
    air = p.air_density * p.drag_area * v**2 / 2
    shafts = 4 * (p.shaft_drag + p.shaft_drag_slope * v / p.rolling_radius) / p.rolling_radius
    rolling = ground[2] * WEIGHT
    spinning = 4 * p.wheel_inertia / p.rolling_radius**2
    assert (first - last) / 2.0 == pytest.approx((rolling + air + shafts) / (p.mass + spinning), rel=0.02)


@pytest.mark.parametrize("ground", GROUNDS)
def test_climbs_what_friction_less_resistance_allows(ground):
    # All wheels drive, locked front to rear: tan(slope) = thrust(slip) - rolling - sinkage slip, at its best slip;
    # the thrust is the brush's, and never above friction.
    friction, cornering, rolling, sinkage = ground
    slip = np.linspace(0, 1, 1001)
    share = np.minimum(PARAMETERS.slip_stiffness_ratio * cornering * slip / (1 + slip) / (3 * friction), 1)
    best = (friction * (1 - (1 - share) ** 3) - rolling - sinkage * slip).max()
    gentle = drive(vehicle_on(flat_world(properties=ground, slope=0.85 * best), x=-20, speed=2.0), 4, _creep)
    assert gentle[-1].velocity[0] > 0.5
    steep = flat_world(properties=ground, slope=1.05 * (friction - rolling))
    assert drive(vehicle_on(steep, x=-20, speed=0.5), 4, (0.6, 0, 0))[-1].velocity[0] < 0.05


def _creep(sample):
    """Wheels held at 1.8 m/s: the vehicle finds the slip that carries it."""
    return float(np.clip(0.5 + 2.0 * (1.8 - sample.wheel_speed.mean()), 0, 1)), 0.0, 0.0


def test_loads_on_slopes_follow_the_height_of_the_centre_of_mass():
    slope = np.tan(np.radians(12))
    up = drive(vehicle_on(flat_world(slope=slope)), 2, (0, 1, 0))[-1].truth.load
    p = PARAMETERS
    front = p.front_share * np.cos(np.radians(12)) - p.com_height / p.wheelbase * np.sin(np.radians(12))
    assert up[:2].sum() / WEIGHT == pytest.approx(front, abs=0.01)
    side = drive(vehicle_on(flat_world(side_slope=slope)), 2, (0, 1, 0))[-1].truth.load
    high = np.cos(np.radians(12)) / 2 - p.com_height / p.track * np.sin(np.radians(12))
    # Springs and tyres lean: the lower wheels carry a little more than on a rigid body.
    assert high - 0.03 < side[::2].sum() / WEIGHT < high


def test_braking_and_cornering_shift_load():
    braking = drive(vehicle_on(x=-100, speed=10.0), 1, (0, 1, 0))[-1]
    p, slowing = PARAMETERS, 0.6
    front = p.front_share + slowing * p.com_height / p.wheelbase
    assert braking.truth.load[:2].sum() / WEIGHT == pytest.approx(front, abs=0.03)
    left = drive(vehicle_on(speed=7.0), 3, cruise(7.0, steer=0.4))[-1]
    assert left.truth.load[1::2].sum() > 1.3 * left.truth.load[::2].sum()
    lateral = left.angular_velocity[2] * np.linalg.norm(left.velocity)
    shift = (left.truth.load[1::2].sum() - left.truth.load[::2].sum()) / 2
    x, y, z, w = left.orientation
    lean = 2 * (x * w + y * z)  # the centre of mass moves outwards with the roll
    assert shift == pytest.approx(p.mass * (lateral + GRAVITY * lean) * p.com_height / p.track, rel=0.05)


@pytest.mark.parametrize("heading", [0.0, np.pi / 2, 2.5])
def test_parked_on_a_slope_stays(heading):
    world = flat_world(slope=np.tan(np.radians(15)))
    samples = drive(vehicle_on(world, yaw=heading), 10, (0, 1, 0))
    later = np.array([s.position for s in samples[250:]])
    assert np.linalg.norm(later - later[0], axis=1).max() < 1e-3
    speeds = np.array([np.linalg.norm(s.velocity) for s in samples[400:]])
    assert speeds.max() < 1e-3
    assert np.ptp([s.truth.load for s in samples[400:]], axis=0).max() < 5.0


@pytest.mark.parametrize("bumps", [None, lambda x: 0.05 * np.sin(2 * np.pi * x / 5), lambda x: 0.3 * np.sin(x / 2.4)])
def test_free_roll_gains_no_energy(bumps):
    free = replace(NEUTRAL, drag_area=1e-9, shaft_drag=1e-9, shaft_drag_slope=1e-9)
    world = flat_world(properties=(0.6, 6.0, 0.0, 0.0), bumps=bumps, resolution=0.25, size=(160, 20))
    samples = drive(vehicle_on(world, parameters=free, x=-60, speed=6.0), 12, (0, 0, 0))
    energy = [s.velocity @ s.velocity / 2 + GRAVITY * s.position[2] for s in samples]
    windows = np.array(energy[1:]).reshape(6, 100).mean(axis=1)
    assert (np.diff(windows) < 0.006 * windows[0]).all()
    if bumps is None:
        assert windows[-1] == pytest.approx(windows[0], rel=1e-3)


@pytest.mark.parametrize(("degrees", "rolls"), [(25, False), (50, True)])
def test_rolls_over_on_a_side_slope(degrees, rolls):
    # Rigid, it would tip at atan(track / 2 / height) = 45 degrees; on springs and tyres earlier, about 33.
    world = flat_world(properties=(1.2, 8, 0.05, 0.02), side_slope=np.tan(np.radians(degrees)), size=(60, 60))
    samples = drive(vehicle_on(world, y=10), 3, (0, 1, 0))
    assert [e for s in samples for e in s.events] == ["rollover"] * rolls


def test_collides_with_a_tree_once_and_does_not_pass_it():
    world = flat_world(trees=[(0.0, 0.4, 0.15), (50.0, 0.0, 0.2)])
    samples = drive(vehicle_on(world, x=-20, speed=8.0), 5, (0.3, 0, 0))
    assert [e for s in samples for e in s.events] == ["collision with a tree"]
    assert max(s.position[0] for s in samples) < -0.8


def test_bush_takes_the_energy_of_its_drag():
    bush = [(0.0, 0.0, 1.0, 600.0)]
    square = []
    for bushes in ((), bush):
        samples = drive(vehicle_on(flat_world(bushes=bushes), parameters=NEUTRAL, x=-10, speed=8.0), 3, (0, 0, 0))
        square.append(np.interp(5.0, [s.position[0] for s in samples], [s.velocity[0] ** 2 for s in samples]))
    p = PARAMETERS
    mass = p.mass + 4 * p.wheel_inertia / p.rolling_radius**2
    assert mass / 2 * (square[0] - square[1]) == pytest.approx(600.0 * (p.length + 2 * 1.0), rel=0.05)
