"""Comparison of the parts of a split, and proposals of better splits."""

from dataclasses import replace

import numpy as np

from factories import circle_rows, dataset_in_memory
from offpiste.dataset.extract import described
from offpiste.dataset.resample import Rows
from offpiste.dataset.split_balance import (
    LEAST_WINDOWS,
    fitting_split,
    lacks_windows,
    next_split,
    part_facts,
    split_warning,
)
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset


def at_speed(speed: np.ndarray) -> Rows:
    """A drive straight ahead with these speeds [m/s]."""
    rows = circle_rows(len(speed), seed=0)
    state = np.zeros_like(rows.state)
    state[:, 0], state[:, 3] = np.cumsum(speed) * 0.02, speed
    return replace(rows, state=state, state_causal=state.copy(), valid=np.ones(len(speed), bool))


def dataset(rows: Rows, split: str = "blocks:0.7,0.1,0.2") -> Dataset:
    return dataset_in_memory({"drive": rows}, split)


def wandering(count: int, seed: int = 0) -> np.ndarray:
    return 5 + 2 * np.sin(np.arange(count) * 0.02 / 7 + np.random.default_rng(seed).uniform(0, 6))


def test_parts_that_drive_alike_are_fine() -> None:
    assert split_warning(dataset(at_speed(wandering(20000)))) is None


def test_parts_that_stand_still_are_complained_of_and_interleaved_blocks_are_proposed() -> None:
    speed = wandering(30000)
    speed[21000:] = np.where(np.arange(9000) % 3000 < 400, 3.0, 0.0)
    data = dataset(at_speed(speed))
    line = split_warning(data) or ""
    assert "validation drives at a median of 0.0 m/s, train at" in line
    assert "; better: extract again, into another --out, with --split " in line
    proposed = line.split("--split ")[1].split(" ")[0]
    assert split_warning(data.relabelled(parse_split(proposed))) is None
    assert str(next_split(data) and next_split(data).text) == proposed


def test_a_drive_that_stands_nearly_always_has_no_better_split() -> None:
    speed = np.zeros(20000)
    speed[:1500] = 5.0
    line = split_warning(dataset(at_speed(speed))) or ""
    assert "validation has 0 windows above 1.5 m/s" in line
    assert line.endswith("; record more driving")


def test_a_short_drive_gets_a_split_in_which_every_part_has_windows() -> None:
    data = dataset(at_speed(wandering(4000)))
    (drive,) = data.drives
    found = fitting_split([drive], 0.0, 1.5)
    assert found is not None
    assert all(part.windows for part in part_facts(data.relabelled(found)))
    short = dataset(at_speed(wandering(3000)))
    split = next_split(short)
    assert split is not None
    assert all(part.windows >= LEAST_WINDOWS for part in part_facts(short.relabelled(split)))
    assert f"with --split {found.text}, or" in described(drive, data.split)
    assert fitting_split(dataset(at_speed(wandering(800))).drives, 0.0, 1.5) is None


def test_squares_that_leave_a_part_out_are_said_to() -> None:
    rows = circle_rows(12000, speed=6.0, yaw_rate=0.1)
    lines = {metres: split_warning(dataset(rows, f"places:{metres}")) or "" for metres in (30, 75, 150)}
    assert "no square" not in lines[30]
    assert "no square is for validation;" in lines[75]
    assert "no square is for validation; no square is for test;" in lines[150]


def test_short_drives_whose_parts_are_empty_get_a_split_that_fills_them_together() -> None:
    one = dataset(at_speed(wandering(2000)))
    drives = tuple(replace(one.drives[0], name=name) for name in ("first", "second"))
    short = replace(one, drives=drives)
    assert lacks_windows(short)
    split = next_split(short)
    assert split is not None
    assert not lacks_windows(short.relabelled(split))
    hopeless = dataset(at_speed(wandering(1200)))
    assert lacks_windows(hopeless)
    assert next_split(hopeless) is None
