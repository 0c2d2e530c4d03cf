"""Pieces in order, each once, also after a kill; and what a person is told of the time left."""

import shutil
from functools import partial

import pytest

from log_messages import logged
from offpiste.errors import RunError
from offpiste.reproduction.pieces import Piece, append_time, run_pieces, said, times_by_kind
from offpiste.training.checkpoint import load_json, save_json


class Killed(BaseException):
    """Stands in for a kill."""


class Bench:
    """Pieces that take time on a clock of their own."""

    def __init__(self, kill_at: str = "") -> None:
        self.made: list[str] = []
        self.now, self.kill_at, self.told = 0.0, kill_at, []

    def piece(self, name: str, cost: float, takes: float) -> Piece:
        def do() -> None:
            if name == self.kill_at:
                raise Killed
            self.now += takes
            self.made.append(name)

        return Piece(name, cost, lambda: name in self.made, do)

    def run(self, pieces: list[Piece], **options: object) -> None:
        with logged() as messages:
            try:
                run_pieces([pieces], clock=lambda: self.now, **options)
            finally:
                self.told += messages


def test_pieces_are_done_in_order_and_a_killed_plan_goes_on():
    bench = Bench(kill_at="third")
    pieces = [bench.piece(name, 1.0, 1.0) for name in ("first", "second", "third", "fourth")]
    with pytest.raises(Killed):
        bench.run(pieces)
    assert bench.made == ["first", "second"]
    bench.kill_at = ""
    bench.run(pieces)
    assert bench.made == ["first", "second", "third", "fourth"]
    assert sum("first: there" in line for line in bench.told) == 1


def test_time_left_follows_the_pace_so_far_and_counts_what_comes_later():
    bench = Bench()
    bench.run([bench.piece("a", 10.0, 30.0), bench.piece("b", 20.0, 60.0)], later=[bench.piece("c", 40.0, 0.0)])
    assert "[1/3] a; about 70 s left" in bench.told
    assert "[2/3] b; about 3 min left" in bench.told  # 60 of cost at a third of the pace


def test_what_is_there_takes_no_time():
    bench = Bench()
    bench.made = ["a"]
    bench.run([bench.piece("a", 1000.0, 1.0), bench.piece("b", 5.0, 5.0)], before=2)
    assert bench.told[0] == "[3/4] a: there"
    assert bench.told[1] == "[4/4] b; about 5 s left"


def test_what_pieces_took_is_kept_and_summed_by_kind(tmp_path):
    file = tmp_path / "pieces.jsonl"
    assert times_by_kind(file) == {}
    bench = Bench()
    pieces = [bench.piece(name, 1.0, takes) for name, takes in (("train a", 3.0), ("judge a", 1.0), ("train b", 4.0))]
    bench.run(pieces, record=lambda name, seconds: append_time(file, name, seconds))
    assert times_by_kind(file) == {"train": 7.0, "judge": 1.0}


def test_side_by_side_a_failure_stops_no_other_piece_and_no_later_stage_begins(tmp_path):
    save_json(tmp_path / "source", {})

    def piece(name, do=None):
        do = do or partial(shutil.copy, tmp_path / "source", tmp_path / name)
        return Piece(f"make {name}", 1.0, (tmp_path / name).exists, do)

    failing = partial(load_json, tmp_path / "missing")
    stages = [[piece("a"), piece("b", failing), piece("c")], [piece("d")]]
    record = partial(append_time, tmp_path / "pieces.jsonl")
    with logged() as told, pytest.raises(RunError, match="missing"):
        run_pieces(stages, processes=2, record=record)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "c", "pieces.jsonl", "source"]
    assert set(times_by_kind(tmp_path / "pieces.jsonl")) == {"make"}
    assert any("[3/4] make c: done" in line for line in told)
    assert any("missing" in line for line in told)
    stages[0][1] = piece("b")
    with logged() as told:
        run_pieces(stages, processes=2)
    assert (tmp_path / "b").exists()
    assert (tmp_path / "d").exists()
    assert "[1/4] make a: there" in told


@pytest.mark.parametrize(("seconds", "text"), [(3.4, "3 s"), (89.0, "89 s"), (90.0, "2 min"), (7200.0, "2.0 h")])
def test_times_are_said_as_people_do(seconds, text):
    assert said(seconds) == text
