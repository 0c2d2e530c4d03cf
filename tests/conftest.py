"""Fixtures and settings of all tests; modules with declared shapes are checked at run time."""

import fcntl
import os
import pathlib
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from typing import Any

if "PYTEST_XDIST_WORKER" in os.environ:  # each worker has a core; libraries read this when they are first imported
    os.environ.setdefault("OMP_NUM_THREADS", "1")

os.environ["OFFPISTE_CACHE"] = (_cache := tempfile.TemporaryDirectory(prefix="offpiste-cache-")).name
if "PYTEST_XDIST_WORKER" not in os.environ:  # workers inherit it
    os.environ["OFFPISTE_TEST_SESSION"] = (_session := tempfile.TemporaryDirectory(prefix="offpiste-tests-")).name

# While the hook imports a module, Python recompiles its imports, so large packages are imported before.
import cv2  # noqa: F401
import jaxtyping
import scipy.ndimage
import scipy.signal
import scipy.spatial
import scipy.stats  # noqa: F401
import torch  # noqa: F401

import sampled_checks

# Without compiled modules each of the many processes of tests starts seconds later.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

sampled_checks.install()
_package = pathlib.Path(__file__).parents[1] / "src" / "offpiste"
_shaped = [file for file in _package.rglob("*.py") if "from jaxtyping import" in file.read_text("utf-8")]
jaxtyping.install_import_hook(
    [".".join(file.relative_to(_package.parent).with_suffix("").parts) for file in _shaped], "beartype.beartype"
)

from pathlib import Path  # noqa: E402

import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

# Tests are repeatable; `--hypothesis-profile=default` searches for new counterexamples.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


WHOLE_PATHS = (
    "golden/", "reproduction/",
    "inspection/test_course.py", "inspection/test_draft", "inspection/test_gear.py", "inspection/test_inspect.py",
    "inspection/test_late_poses.py", "inspection/test_message", "inspection/test_pedals.py", "inspection/test_pose.py",
    "inspection/test_re", "inspection/test_s",
    "closed_loop/test_drive_course.py", "runtime/test_backing_out.py",
    "runtime/test_runtime.py", "runtime/test_plan_maker.py", "simulation/test_recorder.py",
)  # fmt: skip
"""Tests without shape checks, which take up to half of their time; other tests check the same code."""


SLOW = (
    "dynamics/header/test_cuda.py::test_kernels_keep_a_step_in_registers[sm_8",
    "documentation/test_pages.py::test_a_tutorial_runs_as_it_stands[log-to-model]",
    "documentation/test_pages.py::test_a_tutorial_runs_as_it_stands[predict]",
    "experiments/test_pretrained_models.py",
    "golden/test_golden.py::test_golden[findings]", "inspection/test_sensors.py::test_kitti",
    "reproduction/test_data.py::test_portions",
    "experiments/inspection_faults/", "experiments/closed_loop_table/", "experiments/control_experiments/",
    "experiments/probe/",
    "experiments/test_unseen_kinds.py",
    "exports/test_onnx_files.py::", "fuzz/test_fuzz.py::test_forty_cases_of_a_new_seed",
    "live/test_live_faults.py::",
    "live/test_record.py::test_a_recording_in_several", "transport/test_zenoh.py::test_a_router_outlives",
    "native/test_compilers.py", "reproduction/test_reproduce.py",
    "core/test_cluster.py::", "dataset/test_extract.py::test_logs_in_an_object_store",
    "test_bombs.py::", "test_poison.py::",
    "test_benchmarks.py::test_inspection", "test_benchmarks.py::test_the_pictures", "test_benchmarks.py::test_training",
    "test_kill.py::test_a_killed_job",
    "rig/test_rig.py::test_the_proving_grounds_rig_masks", "training/test_distributed.py::test_a_process_that",
)  # fmt: skip
"""Tests that only `.ci/full` runs, except those in `SMOKE`."""

SMOKE = (
    "exports/test_onnx_files.py::test_images_become_the_codes", "live/test_live_faults.py::test_a_clock_that_stands",
    "live/test_live_faults.py::test_a_drive_with_every_process", "live/test_live_faults.py::test_a_drive_ends_by",
    "live/test_live_faults.py::test_the_last_command_is_a_stop_whichever_process_ends_first[]",
    "reproduction/test_reproduce.py::test_every_size_can_be_started",
    "experiments/closed_loop_table/test_command_line.py",
    "core/test_cluster.py::test_a_cluster_that_does_not", "test_bombs.py::test_every_compression",
    "test_bombs.py::test_rosbags", "test_bombs.py::test_a_definition", "test_bombs.py::test_the_json_of_a_run",
    "test_poison.py::test_a_draw", "test_poison.py::test_models_are_trained",
)  # fmt: skip
"""A few tests of each slow group for the default suite."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark slow tests."""
    for item in items:
        name = item.nodeid.removeprefix("tests/")
        if name.startswith(SLOW) and not name.startswith(SMOKE):
            item.add_marker("slow")


@pytest.fixture(scope="module", autouse=True)
def shapes_checked(request: pytest.FixtureRequest) -> Iterator[None]:
    """Check shapes and types, except in `WHOLE_PATHS`."""
    where = request.path.relative_to(Path(__file__).parent).as_posix()
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", before or where.startswith(WHOLE_PATHS))
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture(autouse=True)
def first_calls_checked() -> None:
    """Check the first calls of each test."""
    sampled_checks.begin_test()


@pytest.fixture(autouse=True)
def no_lines_of_progress(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Print no progress lines on slow machines, except in their own test."""
    if request.path.name != "test_progress.py":
        monkeypatch.setattr("offpiste.core.progress.EVERY", float("inf"))


REAL_TIME = ("live/test_live_faults.py", "live/test_play.py", "live/test_supervisor.py")
"""Tests with deadlines of 0.1 s, which must not run in parallel on two cores."""


@pytest.fixture(autouse=True)
def in_turn(request: pytest.FixtureRequest) -> Iterator[None]:
    """Run tests in real time one at a time."""
    if not request.path.relative_to(Path(__file__).parent).as_posix().startswith(REAL_TIME):
        yield
        return
    with (Path(tempfile.gettempdir()) / f"offpiste-real-time-{os.getuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def pytest_configure(config: pytest.Config) -> None:
    """Keep the order of files: xdist would run long files with few tests last."""
    config.option.loadscopereorder = False


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> object | None:
    """Distribute files over workers, with all tests in real time on one."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class InRealTimeTogether(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return "in real time" if file.endswith(REAL_TIME) else file

    return InRealTimeTogether(config, log)


def pytest_xdist_auto_num_workers() -> int:
    """Return one more than the number of cores, because tests of processes mostly wait."""
    return len(os.sched_getaffinity(0)) + 1


@pytest.fixture
def network() -> Iterator[Any]:
    """A Zenoh router on the loopback."""
    from transport.routers import Network

    with closing(Network()) as network:
        yield network


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Recorded data beside the project (see its README)."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("OFFPISTE_DATA") or beside)
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder; set OFFPISTE_DATA")
    return folder
