"""A damaged file of a dataset, a run or a PCA is refused, or reads as before; `offpiste check` names it."""

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from cli.command import run
from feature_datasets import FEATURES, empty_dataset, random_pca, rows_with_features
from offpiste.core.errors import OffpisteError
from offpiste.dataset.map_snapshots import SnapshotWriter, crop
from offpiste.dataset.store import add_drive, open_dataset
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.perception.backbones import open_backbone
from offpiste.perception.pca import load_pca, save_pca
from offpiste.training.checkpoint import load_tensors, save_checkpoint, save_tensors
from offpiste.training.config import TrainConfig
from offpiste.training.run import build, load_run, save_run, vehicle_of

SEED = 0
MUTATIONS = 60


def make_dataset(path: Path) -> None:
    """Two drives, one with a map and one with snapshots."""
    rng = np.random.default_rng(0)
    split = empty_dataset(path, {"mapped": "test", "kept": "validation"})
    looks = rng.normal(size=(60, 60, FEATURES)).astype(np.float32)
    flat, rise = np.ones((60, 60), np.float32), np.zeros((60, 60, 2), np.float32)
    mapped, kept = (rows_with_features(400, rng) for _ in range(2))
    terrain = TerrainMap(mapped.origin - 12.0, 0.4, flat, looks, rise)
    add_drive(path, "mapped", mapped, split, (), terrain)
    writer = SnapshotWriter(path / ".snapshots", 0.4, FEATURES)
    writer.add(300, crop(terrain, kept.state[300] + np.array((*kept.origin, 0, 0, 0, 0)), 4.0))
    writer.close()
    add_drive(path, "kept", kept, split, ("a note",), snapshots=path / ".snapshots")


def make_run(folder: Path, dataset: Path) -> None:
    """A finished run with a stage's file and a checkpoint beside."""
    data = open_dataset(dataset)
    config = TrainConfig(model="cf")
    model = build("cf", vehicle_of(data), seed=0)
    save_run(folder, model, config, data, torch.ones(5))
    save_tensors(folder / "bicycle.safetensors", model.bicycle.state_dict(), validation_loss=0.5)
    weights = {"now": dict(model.bicycle.state_dict())}
    save_checkpoint(folder / "model.checkpoint.safetensors", weights, torch.optim.Adam(model.parameters()), epoch=3)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("integrity")
    make_dataset(folder / "data.zarr")
    make_run(folder / "run", folder / "data.zarr")
    save_pca(folder / "pca.safetensors", random_pca(open_backbone("filterbank"), fitted_on={"images": 3}))
    return folder


def digest(value: object) -> str:
    """SHA-256 of a value with all that it contains."""
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, dict):
        value = sorted(value.items())
    if isinstance(value, list | tuple):
        content = "".join(map(digest, value)).encode()
    elif isinstance(value, np.ndarray | torch.Tensor):
        content = np.ascontiguousarray(value).tobytes()
    else:
        content = repr(value).encode()
    return hashlib.sha256(content).hexdigest()


def read_dataset(path: Path) -> str:
    """Digest of the content of a dataset."""
    dataset, drives = open_dataset(path), []
    for drive in dataset.drives:
        terrains, kept = [drive.load_map()] if drive.load_map else [], drive.snapshots
        if kept is not None:
            terrains += [kept.row, kept.resolution, *map(kept.load, range(len(kept.row)))]
        drives.append((drive.name, drive.notes, drive.part, drive.rows, terrains))
    return digest((repr(dataset.rig), repr(dataset.split), dataset.features, dataset.pca, drives))


def read_run(folder: Path) -> str:
    """Digest of the content of a run and its stages."""
    run = load_run(folder)
    stages = [load_tensors(folder / f"{name}.safetensors") for name in ("bicycle", "model.checkpoint")]
    about = (run.model, run.seed, run.weights, run.scale, run.split, run.seen, run.pca, run.dynamics.vehicle)
    return digest((about, run.dynamics.state_dict(), stages))


def read_pca(path: Path) -> str:
    """Digest of the content of a PCA."""
    return digest(load_pca(path))


READ: dict[str, Callable[[Path], str]] = {"data.zarr": read_dataset, "run": read_run, "pca.safetensors": read_pca}


@pytest.mark.parametrize("name", READ)
def test_a_flipped_bit_is_refused_or_changes_nothing(made: Path, name: str) -> None:
    read, rng = READ[name], np.random.default_rng(SEED)
    files = sorted(f for f in (made / name).rglob("*") if f.is_file()) or [made / name]
    wanted, refused = read(made / name), 0
    for number in range(MUTATIONS):
        # Every file once, before one of them is met again.
        file = files[number % len(files)] if number >= len(files) else files[rng.permutation(len(files))[number]]
        content = file.read_bytes()
        changed = bytearray(content)
        changed[rng.integers(len(changed))] ^= 1 << int(rng.integers(8))
        file.write_bytes(changed)
        try:
            assert read(made / name) == wanted, f"{file} reads as something else"
        except OffpisteError:
            refused += 1
        finally:
            file.write_bytes(content)
    assert refused > MUTATIONS / 2
    assert read(made / name) == wanted


def test_check_says_how_much_is_intact(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("check", *(made / name for name in READ)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(READ)
    assert all("MB are intact" in line for line in lines)
    assert run("check", made) == 0, "a folder that holds some"


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("data.zarr/zarr.json", "extract the dataset again"),
        ("data.zarr/kept/checksums.json", "run `offpiste extract` again"),
        ("data.zarr/kept/snapshots/features/c/0/0", "run `offpiste extract` again"),
        ("data.zarr/mapped/cells/features/c/0/0/0", "run `offpiste extract` again"),
        ("run/model.safetensors", "train again"),
        ("run/model.json", "train again"),
        ("run/model.checkpoint.safetensors", "train again"),
        ("pca.safetensors", "fit-pca"),
    ],
)
def test_check_names_a_damaged_file_and_what_to_do(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, remedy: str
) -> None:
    top = Path(name).parts[0]
    (shutil.copytree if (made / top).is_dir() else shutil.copy)(made / top, tmp_path / top)
    content = bytearray((tmp_path / name).read_bytes())
    # In JSON a digit behind another one, so that it stays JSON.
    at = next(
        k
        for k in (*range(len(content) // 2, len(content)), *range(1, len(content) // 2))
        if not name.endswith("json") or content[k - 1 : k + 1].isdigit()
    )
    content[at] ^= 1
    (tmp_path / name).write_bytes(content)
    assert run("check", tmp_path / top) == 1
    output = capsys.readouterr().out
    assert any(str(tmp_path / name) in line and remedy in line for line in output.splitlines()), output
    assert "are intact" not in output


def test_check_misses_no_missing_chunk(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(made / "data.zarr", tmp_path / "data.zarr")
    missing = {"rise": "kept/snapshots/rise/c/0/0", "elevation": "mapped/map/elevation/c/0/0"}
    for chunk in missing.values():
        (tmp_path / "data.zarr" / chunk).unlink()
    assert run("check", tmp_path / "data.zarr") == 1
    output = capsys.readouterr().out
    assert all(f"a chunk of '{array}' is missing; delete" in output for array in missing), output


def test_check_refuses_what_is_nothing_of_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    for path in (tmp_path, tmp_path / "notes.txt", tmp_path / "none"):
        assert run("check", path) == 1
    said = capsys.readouterr()
    assert "is not a run, dataset or PCA, and contains none" in said.err
    assert "none: does not exist" in said.err
    assert "notes.txt: not a PCA" in said.out
