import numpy as np
import pytest

from offpiste.simulation.world.terrain import _slump, carve_trails, distance_to_trails
from offpiste.simulation.world.world import find_world_preset


def test_a_cliff_slumps_to_the_allowed_rise():
    cliff = np.zeros((9, 12), np.float32)
    cliff[:, 6:] = 5.0
    _slump(cliff, np.float32(0.5))
    np.testing.assert_allclose(cliff[4], [0] * 6 + [0.5, 1.0, 1.5, 2.0, 2.5, 3.0], atol=1e-5)


def test_gentle_ground_does_not_slump():
    slope = np.add.outer(0.1 * np.arange(7), 0.3 * np.arange(9)).astype(np.float32)
    slumped = slope.copy()
    _slump(slumped, np.float32(0.4))
    np.testing.assert_array_equal(slumped, slope)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_straight_trail_across_a_slope_is_level(axis):
    step = 0.5
    x = y = np.arange(-40, 40 + step, step)
    hillside = (0.2 * (x[None, :] if axis == 0 else y[:, None]) + np.zeros((len(y), len(x)))).astype(np.float32)
    along = np.linspace(-30, 30, 121)
    line = np.stack((np.zeros(121), along) if axis == 0 else (along, np.zeros(121)), axis=1)
    distance = distance_to_trails((line,), np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(len(y), len(x))
    carved = carve_trails(np.random.default_rng(0), find_world_preset("mojave"), x, y, hillside, (line,), distance)
    middle = carved[80] if axis == 0 else carved[:, 80]
    sides = np.abs(x) <= 1.5
    assert np.ptp(middle[sides]) < 0.15  # 0.6 m before; ruts and roughness are left
    far = np.abs(x) > 9
    np.testing.assert_allclose(middle[far], 0.2 * x[far], atol=0.3)
