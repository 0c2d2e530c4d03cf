import numpy as np

from offpiste.dynamics.kernels import generate, layout
from offpiste.dynamics.kernels.elementary import add_outer, add_product


def test_generated_code_is_what_the_physics_gives():
    for path, text in generate.files().items():
        assert path.read_text() == text, "run `python -m offpiste.dynamics.kernels.generate`"


def test_every_quantity_has_its_own_name():
    names = [*layout.ROWS, *layout.CONSTANTS]
    assert len(set(names)) == len(names)


def test_matrix_primitives():
    draw = np.random.default_rng(0)
    w = draw.normal(size=(20, 24)).astype(np.float32)
    x, y = (draw.normal(size=(n, layout.LANES)).astype(np.float32) for n in (24, 20))
    found = y.copy()
    add_product(w, x.ravel(), found.ravel())
    np.testing.assert_allclose(found, y + w @ x, atol=2e-5)
    outer = w.copy()
    add_outer(y.ravel(), x.ravel(), outer)
    np.testing.assert_allclose(outer, w + y @ x.T, atol=1e-4)
