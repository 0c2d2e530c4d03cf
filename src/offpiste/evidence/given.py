"""Logs and rig of a report: checked before a folder is begun, and described by their content, wherever they lie."""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from offpiste.core.checksums import sha256_of
from offpiste.core.errors import LogError, RigError
from offpiste.core.object_store import brought, expanded, url_of
from offpiste.core.progress import track
from offpiste.dataset.extract import names_of
from offpiste.dataset.log_findings import findings_on
from offpiste.dataset.splits import Split, parse_split
from offpiste.logs.opening import open_log
from offpiste.logs.sensor_log import open_sensors
from offpiste.reproduction.settings import Size
from offpiste.rig.rig import Rig, load_rig, rig_text


@dataclass(frozen=True)
class Drives:
    """Logs, the rig that reads them, and how they are split."""

    logs: tuple[str, ...]
    rig: Rig
    split: str


def given_drives(logs: tuple[str, ...], rig: str, split: str) -> Drives:
    """What a user gives, once it can be read.

    Raises:
        OffpisteError: no such log, split or rig, or two logs of one name.
    """
    parse_split(split)
    found = tuple(str(log) for log in expanded(logs))
    for log in found:
        if url_of(log) is None and not Path(log).exists():
            raise LogError("no such file or folder", where=log, how="check the name of the log")
    names_of(found)
    return Drives(found, load_rig(rig), split)


def inspect_drives(drives: Drives, *, rig: str) -> None:
    """Inspect the channels of all logs, and the clocks and the coverage of their cameras and LiDARs.

    Args:
        rig: as it was given, for hints.

    Raises:
        LogError: a fatal finding, or sensors without messages while the vehicle's pose is known.
        RigError: a rig without cameras or LiDARs, or one that does not fit the log.
    """
    if not (drives.rig.cameras and drives.rig.lidars):
        what = f"it has no {'cameras' if drives.rig.lidars else 'LiDARs' if drives.rig.cameras else 'sensors'}"
        how = "add [cameras] and [lidars], as `offpiste inspect LOG --write-rig` does; features need both"
        raise RigError(what, where=rig, how=how)
    for log in track(drives.logs, "inspecting the logs"):
        with brought(Path(log)) as path:
            opened = open_log(path, clock=drives.rig.clock)
            fatal = [finding for finding in findings_on(opened, drives.rig) if finding.severity == "fatal"]
            if fatal:
                worst, more = fatal[0], f" (and {len(fatal) - 1} more)" if len(fatal) > 1 else ""
                how = f"{worst.fix}; `offpiste inspect {log} --rig {rig}` says more"
                raise LogError(f"unusable: {worst.where}: {worst.what}{more}", where=log, how=how)
            open_sensors(opened, drives.rig).coverage()


def described(size: Size, drives: Drives | None, rig: str) -> dict[str, Any]:
    """The settings that must be the same for results in a folder to be used again; there may be more seeds.

    Args:
        drives: None where the proving ground is driven.
        rig: a preset or a file, whose content counts.
    """
    kept = {"size": {key: value for key, value in asdict(size).items() if key != "seeds"}}
    if drives is None:
        return {**kept, "logs": {}, "rig": {}, "split": "drives"}
    sizes = {name: _bytes(log) for name, log in zip(names_of(drives.logs), drives.logs, strict=True)}
    return {**kept, "logs": sizes, "rig": _content(drives.rig, rig), "split": _in_words(parse_split(drives.split))}


def _content(rig: Rig, name: str) -> dict[str, Any]:
    """What a rig file says, without its defaults, which later versions may add to; with digests of its masks."""
    says: dict[str, Any] = msgspec.to_builtins(tomllib.loads(rig_text(name)))
    masks: Mapping[str, str] = {camera: source.mask for camera, source in rig.cameras.items() if source.mask}
    return {**says, "masks": {camera: sha256_of(Path(mask)) for camera, mask in masks.items() if Path(mask).is_file()}}


def _in_words(split: Split) -> Any:
    return dict(split.drives) if split.kind == "drives" else split.text


def _bytes(log: str) -> int | None:
    """Size of a log's files; None in object stores."""
    path = Path(log)
    if url_of(log) is not None:
        return None
    return (
        sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) if path.is_dir() else path.stat().st_size
    )
