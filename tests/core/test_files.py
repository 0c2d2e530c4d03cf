"""Atomic writing of files and folders."""

import multiprocessing
import os
import signal
from pathlib import Path

import pytest

from offpiste.core.errors import OffpisteError
from offpiste.core.files import remove_partials, temporary_folder, write_folder, write_text, write_whole


def test_the_current_folder_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for path in (Path(), tmp_path):
        with pytest.raises(OffpisteError, match="is the current folder"):
            write_folder(path, lambda partial: (partial / "whole").touch())
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_leaves_the_file_of_before_and_nothing_beside_it(tmp_path: Path) -> None:
    write_text(tmp_path / "notes.txt", "before")

    def fail(partial: Path) -> None:
        partial.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "notes.txt", fail)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("notes.txt", "before")]


def _write_for_long(path: Path, begun: "multiprocessing.synchronize.Event") -> None:
    with temporary_folder(path) as folder:
        (folder / "half").touch()
        begun.set()
        signal.pause()


def test_what_another_process_is_writing_stays_and_what_it_left_when_killed_goes(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    begun = context.Event()
    writer = context.Process(target=_write_for_long, args=(tmp_path / "drive", begun))
    writer.start()
    try:
        assert begun.wait(60)
        remove_partials(tmp_path)
        (partial,) = tmp_path.iterdir()
        assert [path.name for path in partial.iterdir()] == ["half"]
    finally:
        os.kill(writer.pid, signal.SIGKILL)
        writer.join()
    remove_partials(tmp_path, "other")
    assert partial.exists()
    remove_partials(tmp_path, "drive")
    assert list(tmp_path.iterdir()) == []
