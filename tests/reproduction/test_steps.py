"""Steps run in order, each once, also after a kill; the log shows the remaining time."""

import shutil
from functools import partial

import pytest

from log_messages import logged
from offpiste.core.errors import RunError
from offpiste.reproduction.steps import Step, format_duration, run_steps
from offpiste.training.checkpoint import load_json, save_json


class Killed(BaseException):
    """Stands in for a kill."""


class Bench:
    """Steps that take time on a clock of their own."""

    def __init__(self, kill_at: str = "") -> None:
        self.made: list[str] = []
        self.now, self.kill_at, self.logged = 0.0, kill_at, []

    def step(self, name: str, cost: float, takes: float) -> Step:
        def do() -> None:
            if name == self.kill_at:
                raise Killed
            self.now += takes
            self.made.append(name)

        return Step(name, cost, lambda: name in self.made, do)

    def run(self, *stages: list[Step]) -> None:
        with logged() as messages:
            try:
                run_steps(stages, clock=lambda: self.now)
            finally:
                self.logged += messages


def test_steps_are_done_in_order_and_resumed_after_a_kill():
    bench = Bench(kill_at="third")
    steps = [bench.step(name, 1.0, 1.0) for name in ("first", "second", "third", "fourth")]
    with pytest.raises(Killed):
        bench.run(steps)
    assert bench.made == ["first", "second"]
    bench.kill_at = ""
    bench.run(steps)
    assert bench.made == ["first", "second", "third", "fourth"]
    assert "[1/4] first: there" in bench.logged
    assert "[3/4] third; about 2 s left" in bench.logged, "finished steps take no time"


def test_time_left_follows_the_pace_so_far_and_counts_later_stages():
    bench = Bench()
    bench.run([bench.step("a", 10.0, 30.0), bench.step("b", 20.0, 60.0)], [bench.step("c", 40.0, 0.0)])
    assert "[1/3] a; about 70 s left" in bench.logged
    assert "[2/3] b; about 3 min left" in bench.logged  # 60 of cost at a third of the pace


def test_side_by_side_a_failure_stops_no_other_step_and_no_later_stage_begins(tmp_path):
    save_json(tmp_path / "source", {})

    def step(name, do=None):
        do = do or partial(shutil.copy, tmp_path / "source", tmp_path / name)
        return Step(f"make {name}", 1.0, (tmp_path / name).exists, do, lambda: "a copy")

    failing = partial(load_json, tmp_path / "missing")
    stages = [[step("a"), step("b", failing), step("c")], [step("d")]]
    with logged() as lines, pytest.raises(RunError, match="missing"):
        run_steps(stages, processes=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "c", "source"]
    assert any("[3/4] make c: done, a copy; about" in line for line in lines)
    assert any("missing" in line for line in lines)
    stages[0][1] = step("b")
    with logged() as lines:
        run_steps(stages, processes=2)
    assert (tmp_path / "b").exists()
    assert (tmp_path / "d").exists()
    assert "[1/4] make a: there" in lines


@pytest.mark.parametrize(("seconds", "text"), [(89.0, "89 s"), (90.0, "2 min"), (7200.0, "2.0 h")])
def test_durations_have_a_unit_that_suits_them(seconds, text):
    assert format_duration(seconds) == text
