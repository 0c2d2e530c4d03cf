"""Checks of all files of a dataset against their checksums."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from offpiste.core.checksums import damaged_files
from offpiste.core.errors import OffpisteError
from offpiste.dataset.store import drive_names, open_dataset
from offpiste.dataset.store_validation import RESTORE
from offpiste.dataset.stored_arrays import check_crc32c, open_stored


class Check(NamedTuple):
    """Check of one file or folder."""

    path: Path
    raises: Callable[[Path], object]  # raises an error if the path is damaged
    fix: str = ""  # if the error does not say

    def damage(self) -> list[str]:
        """Return the error as one line; nothing for an intact file."""
        try:
            self.raises(self.path)
        except OffpisteError as error:
            return [str(error)]
        except (OSError, KeyError, ValueError, TypeError, OverflowError) as error:
            return [f"{error}; {self.fix}" if self.fix else str(error)]
        return []


def dataset_checks(path: Path) -> Iterator[Check]:
    """Yield the checks of metadata, chunks and content of a dataset."""
    yield Check(path, _check_metadata, RESTORE)
    for name in drive_names(path):
        drive = path / name
        fix = f"delete {drive} and run `offpiste extract` again"
        yield Check(drive, _check_metadata, fix)
        yield Check(drive, open_stored, fix)
        yield from (Check(file, check_crc32c, fix) for file in sorted(drive.rglob("c/**/*")) if file.is_file())
    yield Check(path, open_dataset)


def _check_metadata(folder: Path) -> None:
    if lines := [str(damaged) for damaged in damaged_files(folder)]:
        raise ValueError("; ".join(lines))
