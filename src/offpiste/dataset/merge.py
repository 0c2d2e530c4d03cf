"""Merging of datasets that were extracted in shards, equal to the bit to one extraction of all logs."""

import filecmp
import logging
import shutil
from collections.abc import Sequence
from pathlib import Path

from offpiste.core.checksums import CHECKSUMS
from offpiste.core.errors import DatasetError
from offpiste.core.files import check_folder, remove_partials, write_folder
from offpiste.core.progress import track
from offpiste.dataset.integrity import dataset_checks
from offpiste.dataset.place import drive_names, mirrored
from offpiste.dataset.split_balance import split_warning
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.store_validation import attributes_of, refuse_unlike

logger = logging.getLogger(__name__)


def merge_datasets(parts: Sequence[Path], out: Path) -> Dataset:
    """Copy the drives of datasets with equal settings into one; an interrupted merge resumes.

    Every file is compared with its checksum first. Drives that `out` already contains must be the same.

    Raises:
        DatasetError: fewer than two datasets, a damaged one, different settings, or two drives of the same name.
    """
    if len(parts) < 2:
        raise DatasetError(f"{len(parts)} dataset to merge", how="name two or more")
    parts = [mirrored(part) for part in parts]
    _refuse_twice(parts)
    first = attributes_of(parts[0])
    for part in parts[1:]:
        refuse_unlike(part, attributes_of(part), first)
    for check in track([check for part in parts for check in dataset_checks(part)], "check"):
        if damage := check.damage():
            raise DatasetError(damage[0], how="restore or extract that dataset again; nothing was merged")
    check_folder(out)
    remove_partials(out.parent, out.name)
    if not out.exists():
        out.parent.mkdir(parents=True, exist_ok=True)
        write_folder(out, lambda partial: _copy_settings(parts[0], partial))
    else:
        refuse_unlike(out, attributes_of(out), first)
        remove_partials(out)
    for drive in track([part / name for part in parts for name in drive_names(part)], "merge"):
        _add(drive, out / drive.name)
    dataset = open_dataset(out)
    logger.info(f"{out}: {len(dataset.drives)} drives of {len(parts)} datasets")
    if (line := split_warning(dataset)) is not None:
        logger.warning(line)
    return dataset


def _refuse_twice(parts: Sequence[Path]) -> None:
    where: dict[str, Path] = {}
    for part in parts:
        attributes_of(part)  # raises unless there is a dataset
        for name in drive_names(part):
            if name in where:
                how = "give each dataset once; drives are identified by their names"
                raise DatasetError(f"drive '{name}' is in {where[name]}, too", where=part, how=how)
            where[name] = part


def _copy_settings(part: Path, to: Path) -> None:
    for name in ("zarr.json", CHECKSUMS):
        shutil.copyfile(part / name, to / name)


def _add(drive: Path, to: Path) -> None:
    def copy(partial: Path) -> None:
        shutil.copytree(drive, partial, dirs_exist_ok=True)

    if not to.exists():
        write_folder(to, copy)
    elif not _same(filecmp.dircmp(drive, to, ignore=[], hide=[])):
        how = "choose another --out, or delete it"
        raise DatasetError(f"contains another drive '{drive.name}' than {drive.parent}", where=to.parent, how=how)


def _same(compared: "filecmp.dircmp[str]") -> bool:
    """Return whether two folders contain the same files with the same bytes."""
    _, differ, unreadable = filecmp.cmpfiles(compared.left, compared.right, compared.common_files, shallow=False)
    different = compared.left_only or compared.right_only or compared.common_funny or differ or unreadable
    return not different and all(_same(below) for below in compared.subdirs.values())
