import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from offpiste.core.errors import RunError
from offpiste.evaluation.intervals import Levels, PairedDifference, Statistics
from offpiste.evaluation.metrics import (
    Headline,
    LossUnits,
    Metrics,
    Minus,
    Provenance,
    ResultRow,
    WindowNumbers,
    pooled_rows,
    read_metrics,
    run_rows,
    single_rows,
    write_metrics,
)

ONE = Statistics(1.7, 1.6, 1.0, 2.0, 3.0, (1.5, 1.9))
DIFFERENCE = PairedDifference(-1.4, (-1.9, -0.9))


def row(**change) -> ResultRow:
    names = ("distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "yaw_rate_error_radps", "loss")
    about = {
        "model": "b",
        "variant": "",
        "seed": 0,
        "fold": None,
        "start": "causal",
        "feature_set": None,
        "lookup": "map",
        "part": "test",
        "horizon_s": 5.0,
        "n": 903,
        "n_failed": 0,
        "levels": Levels(1, 9, 3),
        "minus": {"kinematic": Minus(DIFFERENCE, DIFFERENCE)},
    }
    return ResultRow(**{**about, **dict.fromkeys(names, ONE), **change})


def metrics(*rows: ResultRow) -> Metrics:
    return Metrics(
        dataset="turnpike.zarr",
        split="blocks:0.7,0.1,0.2",
        part="test",
        made=Provenance("2026-11-21T00:00:00+00:00", "offpiste evaluate", "a machine", {"offpiste": "0"}, 0),
        loss=LossUnits({"position": 1.0}, {"position": 4.0}),
        windows=WindowNumbers(
            n=903,
            drives=1,
            stride_s=0.1,
            blocks=9,
            block_s=10.0,
            median_distance_m=24.0,
            median_speed_mps=4.7,
            driven_in_training=0.7,
        ),
        headlines=[
            Headline(
                model="b",
                start="causal",
                lookup="map",
                runs=1,
                levels=Levels(1, 9),
                distance_error_m=1.7,
                other="kinematic",
                relative=-0.5,
                ci95=(-0.6, -0.4),
            )
        ],
        results=list(rows),
    )


def strict(path: Path) -> dict:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(path.read_text("utf-8"), parse_constant=refuse)


def test_the_schema_is_that_of_the_design(tmp_path: Path) -> None:
    write_metrics(tmp_path / "metrics.json", metrics(row()))
    content = strict(tmp_path / "metrics.json")
    assert content["schema"] == 2
    assert {"dataset", "split", "results"} <= set(content)
    (found,) = content["results"]
    statistics = {"mean", "median", "q1", "q3", "p90", "ci95"}
    errors = {"distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "yaw_rate_error_radps", "loss"}
    about = {"model", "variant", "seed", "fold", "start", "feature_set", "lookup", "part", "horizon_s", "n"}
    assert set(found) == about | errors | {"minus", "n_failed", "levels"}
    assert all(set(found[name]) == statistics for name in errors)
    assert found["levels"] == {"drives": 1, "blocks": 9, "seeds": 3}
    assert found["distance_error_m"]["ci95"] == [1.5, 1.9]
    assert found["minus"] == {
        "kinematic": {name: {"mean": -1.4, "ci95": [-1.9, -0.9]} for name in ("distance_error_m", "loss")}
    }
    assert (found["seed"], found["fold"], found["feature_set"]) == (0, None, None)


def test_what_was_written_is_read(tmp_path: Path) -> None:
    written = metrics(row(), row(seed=None, lookup=None, minus={}))
    write_metrics(tmp_path / "metrics.json", written)
    assert read_metrics(tmp_path / "metrics.json") == written


def test_what_is_not_finite_is_null_and_comes_back_as_nan(tmp_path: Path) -> None:
    failed = Statistics(np.inf, 1.0, 1.0, 1.0, np.inf, (np.nan, np.nan))
    write_metrics(tmp_path / "metrics.json", metrics(row(distance_error_m=failed, n_failed=3, seed=None)))
    (content,) = strict(tmp_path / "metrics.json")["results"]
    assert content["distance_error_m"]["mean"] is None
    assert content["distance_error_m"]["ci95"] == [None, None]
    (found,) = read_metrics(tmp_path / "metrics.json").results
    assert np.isnan([found.distance_error_m.mean, *found.distance_error_m.ci95]).all()
    assert found.distance_error_m.median == 1.0
    assert (found.n_failed, found.seed, found.fold) == (3, None, None)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        ("{", "truncated"),
        ("[]", "Expected `object`"),
        ('{"schema": 1}', "schema 1"),
        ('{"schema": 2, "dataset": "x"}', "missing required field"),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path: Path, content: str | None, message: str) -> None:
    path = tmp_path / "metrics.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(RunError, match=message) as caught:
        read_metrics(path)
    assert "\n" not in str(caught.value)


def test_rows_over_all_runs_are_told_from_single_runs() -> None:
    over_all, first, second = row(seed=None), row(seed=0), row(seed=1)
    alone = row(model="parametric", seed=0)
    baseline = row(model="kinematic", seed=None, lookup=None)
    rows = [over_all, first, second, alone, baseline]
    assert pooled_rows(rows) == [over_all, alone, baseline]
    assert run_rows(rows) == [first, second]
    assert single_rows(rows) == [first, second, alone, baseline]


def test_rows_can_be_read_by_others() -> None:
    assert json.loads(msgspec.json.encode(row()))["model"] == "b"
