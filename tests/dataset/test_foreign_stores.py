"""A store that is not as datasets are written is refused in one line, and nothing that it names is run."""

import json
from pathlib import Path

import pytest

from cli.command import run
from offpiste.core.checksums import write_checksums
from offpiste.core.errors import DatasetError
from offpiste.dataset.store import open_dataset
from test_integrity import make_dataset


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    make_dataset(tmp_path / "data.zarr")
    return tmp_path / "data.zarr"


def edit(file: Path, **changes: object) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def pickle_that_touches(file: Path) -> bytes:
    return f"cposix\nsystem\n(S'touch {file}'\ntR.".encode()


def refused(dataset: Path, capsys: pytest.CaptureFixture[str], what: str) -> None:
    with pytest.raises(DatasetError, match=what):
        open_dataset(dataset)
    assert run("check", dataset) == 1
    shown = capsys.readouterr()
    assert "Traceback" not in shown.out + shown.err


def test_zarr_version_2_whose_codec_unpickles_is_not_opened(dataset, tmp_path, capsys):
    proof = tmp_path / "code-ran"
    time = dataset / "kept" / "time"
    for file in [*time.rglob("*")][::-1]:
        file.unlink() if file.is_file() else file.rmdir()
    array = {"zarr_format": 2, "shape": [400], "chunks": [400], "dtype": "|O", "order": "C", "fill_value": None}
    (time / ".zarray").write_text(json.dumps({**array, "compressor": None, "filters": [{"id": "pickle"}]}))
    (time / "0").write_bytes(pickle_that_touches(proof))
    for folder in (dataset, dataset / "kept"):
        attributes = json.loads((folder / "zarr.json").read_text())["attributes"]
        (folder / "zarr.json").unlink()
        (folder / ".zgroup").write_text('{"zarr_format": 2}')
        (folder / ".zattrs").write_text(json.dumps(attributes))
    refused(dataset, capsys, "is damaged|not a dataset")
    assert not proof.exists()


def test_other_codecs_are_not_opened(dataset, tmp_path, capsys):
    proof = tmp_path / "code-ran"
    time = dataset / "kept" / "time"
    (time / "c" / "0").write_bytes(pickle_that_touches(proof))
    edit(time / "zarr.json", codecs=[{"name": "numcodecs.pickle", "configuration": {}}, {"name": "bytes"}])
    (dataset / "kept" / "checksums.json").unlink()
    with pytest.raises(DatasetError, match="cannot be read"):
        open_dataset(dataset)
    write_checksums(dataset / "kept", (dataset / "kept").rglob("zarr.json"))
    refused(dataset, capsys, "codec 'numcodecs.pickle' is not one of")
    assert not proof.exists()


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1 << 40]}}}, "chunks of 8388608 MiB"),
        ({"storage_transformers": [{"name": "x"}]}, "storage transformers"),
        ({"data_type": "object"}, "cannot be read"),
        ({"codecs": "bytes"}, "cannot be read"),
        ({"zarr_format": 4}, "Zarr version 4"),
    ],
)
def test_metadata_that_datasets_do_not_have_are_refused(dataset, capsys, changes, what):
    edit(dataset / "kept" / "time" / "zarr.json", **changes)
    write_checksums(dataset / "kept", (dataset / "kept").rglob("zarr.json"))
    refused(dataset, capsys, what)
