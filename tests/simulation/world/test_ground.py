import numpy as np
import pytest

from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES
from offpiste.simulation.world.ground import colour_table, grounds, mix_properties, property_table

K = len(GROUND_KINDS)


def _shares(seed=0, ny=5, nx=7):
    rng = np.random.default_rng(seed)
    kinds = rng.dirichlet(np.ones(K), (ny, nx)).transpose(2, 0, 1).astype(np.float32)
    return kinds, rng.uniform(size=(ny, nx)).astype(np.float32)


def test_the_table_lies_within_published_ranges():
    dry, wet = property_table()
    for friction, stiffness, rolling, sinkage in np.concatenate((dry, wet)):
        assert 0.2 <= friction <= 0.7
        assert 2.5 <= stiffness <= 8
        assert 0.02 <= rolling <= 0.35
        assert 0 <= sinkage <= 0.15
        assert rolling < friction  # or a vehicle could not move
    assert all(getattr(ground, name).source for ground in grounds() for name in GROUND_PROPERTIES)


def test_wet_ground_is_darker():
    dry, wet = colour_table()
    assert (wet.mean(axis=1) < 0.8 * dry.mean(axis=1)).all()
    assert ((wet > 0) & (dry < 1)).all()


def test_pure_ground_has_its_row_of_the_table():
    dry, wet = property_table()
    for k in range(K):
        kinds = np.zeros((K, 1, 3), np.float32)
        kinds[k] = 1
        mixed = mix_properties(kinds, np.array([[0.0, 1.0, 0.25]], np.float32), 1.0)[0]
        np.testing.assert_allclose(mixed, [dry[k], wet[k], 0.75 * dry[k] + 0.25 * wet[k]], rtol=1e-5)


def test_a_border_is_the_mean_of_its_sides():
    dry, _ = property_table()
    kinds = np.zeros((K, 1, 1), np.float32)
    kinds[1], kinds[4] = 0.25, 0.75
    mixed = mix_properties(kinds, np.zeros((1, 1), np.float32), 1.0)[0, 0]
    np.testing.assert_allclose(mixed, 0.25 * dry[1] + 0.75 * dry[4], rtol=1e-5)


@pytest.mark.parametrize("contrast", [0.0, 0.25, 0.5])
def test_contrast_is_linear_about_the_mean_of_the_table(contrast):
    kinds, wetness = _shares()
    mean = property_table().mean(axis=(0, 1))
    full = mix_properties(kinds, wetness, 1.0)
    np.testing.assert_allclose(mix_properties(kinds, wetness, contrast), mean + contrast * (full - mean), rtol=1e-5)
