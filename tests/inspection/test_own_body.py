"""Parts of the vehicle are seen because they stand while it drives; a branch, the ground and a standstill are not."""

from dataclasses import replace

import numpy as np

import textured_world as world
from offpiste.inspection.own_body import check_own_body
from offpiste.logs.channel import Channel
from offpiste.logs.poses import Poses

WHEELS = ((1.0, 0.7), (1.0, -0.7), (-1.0, 0.7), (-1.0, -0.7))


def with_part(scans, low, high):
    """Scans with fifty returns in a box of the body frame."""
    mounting = world.lidar().body_from_lidar
    part = np.random.default_rng(0).uniform(low, high, (50, 3))
    seen = (part - mounting[:3, 3]) @ mounting[:3, :3]
    return [
        replace(s, points=np.concatenate((s.points, seen)), which=np.append(s.which, np.zeros(50, int))) for s in scans
    ]


def found(scans, poses=None, **source):
    lidar = world.lidar()
    lidar = replace(lidar, source=type(lidar.source)(lidar.source.topic, **source))
    return check_own_body(lidar, scans, poses or world.poses(), WHEELS)


def test_what_stands_is_the_vehicle():
    scans = world.scans()
    assert found(scans) == []
    for low, high in (((-0.5, -0.5, 1.0), (0.5, 0.5, 1.2)), ((0.9, -1.5, 1.0), (1.1, -1.3, 1.4))):  # a roof, a mirror
        (finding,) = found(with_part(scans, low, high))
        assert (finding.where, finding.what) == ("top", "sees the vehicle itself")
        ((cure,),) = finding.cures
        assert cure.key == "lidars.top.own_body"
        assert (np.array(cure.value[0]) <= low).all()
        assert (np.array(cure.value[1]) >= high).all()


def test_the_box_of_the_rig_grows():
    (finding,) = found(with_part(world.scans(), (0.0, 0.0, 1.0), (0.3, 0.3, 1.3)), own_body=((-2, -1, 0), (0.1, 1, 1)))
    box = finding.cures[0][0].value
    assert box[0] == [-2, -1, 0]
    assert box[1][1] == 1
    assert (np.array(box[1]) >= (0.3, 0.3, 1.3))[[0, 2]].all()


def test_what_is_there_for_a_while_is_a_branch():
    scans = world.scans()
    half = len(scans) // 2
    assert found(with_part(scans, (-0.5, -0.5, 1.0), (0.5, 0.5, 1.2))[:half] + scans[half:]) == []


def test_at_a_standstill_everything_stands():
    times = np.array([-1.0, 1e3])
    still = Poses(Channel("position", "m", times, np.zeros((2, 3))),
                  Channel("orientation", "", times, np.tile([0.0, 0, 0, 1], (2, 1))), 1e4)  # fmt: skip
    assert found(with_part(world.scans(), (-0.5, -0.5, 1.0), (0.5, 0.5, 1.2)), still) == []
