"""Jobs on a Ray cluster."""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import cluster
from log_messages import logged
from offpiste.core.errors import OffpisteError
from offpiste.core.parallel import run_all
from offpiste.inspection.survey import inspect_logs
from offpiste.rig.rig import load_rig
from parallel_jobs import square

DRIVES = 12


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return cluster.write_logs(tmp_path_factory.mktemp("logs"), DRIVES)


@pytest.fixture(scope="module")
def three() -> Iterator[Any]:
    """A cluster for all tests, of which the last one kills a node."""
    with cluster.nodes() as nodes:
        yield nodes


def test_jobs_that_fail_are_not_begun_again_and_those_that_kill_their_workers_are_given_up(
    logs: list[Path], three: Any
) -> None:
    with logged() as messages:
        failed = run_all(square, [3, -1, 13, 5], 1, "squares", cluster=three.address).failed
        survey = inspect_logs([str(log) for log in logs[6:9]], load_rig("proving_ground"), cluster=three.address)
    assert [one["log"] for one in survey.inspections] == [str(logs[6]), str(logs[8])]
    assert [error.where for error in survey.failed] == [str(logs[7])]
    assert {"9", "25"} < set(messages)
    said = sorted(str(error) for error in failed)
    assert said[0] == "here: -1 is negative; give another"
    assert said[1].startswith("its worker or its node was lost 5 times (WorkerCrashedError)")


@pytest.mark.parametrize("address", ["nowhere.invalid:6379", "127.0.0.1:{free}", "127.0.0.1:port"])
def test_a_cluster_that_does_not_answer_is_an_error_in_one_line(address: str) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = address.format(free=free.getsockname()[1])
        with pytest.raises(OffpisteError, match="no Ray cluster answers; start one with `ray start --head`"):
            run_all(square, [1, 2], 1, "squares", cluster=address)


def test_a_worker_and_a_node_that_are_killed_change_nothing(logs: list[Path], three: Any, tmp_path: Path) -> None:
    whole, out = tmp_path / "whole.zarr", tmp_path / "out.zarr"
    expected = cluster.extracted(logs, whole)
    assert all(broken in expected for broken in cluster.BROKEN)
    kills = [cluster.kill_worker, cluster.kill_node]
    with cluster.killing(kills, three, out, 0, DRIVES) as killed:
        said = cluster.extracted(logs, out, three.address)
    assert killed == ["kill_worker", "kill_node"]
    assert said == expected.replace("whole.zarr", "out.zarr")
    assert cluster.content(out) == cluster.content(whole)
