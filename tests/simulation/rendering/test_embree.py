import ctypes

import numpy as np
import pytest

from offpiste.simulation.rendering.embree import FirstHits, Part, RayPackets, SingleRays, _library
from offpiste.simulation.rendering.meshes import ground_mesh
from simulation import scenes


def parts(quadrilaterals):
    rng = np.random.default_rng(0)
    soup = rng.normal(size=(200, 1, 3)) * np.array((20, 20, 1)) + rng.normal(size=(200, 3, 3))
    triangles = Part(soup.reshape(-1, 3).astype(np.float32), np.arange(600, dtype=np.int32).reshape(-1, 3))
    ground = ground_mesh(scenes.world(size=80, resolution=2.0, slope=(0.1, 0.2)))
    return [Part(ground.vertices, ground.faces), triangles] if quadrilaterals else [triangles]


def rays(n, *, one_origin):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(n, 3)).astype(np.float32)
    origins = rng.uniform(-20, 20, (1 if one_origin else n, 3)) + np.array((0, 0, 12))
    return origins.astype(np.float32), directions


def none(n, farthest=np.inf):
    return FirstHits(
        np.full(n, farthest, np.float32), *(np.full(n, -7, np.int32) for _ in range(2)), np.zeros((n, 3), np.float32)
    )


@pytest.mark.parametrize("n", [1, 7, 16, 1003])
@pytest.mark.parametrize("one_origin", [True, False])
@pytest.mark.parametrize("farthest", [np.inf, 25.0])
def test_packets_hit_what_single_rays_hit(n, one_origin, farthest):
    library = _library()
    if library is None:
        pytest.skip("embreex does not bring Embree as a file here")
    origins, directions = rays(n, one_origin=one_origin)
    for quadrilaterals in (False, True):
        single, packets = SingleRays(parts(quadrilaterals)), RayPackets(parts(quadrilaterals), library)
        expected, hits = none(n, farthest), none(n, farthest)
        single.intersect(origins, directions, expected)
        packets.intersect(origins, directions, hits)
        np.testing.assert_array_equal(hits.part, expected.part)
        np.testing.assert_array_equal(hits.face, expected.face)
        # A quadrilateral's second triangle is given by other corners than embreex's.
        np.testing.assert_allclose(hits.distance, expected.distance, rtol=2e-6 if quadrilaterals else 0)
        np.testing.assert_allclose(hits.normal, expected.normal, rtol=1e-5 if quadrilaterals else 0)
        np.testing.assert_array_equal(packets.occluded(origins, directions), single.occluded(origins, directions))
        if n > 1000 and not one_origin:
            assert 0.01 < (hits.part >= 0).mean() < 0.99
            assert (np.unique(hits.part[hits.part >= 0]) == np.arange(1 + quadrilaterals)).all()


def test_scenes_that_do_not_fit_into_memory_are_refused():
    class Full(ctypes.CDLL):
        """Embree's library when memory runs out."""

        def __init__(self):
            pass

        def __getattr__(self, name):
            return lambda *_: 2

    with pytest.raises(MemoryError, match="cannot build"):
        RayPackets([], Full())
