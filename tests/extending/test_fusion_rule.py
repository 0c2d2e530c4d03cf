"""A fusion rule of an extension."""

import pytest

from extending.outside import succeeded
from offpiste.core.errors import MapError
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.voxel_map import VoxelSettings

MAP = """
import numpy as np
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.voxel_map import VoxelSettings

pipeline = MapPipeline(1, MapSettings(VoxelSettings(reach=3.0, capacity=1000, rule="farthest")))
for feature, height in ((1.0, 5.0), (2.0, 9.0), (3.0, 9.0), (4.0, 7.0)):
    point, sensor = np.array([[0.1, 0.1, 0.05]]), np.array([0.1, 0.1, height])
    pipeline.add(FeatureCloud(point, sensor, np.array([[feature]], np.float32)), np.zeros(3))
layers = pipeline.layers()
assert layers.features[layers.valid].min() == layers.features[layers.valid].max() == 2.0
"""


def test_an_added_rule_is_used_by_the_map():
    succeeded("-c", MAP, extension="farthest")


def test_an_unknown_rule_is_refused_with_the_names_of_all():
    with pytest.raises(MapError, match=r"fusion rule 'best' is unknown; use one of: closest, latest, average"):
        MapSettings(VoxelSettings(rule="best"))
