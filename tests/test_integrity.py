"""A damaged file of a dataset, a run or a PCA is refused, or reads as before; `offpiste check` names it."""

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import torch

from factories import small_rig
from feature_datasets import FEATURES, rows_with_features
from offpiste.cli import main
from offpiste.core.errors import OffpisteError
from offpiste.dataset.map_snapshots import SnapshotWriter, crop
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import add_drive, create, open_dataset
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.perception.pca import PrincipalComponents, load_pca, save_pca
from offpiste.training.checkpoint import load_tensors, save_checkpoint, save_tensors
from offpiste.training.config import TrainConfig
from offpiste.training.run import build, load_run, save_run, vehicle_of

SEED = 0
MUTATIONS = 60


def make_dataset(path: Path) -> None:
    """Two drives, one with a map and one with snapshots."""
    rng = np.random.default_rng(0)
    listed = path.with_suffix(".txt")
    listed.write_text("mapped test\nkept validation\n")
    split = parse_split(f"drives:{listed}")
    create(path, small_rig(), split, tuple(f"pca{k}" for k in range(FEATURES)))
    looks = rng.normal(size=(60, 60, FEATURES)).astype(np.float32)
    flat, rise = np.ones((60, 60), np.float32), np.zeros((60, 60, 2), np.float32)
    for name in ("mapped", "kept"):
        rows = rows_with_features(400, rng)
        terrain = TerrainMap(rows.origin - 12.0, 0.4, flat, looks, rise)
        if name == "mapped":
            add_drive(path, name, rows, split, (), terrain)
            continue
        writer = SnapshotWriter(path / ".snapshots", 0.4, FEATURES)
        state = rows.state[300].astype(np.float64)
        state[:2] += rows.origin
        writer.add(300, crop(terrain, state, 4.0))
        writer.close()
        add_drive(path, name, rows, split, ("a note",), snapshots=path / ".snapshots")


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
    basis = np.linalg.qr(np.random.default_rng(0).normal(size=(12, 4)))[0].astype(np.float32)
    mean, variance = np.zeros(12, np.float32), np.ones(4, np.float32)
    save_pca(folder / "pca.safetensors", PrincipalComponents(mean, basis, variance, 8.0, "grid", "abc", {"images": 3}))
    return folder


def read_dataset(path: Path) -> str:
    """Digest of the content of a dataset."""
    dataset = open_dataset(path)
    digest = hashlib.sha256(repr((dataset.rig, dataset.split, dataset.features, dataset.pca)).encode())
    for drive in dataset.drives:
        digest.update(repr((drive.name, drive.notes, drive.rows.origin.tolist())).encode())
        arrays = [drive.part, *drive.rows.arrays().values()]
        arrays += [getattr(drive.rows.cells, field.name) for field in fields(drive.rows.cells)]
        terrains = [drive.load_map()] if drive.load_map else []
        if drive.snapshots is not None:
            arrays += [drive.snapshots.row, np.array([drive.snapshots.resolution])]
            terrains += [drive.snapshots.load(k) for k in range(len(drive.snapshots.row))]
        for terrain in terrains:
            arrays += [terrain.origin, np.array([terrain.resolution]), terrain.elevation, terrain.features]
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def read_run(folder: Path) -> str:
    """Digest of the content of a run and its stages."""
    run = load_run(folder)
    about = (run.model, run.seed, run.weights, run.scale.tolist(), run.split, run.seen, run.pca, run.dynamics.vehicle)
    digest = hashlib.sha256(repr(about).encode())
    stages = [load_tensors(folder / f"{name}.safetensors") for name in ("bicycle", "model.checkpoint")]
    for tensors, said in [(run.dynamics.state_dict(), {}), *stages]:
        digest.update(json.dumps(said, sort_keys=True).encode())
        for name in sorted(tensors):
            digest.update(name.encode() + tensors[name].numpy().tobytes())
    return digest.hexdigest()


def read_pca(path: Path) -> str:
    """Digest of the content of a PCA."""
    pca = load_pca(path)
    digest = hashlib.sha256(repr((pca.total_variance, pca.backbone, pca.fingerprint, pca.fitted_on)).encode())
    for array in (pca.mean, pca.basis, pca.variance):
        digest.update(array.tobytes())
    return digest.hexdigest()


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


def run_check(*paths: Path) -> int:
    with pytest.raises(SystemExit) as exit_:
        main(["check", *map(str, paths)])
    return int(exit_.value.code or 0)


def test_check_says_how_much_is_intact(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_check(*(made / name for name in READ)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(READ)
    assert all("MB are intact" in line for line in lines)
    assert run_check(made) == 0, "a folder that holds some"


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
    assert run_check(tmp_path / top) == 1
    output = capsys.readouterr().out
    assert any(str(tmp_path / name) in line and remedy in line for line in output.splitlines()), output
    assert "are intact" not in output


def test_check_misses_no_missing_chunk(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(made / "data.zarr", tmp_path / "data.zarr")
    missing = {"rise": "kept/snapshots/rise/c/0/0", "elevation": "mapped/map/elevation/c/0/0"}
    for chunk in missing.values():
        (tmp_path / "data.zarr" / chunk).unlink()
    assert run_check(tmp_path / "data.zarr") == 1
    output = capsys.readouterr().out
    assert all(f"a chunk of '{array}' is missing; delete" in output for array in missing), output


def test_check_refuses_what_is_nothing_of_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    for path in (tmp_path, tmp_path / "notes.txt", tmp_path / "none"):
        assert run_check(path) == 1
    said = capsys.readouterr()
    assert "is not a run, dataset or PCA, and contains none" in said.err
    assert "none: does not exist" in said.err
    assert "notes.txt: not a PCA" in said.out
