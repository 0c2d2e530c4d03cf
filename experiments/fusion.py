"""Fusion rules of the map compared: coverage, stability of features over distance, and separability of ground kinds.

Simulated drives are replayed once with each rule; PCA and keyframes are the same.
`python -m experiments.fusion LOG... --pca pca.safetensors`
"""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from jaxtyping import Bool, Float, Int
from rich.table import Table

from experiments.command import run
from experiments.perturbed_sensors import stretch
from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.feature_coverage import HINDSIGHT, differences, feature_range, valid_rates, within_reach
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.visual_features import with_visual_features
from offpiste.dataset.wheel_passes import Passes, find_passes
from offpiste.files import write_text
from offpiste.logs import read_drive
from offpiste.logs.ground_truth import GROUND_KINDS, read_truth_map
from offpiste.logs.opening import open_log
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.mapping.fusion import FUSION_RULES
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.replay import MapperSettings
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.progress import track
from offpiste.rig.rig import Rig, load_rig
from offpiste.simulation.world.surface import read_grid

logger = logging.getLogger("experiments")

MEASURES = {
    "valid": "valid rate",
    "difference": "l2 difference to hindsight / range",
    "kinds": "variance between kinds",
}
"""What is reported by rule and feature set, and its title."""


@dataclass(frozen=True)
class Ridden:
    """The cells under the wheels of a drive, as each rule has them.

    Attributes:
        cells: by rule; the same passes in all of them.
        reached: whether the vehicle was at the set's distance from the cell during the pass.
        kind: kind of ground with the largest share there, an index into `GROUND_KINDS`.
    """

    cells: Mapping[str, Cells]
    reached: Bool[np.ndarray, "D M"]
    kind: Int[np.ndarray, " M"]


def between_kinds(features: Float[np.ndarray, "M F"], kind: Int[np.ndarray, " M"]) -> float:
    """Share of the features' total variance that lies between the means of the kinds; NaN without variance."""
    features = features.astype(np.float64)
    centred = features - features.mean(axis=0) if len(features) else features
    total = np.square(centred).sum()
    groups = (centred[kind == k] for k in np.unique(kind))
    between = sum(len(group) * np.square(group.mean(axis=0)).sum() for group in groups)
    return float(between / total) if total > 0 else float("nan")


def compare(drive: Ridden) -> list[dict[str, Any]]:
    """A row for each rule and feature set.

    Rates refer to the cells that could have been seen at the distance. Differences are relative to the range under the
    same rule. Kinds are separated in the cells that are valid under all rules.
    """
    common = np.logical_and.reduce([cells.valid for cells in drive.cells.values()])
    rows = []
    for rule, cells in drive.cells.items():
        rates = valid_rates([cells], [drive.reached])
        apart = differences([cells], feature_range([cells]))
        for number, name in enumerate(FEATURE_SETS):
            there = common[number]
            rows.append(
                {
                    "rule": rule,
                    "feature_set": name,
                    "valid": float(rates[number]),
                    "difference": float(apart.length[HINDSIGHT, number]) if number != HINDSIGHT else 0.0,
                    "kinds": between_kinds(cells.features[number, there], drive.kind[there]),
                }
            )
    return rows


