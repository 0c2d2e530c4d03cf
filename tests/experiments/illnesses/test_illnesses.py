"""Every illness changes a case, repeatably; what is healthy does not; the edit that undoes one brings the rows back."""

import numpy as np
import pytest

from experiments.illnesses.cases import patient
from experiments.illnesses.effect import distance, is_cured, rows_of
from experiments.illnesses.illness import ILLNESSES
from experiments.illnesses.true_drive import save
from made_up_drive import made_up_case, made_up_drive
from offpiste.core.errors import OffpisteError


def case_for(name, seed=0):
    return made_up_case(*ILLNESSES[name].needs, seed=seed)


def differs(one, other):
    if one.rig != other.rig or one.streams.keys() != other.streams.keys():
        return True
    for topic, stream in one.streams.items():
        also = other.streams[topic]
        columns = zip(stream.columns.values(), also.columns.values(), strict=False)
        if len(stream.columns) != len(also.columns) or not np.array_equal(stream.time, also.time, equal_nan=True):
            return True
        if not all(np.array_equal(a, b, equal_nan=True) for a, b in columns):
            return True
    return False


@pytest.mark.parametrize("kind", ["channel", "stamps", "pose", "rig", "healthy"])
def test_every_illness_changes_the_case_and_the_same_seed_gives_the_same(kind):
    for name, one in ILLNESSES.items():
        if one.kind != kind:
            continue
        case = case_for(name)
        for strength in one.strengths:
            ill = one.change(case, strength, np.random.default_rng(1))
            assert differs(ill, case), (name, strength)
            assert not differs(ill, one.change(case, strength, np.random.default_rng(1))), (name, strength)


def test_what_is_healthy_leaves_the_rows_as_they_are():
    for name, one in ILLNESSES.items():
        if one.kind == "healthy" and name != "wrong mass":
            case = case_for(name)
            changed = one.change(case, one.strengths[-1], np.random.default_rng(1))
            assert distance(rows_of(changed), rows_of(case)) < 0.15, name


CURES = [
    ("steer: sign", lambda rig: [("channels.steer.sign", -rig.channels["steer"].sign)]),
    ("throttle: the wrong way round", lambda rig: [("channels.throttle.scale", -rig.channels["throttle"].scale),
                                                   ("channels.throttle.offset", 1 - rig.channels["throttle"].offset)]),
    ("yaw: sign", lambda rig: [("channels.yaw.sign", -rig.channels["yaw"].sign)]),
    ("linear_velocity: frame", lambda rig: [("channels.linear_velocity.frame", "unknown")]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "cure"), CURES, ids=[name for name, _ in CURES])
def test_the_edit_that_undoes_an_illness_is_a_cure_and_another_is_not(name, cure):
    one = ILLNESSES[name]
    # Units of a percent would have another offset: a plain recording.
    case = next(c for c in (case_for(name, seed) for seed in range(30)) if not c.source(one.places[0]).unit)
    ill = one.change(case, one.strengths[-1], np.random.default_rng(1))
    healthy = rows_of(case)
    away = distance(rows_of(ill), healthy)
    assert away > 0.1
    cured = ill.with_rig(*cure(ill.rig))
    assert is_cured(distance(rows_of(cured), healthy), away)
    assert not is_cured(distance(rows_of(ill.with_rig(("vehicle.mass", 1.0))), healthy), away)


def test_a_seed_is_one_case_and_a_choice_is_kept(tmp_path):
    for seed in range(8):
        save(made_up_drive(), tmp_path / f"drive-{seed:06d}.npz")
        one, again = (patient(seed, tmp_path) for _ in range(2))
        assert list(map(str, one.given)) == list(map(str, again.given))
        assert not differs(one.case, again.case)
        assert [g.illness.name for g in patient(seed, tmp_path, names=["steer: sign"]).given] == ["steer: sign"]
        assert patient(seed, tmp_path, healthy=True).illnesses == ()
    with pytest.raises(OffpisteError, match="no illness"):
        patient(0, tmp_path, names=["flu"])
