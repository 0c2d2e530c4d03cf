import numpy as np
import pytest

from offpiste.simulation.rendering.texture_noise import (
    WAVELENGTHS,
    octave_turns,
    octaves,
    random_lattice,
    value_noise,
)

OCTAVES = len(WAVELENGTHS)


def one_place(lattice, turn, sun, x, y, finest):
    """The plain reference: octaves of one place, one after the other."""
    value, slope = np.zeros(OCTAVES), np.zeros(OCTAVES)
    for o, (cos, sin) in enumerate(turn.astype(float)):
        fade = min(finest / np.hypot(cos, sin) - 1, 1)
        if fade > 0:
            result, slope_x, slope_y = value_noise.py_func(
                lattice, cos * x + sin * y + o * 17, cos * y - sin * x + o * 29
            )
            value[o], slope[o] = fade * result, -fade * (slope_x * sun[o, 0] + slope_y * sun[o, 1])
    return value, slope


# Pixels of a millimetre show all octaves, those of 20 m none.
@pytest.mark.parametrize("footprints", [(1e-3, 1e-2), (1e-3, 20.0), (0.5, 1.0), (20.0, 40.0)])
@pytest.mark.parametrize("places", [1, 37])
def test_many_places_together_have_the_noise_of_each(footprints, places):
    rng = np.random.default_rng(places)
    lattice, turn = random_lattice(rng), octave_turns(rng)
    sun = rng.normal(size=(OCTAVES, 2)).astype(np.float32)
    x, y = rng.uniform(-200, 200, (2, places))
    finest = (0.5 / rng.uniform(*footprints, places)).astype(np.float32)
    value, slope = np.full((2, OCTAVES, 40), np.nan, np.float32)
    octaves(lattice, turn, sun, x, y, finest, np.zeros((2, 40), np.int32), np.zeros((6, 40), np.float32), value, slope)
    for n in range(places):
        expected = one_place(lattice, turn, sun, x[n], y[n], float(finest[n]))
        np.testing.assert_allclose(value[:, n], expected[0], atol=2e-3)
        np.testing.assert_allclose(slope[:, n], expected[1], atol=1e-2)
    assert np.isnan(value[:, places:]).all()
    if places > 1:
        assert (value[:, :places] != 0).any() == (footprints[0] < 3)
