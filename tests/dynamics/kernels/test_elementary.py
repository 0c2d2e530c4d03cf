import numba
import numpy as np
import pytest

from offpiste.dynamics.kernels import elementary

ANGLES = np.concatenate((np.linspace(-10, 10, 20001), np.linspace(-1e4, 1e4, 200001), np.linspace(-1e-3, 1e-3, 2001)))
WIDE = np.concatenate(
    (np.linspace(-12, 12, 200001), np.geomspace(1e-30, 1e30, 100001), -np.geomspace(1e-30, 1e30, 100001))
)


def on_array(function, x):
    @numba.njit(fastmath={"contract"}, error_model="numpy")
    def loop(x):
        y = np.empty_like(x)
        for i in range(len(x)):
            y[i] = function(x[i])
        return y

    return loop(x)


@pytest.mark.parametrize(
    ("name", "reference", "x", "absolute", "relative"),
    [
        ("sin", np.sin, ANGLES, 3e-7, np.inf),
        ("cos", np.cos, ANGLES, 3e-7, np.inf),
        ("tanh", np.tanh, WIDE, 4e-7, 4e-7),
        ("atan", np.arctan, WIDE, 3e-7, 3e-7),
    ],
)
def test_errors_are_as_small_as_stated(name, reference, x, absolute, relative):
    x = x.astype(np.float32)
    wanted = reference(x.astype(np.float64))
    found = on_array(getattr(elementary, name), x)
    assert found.dtype == np.float32
    error = np.abs(found - wanted)
    scale = np.abs(wanted)
    print(name, error.max(), (error[scale > 0] / scale[scale > 0]).max())
    assert error.max() < absolute
    assert (error[scale > 0] / scale[scale > 0]).max() < relative


@pytest.mark.parametrize("name", ["sin", "cos", "tanh", "atan"])
def test_nan_stays_nan_and_large_arguments_stay_bounded(name):
    x = np.array([np.nan, 1e20, -1e20], np.float32)
    found = on_array(getattr(elementary, name), x)
    assert np.isnan(found[0])
    assert (np.abs(found[1:]) <= 1.6).all()


def test_step_is_the_slope_of_maximum_and_half_where_equal():
    @numba.njit
    def both(a, b):
        return elementary.maximum(a, b), elementary.step(a, b)

    assert both(np.float32(1), np.float32(2)) == (2, 0)
    assert both(np.float32(2), np.float32(1)) == (2, 1)
    assert both(np.float32(1), np.float32(1)) == (1, 0.5)
