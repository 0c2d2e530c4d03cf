"""Paired differences and the table over courses."""

import numpy as np
import pytest

from experiments.closed_loop_table.table import COUNTED, paired, table


def test_intervals_of_a_known_difference():
    rng = np.random.default_rng(0)
    shared = rng.normal(30, 10, 200)
    found = paired((shared + rng.normal(-1.0, 1.0, 200))[None], shared[None])
    # 1.96 sigma / sqrt(n), whatever courses have in common.
    assert found.mean == pytest.approx(-1.0, abs=0.2)
    assert np.ptp(found.ci95) == pytest.approx(2 * 1.96 / np.sqrt(200), rel=0.2)
    assert found.ci95[0] < found.mean < found.ci95[1]


def result(row, seed, time, finished=True, run_seed=0, kind="bends", firm=None):
    return {
        "row": row,
        "run_seed": run_seed,
        "world": "mojave",
        "seed": seed,
        "driven_cost": 10 * time,
        "moving_cost": 10 * time,
        "time_s": time,
        "mean_path_error_m": 0.5,
        "worst_path_error_m": 1.0,
        "mean_speed_error_mps": 2.0,
        "plan_error_5s_m": {"mean": None},
        "energy_kj": 100.0 + 10 * seed,
        "interventions": 1,
        "firm_way": firm,
        "commit": "0123abc",
        "course": {"kind": kind},
        **dict.fromkeys(COUNTED, False),
        "finished": finished,
    }


def test_the_table_counts_what_did_not_finish_with_the_limit():
    rows = [result("b-100ms", seed, 30.0) for seed in range(4)]
    rows += [result("dc-100ms", seed, 20.0, finished=seed > 0) for seed in range(4)]
    rows += [result("dc-300ms", seed, 25.0) for seed in range(4)]
    text = table(rows, limit=40.0)
    assert (
        "| b-100ms | 1 | 300 | 300 | 30.00 | 0.50 | 1.00 | 2.00 | – | 115.00 | 1.00 | 4 | 4 | 0 | 0 | 0 | 0 | 0 |"
        in text
    )
    assert "| dc-100ms | 1 | 200 | 200 | 25.00 |" in text  # (40 + 3 * 20) / 4
    lines = [line for line in text.splitlines() if "−" in line and line.startswith("|")]
    assert [line.split("|")[1].strip() for line in lines] == ["dc-100ms − b-100ms", "dc-300ms − dc-100ms"]
    assert "| -33 % [-33, -33] |" in lines[0]
    assert "-5.00 [" in lines[0]


def test_driving_is_separated_from_how_often_they_stop():
    rows = [result("b-100ms", seed, 20.0) for seed in range(4)]
    rows += [result("dc-100ms", 0, 2000.0, finished=False), *(result("dc-100ms", seed, 10.0) for seed in (1, 2, 3))]
    (line,) = (line for line in table(rows, limit=40.0).splitlines() if line.startswith("| dc-100ms − b"))
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    whole = 100 * ((100 * 0.5**3) ** 0.25 - 1)  # 100 times as expensive once, half three times
    assert cells[1].startswith(f"{whole:+.0f} %")
    assert cells[-2:] == ["-50 % [-50, -50] (3)", "-50 % [-50, -50]"]


def test_runs_are_compared_with_those_of_the_same_seed_or_alone():
    rows = [result("b-100ms", seed, 20.0, run_seed=run) for run in (0, 1) for seed in range(3)]
    rows += [result("dc-100ms", seed, 10.0, run_seed=1, finished=seed > 0) for seed in range(3)]
    rows += [result("ceiling-100ms", seed, 10.0, run_seed=7) for seed in range(3)]
    text = table(rows, limit=40.0)
    assert "| b-100ms | 2 | 200 | 200 | 20.00 | 0.50 | 1.00 | 2.00 | – | 110.00 | 1.00 | 6 | 6 |" in text
    assert "| dc-100ms | 1 | 100 | 100 | 20.00 | 0.50 | 1.00 | 2.00 | – | 115.00 | 1.00 | 3 | 2 |" in text
    line, alone = (line for line in text.splitlines() if "−" in line and line.startswith("|"))
    assert line.startswith("| dc-100ms − b-100ms | -50 % [-50, -50] |")
    assert line.endswith("| – (2) | – |")
    assert alone.startswith("| ceiling-100ms − dc-100ms | +0 % [+0, +0] |")


def test_each_kind_has_a_part_of_its_own_and_the_energy_is_of_finished_drives():
    rows = [result("b-100ms", seed, 10.0, kind="bends") for seed in range(3)]
    rows += [result("b-100ms", seed, 20.0, kind="passages", finished=seed < 5) for seed in range(3, 6)]
    parts = table(rows, limit=40.0).split("## ")[1:]
    assert [part.splitlines()[0] for part in parts] == ["All courses", "Bends", "Passages"]
    shown = [next(line for line in part.splitlines() if line.startswith("| b-100ms")) for part in parts]
    cells = [[cell.strip() for cell in line.split("|")][1:-1] for line in shown]
    assert [row[4] for row in cells] == ["18.33", "10.00", "26.67"]
    assert [row[9] for row in cells] == ["120.00", "110.00", "135.00"]
    assert "firm way" not in "".join(parts)
