"""Files in object stores: copies, patterns of URLs, and errors."""

import json
from pathlib import Path

import fsspec
import pytest
import s3fs
from fsspec.implementations.memory import MemoryFile

from cli.command import run
from offpiste.core.errors import LogError, OffpisteError
from offpiste.core.files import check_folder
from offpiste.core.object_store import brought, download, expanded, url_of
from offpiste.dataset.merge import merge_datasets
from offpiste.logs import open_log


@pytest.fixture
def bucket() -> str:
    """A folder in memory."""
    files = fsspec.filesystem("memory")
    files.store.clear()
    for name in ("b/one.csv", "b/two.csv", "b/folder/x.txt", "b/folder/below/y.txt"):
        files.pipe_file(f"/{name}", name.encode())
    return "memory://b"


def test_urls_are_told_from_local_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path, url in (
        (Path("s3://bucket/data.zarr"), "s3://bucket/data.zarr"),  # a Path keeps one of the slashes
        ("gs://bucket/folder/", "gs://bucket/folder"),
        ("/data/s3:/x", None),
        ("C:/data", None),
    ):
        assert url_of(path) == url
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s3:" / "b").mkdir(parents=True)
    assert url_of("s3:/b") is None


def test_a_file_and_a_folder_are_brought_and_removed_again(bucket: str) -> None:
    with brought(f"{bucket}/one.csv") as file:
        assert (file.name, file.read_text()) == ("one.csv", "b/one.csv")
    with brought(Path(f"{bucket}/folder")) as folder:
        found = {str(f.relative_to(folder)): f.read_text() for f in folder.rglob("*") if f.is_file()}
    assert found == {"x.txt": "b/folder/x.txt", "below/y.txt": "b/folder/below/y.txt"}
    assert not file.parent.exists()
    assert not folder.parent.exists()


def test_errors_name_the_url_and_not_the_copy(bucket: str) -> None:
    with pytest.raises(LogError, match=r"^memory://b/folder: no known log format"), brought(f"{bucket}/folder") as here:
        open_log(here)


def test_a_folder_of_logs_is_inspected_log_by_log(bucket: str, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "t,x,y,yaw\n" + "".join(f"{k / 20},{k / 10},0,0\n" for k in range(900))
    for name in ("monday", "tuesday"):
        fsspec.filesystem("memory").pipe_file(f"/b/drives/{name}.csv", rows.encode())
    run("inspect", f"{bucket}/drives", "--processes", 1, "--json")
    said = capsys.readouterr().out.splitlines()
    survey = json.loads("\n".join(line for line in said if "copied to this machine" not in line))
    assert [one["log"] for one in survey["logs"]] == [f"{bucket}/drives/{name}.csv" for name in ("monday", "tuesday")]


def test_patterns(bucket: str) -> None:
    assert expanded([f"{bucket}/*.csv", "here.csv"]) == ["memory://b/one.csv", "memory://b/two.csv", "here.csv"]
    with pytest.raises(OffpisteError, match=r"memory://b/\*\.bag: nothing matches"):
        expanded([f"{bucket}/*.bag"])


@pytest.mark.parametrize("name", ["../../evil", "a/../../evil", "a\\..\\evil"])
def test_names_that_leave_the_folder_are_refused(name: str, tmp_path: Path) -> None:
    files = fsspec.filesystem("memory")
    files.store[f"/b/{name}"] = MemoryFile(data=b"evil")
    with pytest.raises(OffpisteError, match="is not a valid file name"):
        download("memory://b", tmp_path / "to")
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_reached_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OffpisteError, match="memory://b/none: no such file or folder"), brought("memory://b/none"):
        pass
    with pytest.raises(OffpisteError, match=r"reading gs:// needs another package; .*pip install '\.\[gcs\]'"):
        download("gs://bucket/x", Path("x"))
    with pytest.raises(OffpisteError, match=r"nosuch://b/x: cannot be reached \(ValueError"):
        download("nosuch://b/x", Path("x"))
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "x")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "x")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(OffpisteError, match="cannot be reached"), brought("s3://silent/drive.mcap"):
        pass
    s3fs.S3FileSystem.clear_instance_cache()


def test_commands_that_work_on_this_machine_alone_say_so() -> None:
    with pytest.raises(OffpisteError, match="s3://b/run: is in an object store"):
        check_folder(Path("s3://b/run"))
    with pytest.raises(OffpisteError, match=r"s3://b/drive\.mcap: is in an object store"):
        open_log("s3://b/drive.mcap")
    with pytest.raises(OffpisteError, match=r"s3://b/1\.zarr: is in an object store"):
        merge_datasets([Path("s3://b/1.zarr"), Path("s3://b/2.zarr")], Path("d.zarr"))
