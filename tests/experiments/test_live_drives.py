"""Whole drives live: what is read of a status table, and how courses are compared."""

import numpy as np
import pytest

from experiments.live_drives.__main__ import _COST, courses_table, memory_table
from experiments.live_drives.status import SETTLED, Part, draw, read_status
from offpiste.core.errors import LiveError
from offpiste.live.status_table import StatusTable


def part(minutes: float, megabytes, core: float) -> Part:
    time = np.arange(0.0, 60 * minutes, 0.5)
    nothing = np.full(len(time), np.nan)
    numbers = dict.fromkeys(
        ("tick_p99_ms", "map_age_p99_ms", "plan_age_p99_ms", "plan_ms", "map_ms", "dropped"), nothing
    )
    return Part(time, {**numbers, "cpu_s": core * time, "rss_mb": megabytes(time)}, len(time) * ("ready",))


def test_memory_that_fills_first_and_then_stays_does_not_grow():
    filling = part(20.0, lambda time: 100 + 50 * np.minimum(time / SETTLED, 1.0), 0.4)
    leaking = part(20.0, lambda time: 100 + 12 * time / 3600, 0.4)
    assert filling.growth() == pytest.approx(0.0, abs=1e-6)
    assert leaking.growth() == pytest.approx(12.0)
    assert filling.share_of_core() == pytest.approx(0.4)
    assert np.isnan(part(4.0, lambda time: 100 + time, 0.4).growth()), "too short to say"
    lines = memory_table({"map": leaking}).lines
    assert lines[0][0] == "map"
    assert lines[0][1] == "40"
    assert draw({"map": leaking}).axes[0].lines


def test_a_process_that_was_started_again_begins_anew():
    twice = part(10.0, lambda time: 100 + 0 * time, 1.0)
    twice.numbers["cpu_s"][600:] -= twice.numbers["cpu_s"][600]
    assert twice.share_of_core() == pytest.approx(1.0, rel=0.01)


def test_the_table_of_live_is_read(tmp_path):
    path = tmp_path / "status.csv"
    with StatusTable(path) as table:
        for step in range(4):
            numbers = {"cpu_s": 0.1 * step, "rss_mb": 90.0, "dropped": {"late": step}}
            state = ("stopped: no scan", "driving", "degraded: late scan", "stopped: end of the course")[step]
            control = (0, state, {"tick_p99_ms": (9.0, 2.0, 3.0, 8.0)[step]})
            table.add(10 + 0.5 * step, {"map": (0, "maps", numbers), "control": control})
    parts = read_status(path)
    assert list(parts) == ["map", "control"]
    np.testing.assert_allclose(parts["map"].numbers["dropped"], [0, 1, 2, 3])
    assert np.isnan(parts["control"].numbers["rss_mb"]).all()
    assert parts["control"].worst("tick_p99_ms") == 3.0, "while it drives"
    with pytest.raises(LiveError, match="no table"):
        read_status(tmp_path / "none.csv")


def test_courses_are_compared_by_their_costs():
    late = {"tick_p99_ms": 4.0, "map_age_p99_ms": 200.0, "plan_age_p99_ms": 180.0}
    rows = [
        {
            "seed": seed,
            "live": {"finished": seed < 3, "cost": live, "time_s": 30.0} | late,
            "lockstep": {"finished": True, "cost": 100.0, "time_s": 30.0},
        }
        for seed, live in ((1, 105), (2, 110), (3, 400))
    ]
    table = courses_table(rows)
    assert [line[3] for line in table.lines] == ["+5 %", "+10 %", "+300 %", "+10 %"]
    assert table.lines[2][1] == "400 (not finished)"


@pytest.mark.parametrize(
    ("said", "finished", "cost"),
    [
        ("finished in 31.2 s, 4.9 m/s, 0.12 m off the course, cost 131; 0 steps without a command", True, 131),
        ("161 of 179 m in 50.0 s, 3.2 m/s, 0.09 m off the course, cost 402; 3 steps without a command", False, 402),
    ],
)
def test_what_the_simulator_says_is_found(said, finished, cost):
    found = _COST.search(said)
    assert (found["ending"] == "finished", int(found["cost"])) == (finished, cost)
