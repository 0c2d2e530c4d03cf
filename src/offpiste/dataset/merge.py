"""Merging of datasets that were extracted in shards, equal to the bit to one extraction of all logs."""

import logging
import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from offpiste.core.checksums import CHECKSUMS
from offpiste.core.errors import DatasetError
from offpiste.core.files import check_folder, remove_partials, write_folder
from offpiste.core.progress import track
from offpiste.dataset.integrity import dataset_checks
from offpiste.dataset.split_balance import split_warning
from offpiste.dataset.store import Dataset, drive_names, open_dataset
from offpiste.dataset.store_validation import read_settings, refuse_unlike

logger = logging.getLogger(__name__)


def merge_datasets(parts: Sequence[Path], out: Path) -> Dataset:
    """Copy the drives of datasets with equal settings into one; an interrupted merge resumes.

    Every file is compared with its checksum first. Drives that `out` already contains must be the same. Raises
    `DatasetError` for fewer than two datasets, a damaged one, different settings, or two drives of the same name.
    """
    if len(parts) < 2:
        raise DatasetError(f"{len(parts)} dataset to merge", how="name two or more")
    settings, where = [read_settings(part) for part in parts], dict[str, Path]()
    for part, other in zip(parts, settings, strict=True):
        refuse_unlike(part, other, settings[0])
        for name in drive_names(part):
            if name in where:
                how = "give each dataset once; drives are identified by their names"
                raise DatasetError(f"drive '{name}' is in {where[name]}, too", where=part, how=how)
            where[name] = part
    for check in track([check for part in parts for check in dataset_checks(part)], "check"):
        if damage := check.damage():
            raise DatasetError(damage[0], how="restore or extract that dataset again; nothing was merged")
    check_folder(out)
    remove_partials(out.parent, out.name)
    if out.exists():
        refuse_unlike(out, read_settings(out), settings[0])
        remove_partials(out)
    else:
        write_folder(out, partial(_copy_settings, parts[0]))
    for name, part in track(list(where.items()), "merge"):
        sums = [folder / name / CHECKSUMS for folder in (out, part)]
        if not (out / name).exists():
            write_folder(out / name, partial(shutil.copytree, part / name, dirs_exist_ok=True))
        elif not sums[0].exists() or sums[0].read_bytes() != sums[1].read_bytes():
            how = "choose another --out, or delete it"
            raise DatasetError(f"contains another drive '{name}' than {part}", where=out, how=how)
    dataset = open_dataset(out)
    logger.info(f"{out}: {len(dataset.drives)} drives of {len(parts)} datasets")
    if (line := split_warning(dataset)) is not None:
        logger.warning(line)
    return dataset


def _copy_settings(folder: Path, to: Path) -> None:
    for name in ("zarr.json", CHECKSUMS):
        shutil.copyfile(folder / name, to / name)