def medians(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Over the drives, by rule and feature set; drives that lack a value do not count."""
    keys = list(dict.fromkeys((row["rule"], row["feature_set"]) for row in rows))
    result = []
    for rule, name in keys:
        mine = [row for row in rows if (row["rule"], row["feature_set"]) == (rule, name)]
        values = {measure: [row[measure] for row in mine if np.isfinite(row[measure])] for measure in MEASURES}
        middle = {measure: float(np.median(v)) if v else float("nan") for measure, v in values.items()}
        result.append({"rule": rule, "feature_set": name, **middle})
    return result


def table_of(rows: Sequence[dict[str, Any]], title: str) -> Table:
    """Measures by rule (lines) and feature set (columns)."""
    table = Table("measure", "rule", *FEATURE_SETS, title=title)
    for measure, name in MEASURES.items():
        for rule in dict.fromkeys(row["rule"] for row in rows):
            values = {row["feature_set"]: row[measure] for row in rows if row["rule"] == rule}
            table.add_row(name, rule, *(f"{values[number]:.3f}" for number in FEATURE_SETS))
    return table


def ride(
    log: Path, rig: Rig, extractor: FeatureExtractor, rules: Sequence[str], seconds: float | None = None
) -> Ridden:
    """Play a simulated drive back with each rule.

    Args:
        seconds: time from the start of the drive [s]; all of it by default.

    Raises:
        LogError: the log has no cameras, LiDARs or ground truth, or they are damaged.
    """
    truth = read_truth_map(log)
    rows, sensors = extract_rows(read_drive(log, rig)), open_sensors(open_log(log), rig)
    if seconds is not None:
        rows, sensors = _first(rows, sensors, seconds)
    cells = {}
    for rule in track(rules, log.stem):
        settings = MapperSettings(map=MapSettings(VoxelSettings(rule=rule)))
        result = with_visual_features(rows, sensors, rig, extractor, settings).cells
        assert result is not None
        cells[rule] = result
    resolution = VoxelSettings().size
    passes, xy = _passes(rows, sensors, rig, resolution)
    shares = np.stack([truth.layers[name] for name in GROUND_KINDS], axis=-1)
    kind = read_grid(shares, truth.origin, truth.resolution, (passes.cell + 0.5) * resolution).argmax(axis=1)
    return Ridden(cells, within_reach(passes, rows.time, xy, resolution), kind)


def _first(rows: Rows, sensors: SensorLog, seconds: float) -> tuple[Rows, SensorLog]:
    """The same rows, the vehicle's place unknown after so many seconds: no cell is passed then."""
    state, end = rows.state.copy(), rows.time[0] + seconds
    state[rows.time > end] = np.nan
    return replace(rows, state=state), stretch(sensors, rows.time[0], end)


def _passes(rows: Rows, sensors: SensorLog, rig: Rig, resolution: float) -> tuple[Passes, Float[np.ndarray, "N 2"]]:
    xy = rows.state[:, :2].astype(np.float64) + rows.origin
    wheels = wheel_positions(xy, rows.state[:, 2].astype(np.float64), rig.wheel_positions())
    return find_passes(rows.time, xy, wheels, resolution=resolution, jumps=sensors.poses.jumps), xy


@dataclass(frozen=True)
class Fusion:
    """Compare the map's fusion rules on simulated drives."""

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Drives of `offpiste simulate` with cameras and LiDAR."""
    pca: Path
    """PCA of `offpiste fit-pca`."""
    rig: str = "proving_ground"
    """Name of a rig preset, or a rig file."""
    seconds: float | None = None
    """Time from the start of each drive [s]; all of it by default."""
    out: Path | None = None
    """Folder for fusion.json, with a row for each drive, rule and feature set."""

    def run(self) -> None:
        """Play back, print a table for each drive and the medians."""
        rig, extractor = load_rig(self.rig), load_feature_extractor(self.pca)
        rows: list[dict[str, Any]] = []
        for log in self.logs:
            mine = compare(ride(log, rig, extractor, tuple(FUSION_RULES), self.seconds))
            rows += [{"drive": log.stem, **row} for row in mine]
            logger.info(table_of(mine, log.stem))
        middle = medians(rows)
        if len(self.logs) > 1:
            logger.info(table_of(middle, f"median of {len(self.logs)} drives"))
        if self.out is not None:
            made = {"settings": asdict(self), "pca": extractor.identity}
            write_text(self.out / "fusion.json", json.dumps({**made, "rows": rows, "medians": middle}, default=str))


if __name__ == "__main__":
    run(Fusion)
