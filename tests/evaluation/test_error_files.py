from pathlib import Path

import numpy as np
import pytest

from offpiste.errors import RunError
from offpiste.evaluation.errors import Errors, load_errors, save_errors, saved_errors
from window_errors import BASE


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    backwards = BASE.take(np.arange(len(BASE.row))[::-1])
    save_errors(tmp_path / "run" / "map.safetensors", backwards)
    again = load_errors(tmp_path / "run" / "map.safetensors")
    for name in ("drive", "row", "values", "loss"):
        np.testing.assert_array_equal(getattr(again, name), getattr(backwards, name))


def test_errors_are_computed_once(tmp_path: Path) -> None:
    made = Errors(np.zeros(3, np.int64), np.arange(3), np.ones((3, 5, 5)), np.ones(3))
    path = tmp_path / "run" / "map.safetensors"
    assert len(saved_errors(path, lambda: made).row) == 3
    again = saved_errors(path, lambda: pytest.fail("computed twice"))
    np.testing.assert_array_equal(again.values, made.values)


def test_a_file_that_is_damaged_or_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "map.safetensors"
    with pytest.raises(RunError, match=r"map\.safetensors: cannot be read"):
        load_errors(path)
    path.write_bytes(b"cut")
    with pytest.raises(RunError, match=r"map\.safetensors: cannot be read"):
        saved_errors(path, lambda: BASE)
