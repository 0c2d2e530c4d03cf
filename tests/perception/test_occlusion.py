"""The fast occlusion test against its definition, point by point."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from offpiste.perception.projection import FREE, SECTORS, occluded_points


def plain(pixels, depth, reach, cell=2, relative=0.06, absolute=0.3):
    """The definition, slowly."""
    window = int(np.ceil(reach / cell))
    place = np.floor((pixels + 0.5) / cell).astype(int)
    answer = []
    for here, own in zip(place, depth, strict=True):
        nearer = place[depth < own - (relative * own + absolute)] - here
        near = nearer[(nearer**2).sum(axis=1) <= window**2]
        if (near == 0).all(axis=1).any():
            answer.append(True)
            continue
        taken = np.zeros(SECTORS, bool)
        taken[np.round(np.arctan2(near[:, 1], near[:, 0]) / (2 * np.pi) * SECTORS).astype(int) % SECTORS] = True
        gaps = [len(run) for run in "".join("x" if t else "." for t in np.tile(taken, 2)).split("x")]
        answer.append(max(gaps) <= FREE)
    return np.array(answer)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), reach=st.floats(2, 12))
def test_as_defined(seed, reach):
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(-0.5, 59.5, (80, 2))
    depth = rng.choice([3.0, 3.5, 8.0, 20.0], 80) * rng.uniform(0.95, 1.05, 80)
    np.testing.assert_array_equal(occluded_points(pixels, depth, (60, 60), reach=reach), plain(pixels, depth, reach))


def test_by_hand():
    around = np.array([[30.0, 24.0], [36.0, 30.0], [30.0, 36.0], [24.0, 30.0], [30.0, 30.0]])
    depth = np.array([5.0, 5.0, 5.0, 5.0, 9.0])
    assert occluded_points(around, depth, (60, 60), reach=8.0).tolist() == [False] * 4 + [True]
    assert not occluded_points(around, depth, (60, 60), reach=4.0).any()  # too far away
    assert not occluded_points(around[[0, 1, 4]], depth[[0, 1, 4]], (60, 60), reach=8.0).any()  # one side is open
    assert not occluded_points(around, np.where(depth == 9, 5.5, depth), (60, 60), reach=8.0).any()  # the same surface
    assert len(occluded_points(np.zeros((0, 2)), np.zeros(0), (60, 60), reach=8.0)) == 0
